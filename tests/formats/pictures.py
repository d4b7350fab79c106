"""Posters and skies of tests."""

import io

from PIL import Image


def picture(kind="JPEG", size=(6, 3), **options):
    """Return the bytes of a picture."""
    out = io.BytesIO()
    Image.new("RGB", size, (10, 200, 30)).save(out, kind, **options)
    return out.getvalue()
