"""Splats and cameras in, chunk payloads out, and back: arrays only, no files."""
