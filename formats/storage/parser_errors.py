"""Errors with a reason code from exceptions of foreign parsers, such as Pillow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cogsplat.codec.errors import CogsplatError

_MAX_TEXT = 200


@contextmanager
def parser_errors(
    refusal: Callable[[str], CogsplatError], *, passed: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Turn any exception of a foreign parser into the refusal of a damaged file.

    Pillow, plyfile and zipfile raise exceptions of many types for damaged files, and new versions
    raise further ones. A `CogsplatError` passes. So does `MemoryError`: callers check all sizes
    that a file declares before they parse it.

    Parameters
    ----------
    refusal : callable
        Function from the text of the exception, or its type if it has no text, to the error.
    passed : tuple of exception types
        Further exceptions that pass, such as `OSError` of a parser that reads from a disk.

    Raises
    ------
    CogsplatError
        The refusal, with the exception as its cause.
    """
    try:
        yield
    except (CogsplatError, MemoryError):
        raise
    except passed:
        raise
    except Exception as error:
        raise refusal(str(error)[:_MAX_TEXT] or type(error).__name__) from error
