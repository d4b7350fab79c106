"""Comparison with programs of others."""
