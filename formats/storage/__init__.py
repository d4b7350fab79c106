"""Bytes in and out: sources, atomic writes, strict JSON, images, file signatures."""
