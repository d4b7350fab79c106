"""Scores of splats (their blending weights in a set of views), and reference views."""
