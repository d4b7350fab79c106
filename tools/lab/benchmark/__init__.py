"""Benchmarks of COGS: formats, encoders, ablations, network and decode speed."""
