"""Synthetic scenes: a terrace with objects, houses, landscapes, scenes that are hard to cover."""
