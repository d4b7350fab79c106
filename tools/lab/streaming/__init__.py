"""Simulation of streaming clients: camera traces, fetch policies, links, and picture quality."""
