"""How COGS compares with other formats."""
