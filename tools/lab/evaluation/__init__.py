"""Evaluation protocols from the literature: orders, prefixes, objects."""
