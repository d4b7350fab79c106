"""Which splats come first, and how that order is cut into chunks."""
