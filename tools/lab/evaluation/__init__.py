"""Evaluation protocols of the literature: orders, prefixes, objects."""
