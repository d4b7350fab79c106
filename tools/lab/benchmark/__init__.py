"""Benchmarks: COGS against other formats, and each technique of the encoder on its own."""
