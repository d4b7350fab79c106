"""The conformance vectors and the second decoder."""
