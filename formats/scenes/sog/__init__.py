"""PlayCanvas SOG."""
