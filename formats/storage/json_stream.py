"""JSON of unknown origin read value by value, so that a long file is never in memory as objects.

Lists of cameras are long and their entries short. Parsed at once, a file takes up to thirty times
its bytes; read through `JsonStream`, no more than its largest entry does.
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Iterator
from typing import Final, NoReturn

from cogsplat.codec.errors import FormatError, LimitError

MAX_VALUE_BYTES: Final = 1 << 20
"""Longest text of one value that is parsed: an entry of an array, or the value of a key."""

# Tried one after the other: most entries of a list of cameras take less than the first.
_WINDOWS: Final = (2048, 65536, MAX_VALUE_BYTES)

# A fault so near the end of a window may come of its cut: "\ud83d\ude0" is the longest such token.
_CUT_CHARACTERS: Final = 16

_SPACE: Final = re.compile(rb"[ \t\n\r]*")
_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"


def refuse_constant(name: str) -> NoReturn:
    """Refuse NaN and the infinities, which Python's parser takes for JSON."""
    raise ValueError(f"{name} is no JSON number")


_DECODER: Final = json.JSONDecoder(parse_constant=refuse_constant)


class JsonStream:
    """A place in JSON text, which moves as values are read.

    Parameters
    ----------
    data : bytes
        UTF-8, with or without a byte order mark.
    where : str
        Name of the file for messages.
    code : str
        Reason code of every fault of the text.

    Attributes
    ----------
    at : int
        Byte at which the next token begins, or space before it.

    Examples
    --------
    >>> stream = JsonStream(b"[1, [2, 3]]", "a.json", "bad-json")
    >>> [stream.value() for _ in stream.items()]
    [1, [2, 3]]
    """

    def __init__(self, data: bytes, where: str, code: str) -> None:
        self._data = data
        self._where = where
        self._code = code
        self.at = len(_BYTE_ORDER_MARK) if data.startswith(_BYTE_ORDER_MARK) else 0

    def peek(self) -> bytes:
        """Return the next byte that is no space, none at the end of the text."""
        match = _SPACE.match(self._data, self.at)
        assert match is not None
        self.at = match.end()
        return self._data[self.at : self.at + 1]

    def value(self) -> object:
        """Read the next value, as `json.loads` gives it.

        Raises
        ------
        FormatError
            The reason code given: no JSON, NaN or Infinity in it, or nested deeper than Python's
            parser goes.
        LimitError
            ``json-too-long``: the value takes more than `MAX_VALUE_BYTES`.
        """
        self.peek()
        for window in _WINDOWS:
            stop = self.at + window
            is_last = stop >= len(self._data)
            try:
                piece = codecs.getincrementaldecoder("utf-8")().decode(
                    self._data[self.at : stop], is_last
                )
                found, end = _DECODER.raw_decode(piece)
            except json.JSONDecodeError as error:
                cut = error.pos + _CUT_CHARACTERS >= len(piece) or "Unterminated" in error.msg
                if is_last or not cut:
                    raise self._malformed(f"{error.msg} behind byte {self.at}") from error
                continue
            # RecursionError: nested deeper than the parser goes.
            except (ValueError, RecursionError) as error:
                raise self._malformed(f"{error} behind byte {self.at}") from error
            # A number may go on behind the window.
            if end < len(piece) or is_last:
                self.at += end if piece.isascii() else len(piece[:end].encode())
                return found
        raise LimitError(
            "json-too-long",
            f"{self._where}: a value at byte {self.at} is longer than {MAX_VALUE_BYTES} bytes, "
            "expected less",
        )

    def items(self) -> Iterator[int]:
        """Yield the index of each item of the array that begins here, each to be read meanwhile.

        Raises
        ------
        FormatError
            The reason code given: there is no array, or it is malformed.
        """
        self._take(b"[")
        if self.peek() == b"]":
            self.at += 1
            return
        index = 0
        while True:
            yield index
            index += 1
            if self._take(b",", b"]") == b"]":
                return

    def members(self) -> Iterator[str]:
        """Yield each key of the object that begins here, its value to be read meanwhile.

        Raises
        ------
        FormatError
            The reason code given: there is no object, or it is malformed.
        """
        self._take(b"{")
        if self.peek() == b"}":
            self.at += 1
            return
        while True:
            key = self.value()
            if not isinstance(key, str):
                raise self._malformed(f"a key that is no string before byte {self.at}")
            self._take(b":")
            yield key
            if self._take(b",", b"}") == b"}":
                return

    def finish(self) -> None:
        """Check that nothing is left.

        Raises
        ------
        FormatError
            The reason code given.
        """
        if self.peek():
            raise self._malformed(f"more at byte {self.at}, where the text should end")

    def _take(self, *marks: bytes) -> bytes:
        found = self.peek()
        if found not in marks:
            expected = " or ".join(mark.decode() for mark in marks)
            raise self._malformed(f"no {expected} at byte {self.at}")
        self.at += 1
        return found

    def _malformed(self, found: str) -> FormatError:
        return FormatError(self._code, f"{self._where}: {found}, expected JSON")
