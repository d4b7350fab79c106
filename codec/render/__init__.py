"""Rasteriser, and measurements that blend splats tile by tile (numba, or gsplat on CUDA)."""
