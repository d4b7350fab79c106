"""The COGS container (SPEC 3 to 5 and 8)."""
