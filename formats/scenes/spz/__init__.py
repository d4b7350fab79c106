"""Niantic's SPZ, versions 1 to 4."""
