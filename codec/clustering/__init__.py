"""Codebooks by k-means, of vectors and of single values."""
