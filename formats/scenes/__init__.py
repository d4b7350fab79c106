"""Scene formats of others."""
