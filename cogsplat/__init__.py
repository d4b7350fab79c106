"""Cloud-Optimized Gaussian Splats: encode, decode, read and write splat scenes."""
