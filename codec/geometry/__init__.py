"""Geometry: rotations, spherical harmonics, Morton codes, frames, bounds, frusta, neighbours."""
