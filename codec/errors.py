"""Exception classes. Messages give the problem, its place and the expected value."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return text on one line, with unprintable characters written as escapes.

    Messages quote names and comments of files, which may hold control characters, marks of text
    direction, lone surrogates and line separators: all characters that `str.isprintable` rejects.

    Examples
    --------
    >>> printable("red\x1b[31m")
    'red\\x1b[31m'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escape(ord(c)) for c in text)


def _escape(number: int) -> str:
    """Return the Python escape of a code point."""
    if number < 0x100:
        return f"\\x{number:02x}"
    return f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


class CogsplatError(Exception):
    """Base class of all errors that cogsplat raises for bad data, limits and failed storage.

    Parameters
    ----------
    code : str
        Stable reason code (lower case, hyphens), shared by all implementations of the format.
    message : str
        Text that gives the problem, its place and the expected value; stored as `printable`.

    Attributes
    ----------
    exit_code : int
        Exit code of the command line: 2 misuse, 3 invalid data, 4 input/output or a missing extra,
        5 limit, 130 interrupted.
    """

    exit_code = 3

    def __init__(self, code: str, message: str) -> None:
        message = printable(message)
        super().__init__(message)
        self.code = code
        self.message = message

    def __reduce__(self) -> tuple[object, ...]:
        # Unpickling would call __init__ with the message alone, and fail.
        return _unpickle, (type(self), self.args), self.__dict__


class CogsplatWarning(UserWarning):
    """Warning that data of a file was omitted or altered in reading or writing.

    Issued through `warnings.warn` as one line that says where, what and why; the command line
    prints each warning once.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class FormatError(CogsplatError):
    """Error: a file breaks the rules of its format.

    Parameters
    ----------
    code, message : str
        See `CogsplatError`.
    clause : str
        Violated SPEC clause, such as ``"4.2"``; empty for foreign formats.
    offset : int or None
        Byte offset in the file, if known.
    """

    def __init__(
        self, code: str, message: str, *, clause: str = "", offset: int | None = None
    ) -> None:
        if clause:
            message = f"{message} (SPEC {clause})"
        super().__init__(code, message)
        self.clause = clause
        self.offset = offset


class TruncatedError(FormatError):
    """Error: the bytes end early; more bytes of the same file would help.

    Parameters
    ----------
    needed : int
        File length in bytes that would suffice; 0 if not known.
    """

    def __init__(
        self,
        code: str,
        message: str,
        *,
        clause: str = "",
        offset: int | None = None,
        needed: int = 0,
    ) -> None:
        super().__init__(code, message, clause=clause, offset=offset)
        self.needed = needed


class UnsupportedError(CogsplatError):
    """Error: a valid file needs a newer version or a feature that this build lacks."""


class MissingExtraError(UnsupportedError):
    """Error: a package of one of cogsplat's extras, or its device, is missing."""

    exit_code = 4


class DataError(CogsplatError):
    """Error: unusable splats or cameras, such as NaN rows or views that show nothing."""


class LimitError(CogsplatError):
    """Error: a limit set by the caller was reached."""

    exit_code = 5


class StorageError(CogsplatError):
    """Error: reading or writing failed: missing file, disk full, permission, network."""

    exit_code = 4


class Cancelled(CogsplatError):  # noqa: N818 - an interruption, not a fault
    """Error raised when the caller cancels the work."""

    exit_code = 130

    def __init__(self, message: str = "cancelled") -> None:
        super().__init__("cancelled", message)


def _unpickle(kind: type[CogsplatError], args: tuple[object, ...]) -> CogsplatError:
    """Create an error without calling its `__init__`; pickle then restores its attributes."""
    return kind.__new__(kind, *args)
