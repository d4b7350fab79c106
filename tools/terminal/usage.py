"""Errors of usage: what the library refuses as misuse is the user's mistake in a command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click


@contextmanager
def usage_errors() -> Iterator[None]:
    """Turn a `ValueError` of the block into a usage error with the same message."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from error
