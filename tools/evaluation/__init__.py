"""How good a file is: pictures, prefixes, bytes."""
