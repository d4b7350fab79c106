"""What each splat adds to a set of views, and the pictures that others are compared with."""
