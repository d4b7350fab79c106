"""Delivery of scenes to browsers: viewer pages, notebook widgets, local web servers."""
