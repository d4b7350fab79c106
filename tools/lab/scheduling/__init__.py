"""Reference implementation of the view-dependent fetch scheduler (docs/streaming.md)."""
