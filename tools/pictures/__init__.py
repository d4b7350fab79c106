"""PNG, SVG and strips of pictures."""
