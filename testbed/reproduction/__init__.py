"""Reproduces the papers' simulations and checks their claims."""
