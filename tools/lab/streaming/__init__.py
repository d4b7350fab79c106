"""Streaming by view, simulated: where a visitor looks, what a client fetches next, what is seen."""
