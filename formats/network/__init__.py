"""Bytes over a network: range requests to web servers and object stores, and what they cost."""
