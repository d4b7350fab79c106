"""Scores: how much each splat weighs in a set of views; and reference views of the scene."""
