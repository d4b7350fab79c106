"""Rotations, spherical harmonics, Morton codes, frames, bounds and frusta: plain numpy."""
