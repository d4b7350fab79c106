"""Streaming JSON parser for untrusted files: memory for one value at a time.

Lists of cameras are long and their entries short. Parsing a file at once takes up to thirty times
its bytes of memory; `JsonStream` takes the memory of the largest entry.
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Iterator
from typing import Final, NoReturn

from cogsplat.codec.errors import FormatError, LimitError

MAX_VALUE_BYTES: Final = 1 << 20
"""Longest text of one value, bytes: an entry of an array, or the value of a key."""

# Bytes to parse at a time, tried in turn: most cameras of a list fit into the first.
_WINDOWS: Final = (2048, 65536, MAX_VALUE_BYTES)

# An error this near to the end of a window may come from the cut: the longest token that can be
# cut is "\ud83d\ude0".
_CUT_CHARACTERS: Final = 16

_SPACE: Final = re.compile(rb"[ \t\n\r]*")
_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"


def refuse_constant(name: str) -> NoReturn:
    """Refuse NaN and the infinities, which Python's parser accepts."""
    raise ValueError(f"{name} is no JSON number")


_DECODER: Final = json.JSONDecoder(parse_constant=refuse_constant)


class JsonStream:
    """Reading position in JSON text.

    Parameters
    ----------
    data : bytes
        UTF-8, with or without a byte order mark.
    where : str
        Name of the file for messages.
    code : str
        Reason code of every syntax error.

    Attributes
    ----------
    at : int
        Byte offset of the next token, or of white space before it.

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
        """Return the next byte after white space; empty at the end of the text."""
        match = _SPACE.match(self._data, self.at)
        assert match is not None
        self.at = match.end()
        return self._data[self.at : self.at + 1]

    def value(self) -> object:
        """Parse the next value, like `json.loads`.

        Raises
        ------
        FormatError
            `code`: a syntax error, NaN, Infinity, or nesting beyond the depth of Python's parser.
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
            # RecursionError: nested beyond the depth of the parser.
            except (ValueError, RecursionError) as error:
                raise self._malformed(f"{error} behind byte {self.at}") from error
            # A number at the end of the window may be cut.
            if end < len(piece) or is_last:
                self.at += end if piece.isascii() else len(piece[:end].encode())
                return found
        raise LimitError(
            "json-too-long",
            f"{self._where}: a value of more than {MAX_VALUE_BYTES} bytes at byte {self.at}, "
            "expected a shorter one",
        )

    def items(self) -> Iterator[int]:
        """Yield the index of each item of the next array.

        The caller parses the item before it asks for the next index.

        Raises
        ------
        FormatError
            `code`: the next value is not an array, or is malformed.
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
        """Yield each key of the next object.

        The caller parses the key's value before it asks for the next key.

        Raises
        ------
        FormatError
            `code`: the next value is not an object, or is malformed.
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
        """Check that only white space follows.

        Raises
        ------
        FormatError
            `code`.
        """
        if self.peek():
            raise self._malformed(f"further text at byte {self.at} behind the value")

    def _take(self, *marks: bytes) -> bytes:
        """Read one of several punctuation bytes, or raise an error."""
        found = self.peek()
        if found not in marks:
            expected = " or ".join(mark.decode() for mark in marks)
            raise self._malformed(f"no {expected} at byte {self.at}")
        self.at += 1
        return found

    def _malformed(self, found: str) -> FormatError:
        """Return the error for a syntax error."""
        return FormatError(self._code, f"{self._where}: {found}, expected JSON")
