"""Image files: PNG, SVG charts, film-strips, contact sheets, object masks."""
