"""Nouns and verbs that everything else shares; imports nothing of ours."""
