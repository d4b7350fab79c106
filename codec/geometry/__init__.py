"""Rotations, spherical harmonics, Morton codes, frames, bounds, frusta, neighbours."""
