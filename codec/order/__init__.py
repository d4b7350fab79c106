"""Orders: which splats come first in a file, and how an order is cut into chunks."""
