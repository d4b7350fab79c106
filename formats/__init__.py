"""Bytes: the COGS container, foreign scene formats and camera formats."""
