"""What a client that looks at a part of a scene fetches next: docs/streaming.md, exactly."""
