"""Rasteriser, and all that is measured by blending splats tile by tile (numba)."""
