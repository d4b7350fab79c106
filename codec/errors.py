"""The one tree of errors: what was found, where, what was expected, and a stable reason code."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return text on one line in which what a terminal would obey is written as an escape.

    Names and comments of a file may hold such characters, and messages quote them: controls, marks
    that turn the direction of text, halves of characters, separators of lines (what
    `str.isprintable` says no to).

    Examples
    --------
    >>> printable("red\x1b[31m")
    'red\\x1b[31m'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escaped(ord(c)) for c in text)


def _escaped(number: int) -> str:
    if number < 0x100:
        return f"\\x{number:02x}"
    return f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


class CogsplatError(Exception):
    """Base of every refusal.

    Parameters
    ----------
    code : str
        Stable reason code (lower case, hyphens); the same in every implementation of the format.
    message : str
        What was found, where, and what was expected; kept as `printable` gives it.

    Attributes
    ----------
    exit_code : int
        What the command line exits with: 2 misuse, 3 invalid data, 4 input/output or a missing
        extra, 5 limit, 130 interrupted.
    """

    exit_code = 3

    def __init__(self, code: str, message: str) -> None:
        message = printable(message)
        super().__init__(message)
        self.code = code
        self.message = message

    def __reduce__(self) -> tuple[object, ...]:
        # Between processes, errors travel whole; by default Python would call __init__ with the
        # message alone, and fail.
        return _restored, (type(self), self.args), self.__dict__


class CogsplatWarning(UserWarning):
    """Something a file holds, or that was to be written, is left out or altered; work goes on.

    Issued through `warnings.warn`, one line that says where, what and why; the command line prints
    each once.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class FormatError(CogsplatError):
    """A file breaks the rules of its format.

    Parameters
    ----------
    code, message : str
        As in `CogsplatError`.
    clause : str
        The SPEC clause that was broken, such as ``"4.2"``; empty for foreign formats.
    offset : int or None
        Byte offset in the file, where known.
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
    """The bytes end early; more of the same file would help.

    Parameters
    ----------
    needed : int
        File length in bytes that would have sufficed; 0 where not known.
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
    """Valid, but newer or more than this build does."""


class MissingExtraError(UnsupportedError):
    """A package that an extra of cogsplat brings, or its device, is missing; data may be right."""

    exit_code = 4


class DataError(CogsplatError):
    """Splats or cameras that cannot be used: NaN rows, zero quaternions, views that see nothing."""


class LimitError(CogsplatError):
    """A limit of the caller's was reached."""

    exit_code = 5


class StorageError(CogsplatError):
    """Reading or writing failed below the format: missing file, disk full, permission, network."""

    exit_code = 4


class Cancelled(CogsplatError):  # noqa: N818 - an interruption, not a fault
    """The caller asked for the work to stop."""

    exit_code = 130

    def __init__(self, message: str = "cancelled") -> None:
        super().__init__("cancelled", message)


def _restored(kind: type[CogsplatError], args: tuple[object, ...]) -> CogsplatError:
    return kind.__new__(kind, *args)
