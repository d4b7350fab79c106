"""Exceptions of obstore, turned into errors of cogsplat where obstore is called."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType

from cogsplat.codec.errors import CogsplatError, MissingExtraError, StorageError

# obstore adds internal details below the first line, which a server may make long.
_LONGEST_LINE = 300


@contextmanager
def store_errors(name: str, failure: Callable[[str], Exception]) -> Iterator[None]:
    """Turn every exception of obstore in the block into an error of cogsplat.

    Parameters
    ----------
    name : str
        Address of the object or bucket in messages.
    failure : callable
        Function that returns an error with a given message, for failures not listed below.

    Raises
    ------
    StorageError
        ``not-found``, ``permission``, ``source-changed``.
    """
    exceptions = obstore_module().exceptions
    try:
        yield
    except (CogsplatError, TimeoutError):
        raise
    except FileNotFoundError as error:
        raise StorageError(
            "not-found", f"{name}: the store has no such object, expected it; check the URL"
        ) from error
    except (
        PermissionError,
        exceptions.PermissionDeniedError,
        exceptions.UnauthenticatedError,
    ) as error:
        raise StorageError(
            "permission",
            f"{name}: the store refuses access: {first_line(error)}; check the credentials",
        ) from error
    except exceptions.PreconditionError as error:
        raise StorageError(
            "source-changed",
            f"{name}: the object changed while it was read: {first_line(error)}; open it again",
        ) from error
    except Exception as error:
        # Besides its own, obstore raises ValueError and others for what servers send.
        raise failure(f"{name}: {first_line(error)}") from error


def first_line(error: Exception) -> str:
    """Return the first line of an error's message, cut; the name of its type if it has none."""
    return str(error).strip().partition("\n")[0][:_LONGEST_LINE] or type(error).__name__


def obstore_module() -> ModuleType:
    """Return the module obstore, or raise ``needs-cloud``."""
    try:
        import obstore
        import obstore.exceptions
        import obstore.store
    except ImportError as error:
        raise MissingExtraError(
            "needs-cloud",
            "obstore is not installed, expected it for object stores "
            "(pip install 'cogsplat[cloud]')",
        ) from error
    return obstore
