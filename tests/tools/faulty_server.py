"""A server of files that holds bytes back, breaks answers off or knows no ranges, as tests say."""

import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus

from cogsplat.tools.delivery.slow_server import Link, Reply, SlowServer, text_reply


@dataclass
class Faults:
    """What goes wrong with one file.

    Parameters
    ----------
    ranges : bool
        Whether the server knows ranges; without them it sends the whole file with status 200.
    breaks : list of int
        Answers, one after the other, that end after so many bytes of their body.
    statuses : list of HTTPStatus
        Answers, one after the other, that are but a status.
    content_type : str or None
    """

    ranges: bool = True
    breaks: list[int] = field(default_factory=list)
    statuses: list[HTTPStatus] = field(default_factory=list)
    content_type: str | None = None


class FaultyServer(SlowServer):
    """Serves files, of which one is held back or goes wrong.

    Parameters
    ----------
    files : mapping of str to bytes
    link : Link or None
    name : str
        The file that faults are about.
    """

    # Threads whose answers are held back do not keep the server from ending.
    daemon_threads = True
    block_on_close = False

    def __init__(
        self, files: Mapping[str, bytes], link: Link | None = None, name: str = "scene.cogs"
    ) -> None:
        super().__init__(files, link)
        self.name = name
        self.faults = Faults()
        self._sent_up_to: float = float("inf")
        self._moved = threading.Condition()

    def hold_at(self, size_bytes: float) -> None:
        """Send only what stands in the first so many bytes of the file, until told otherwise."""
        with self._moved:
            self._sent_up_to = size_bytes
            self._moved.notify_all()

    def reply(self, name: str, wanted: str | None) -> Reply:
        """Answer, wrongly where it is about the file."""
        if name != self.name:
            return super().reply(name, wanted)
        if self.faults.statuses:
            return text_reply(self.faults.statuses.pop(0))
        right = super().reply(name, wanted if self.faults.ranges else None)
        headers = dict(right.headers)
        if not self.faults.ranges:
            del headers["Accept-Ranges"]
        if self.faults.content_type is not None:
            headers["Content-Type"] = self.faults.content_type
        if right.status not in (HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT):
            return Reply(right.status, headers, right.body)
        first = 0
        if right.status is HTTPStatus.PARTIAL_CONTENT:
            first = int(headers["Content-Range"].removeprefix("bytes ").partition("-")[0])
        content = b"".join(right.body)
        if self.faults.breaks:
            return Reply(right.status, headers, _broken(content[: self.faults.breaks.pop(0)]))
        return Reply(right.status, headers, self._held(content, first))

    def _held(self, content: bytes, first: int) -> Iterator[bytes]:
        at = 0
        while at < len(content):
            with self._moved:
                self._moved.wait_for(lambda: self._sent_up_to > first + at)  # noqa: B023
                end = int(min(len(content), self._sent_up_to - first))
            yield content[at:end]
            at = end


def _broken(content: bytes) -> Iterator[bytes]:
    yield content
    raise ConnectionAbortedError
