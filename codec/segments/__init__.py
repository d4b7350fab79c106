"""Payloads of whole segments: heads, refinements, tails, codebooks, attributes, compensation."""
