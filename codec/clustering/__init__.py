"""K-means codebooks of vectors and of scalars."""
