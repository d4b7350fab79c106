"""k-means of vectors and of scalars."""
