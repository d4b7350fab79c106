"""PlayCanvas' SOG: splats as lossless images."""
