"""Byte sources, atomic writes, strict JSON, images and file signatures."""
