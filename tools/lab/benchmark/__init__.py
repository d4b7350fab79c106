"""Benchmarks of COGS: comparison with other formats, ablations, network and decode speed."""
