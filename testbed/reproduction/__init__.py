"""What of the papers' claims comes out: their own simulations, flown again and measured."""
