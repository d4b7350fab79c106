"""Pictures of splats, and everything that is measured by blending them (numba)."""
