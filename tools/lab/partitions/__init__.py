"""Partitions of space into boxes, compared by benchmarks."""
