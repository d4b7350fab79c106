"""Niantic SPZ."""
