"""Conversion of a `ValueError` of the library into a usage error of the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click


@contextmanager
def usage_errors() -> Iterator[None]:
    """Turn a `ValueError` of the block into a usage error with its message."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from error
