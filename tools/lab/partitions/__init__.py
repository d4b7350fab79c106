"""Partitions of space into boxes, for benchmarks."""
