"""A web server for one file that does wrong what it is told to, request by request."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

STALL = 60.0


@dataclass
class Asked:
    """A request: its path, headers in lower case, and the range it asks for."""

    path: str
    headers: dict[str, str]
    first: int
    end: int


class Exchange:
    """A request and the connection that the answer goes to."""

    def __init__(self, server: "FaultServer", asked: Asked, writer: asyncio.StreamWriter) -> None:
        self.server, self.asked, self.writer = server, asked, writer
        self.keep = True

    @property
    def data(self) -> bytes:
        return self.server.data

    @property
    def part(self) -> bytes:
        return self.data[self.asked.first : self.asked.end]

    def head(self, status: int, headers: dict[str, str]) -> None:
        lines = [f"HTTP/1.1 {status} Said", *(f"{k}: {v}" for k, v in headers.items())]
        self.writer.write("\r\n".join([*lines, "", ""]).encode())

    def stated(self, **changes: str | None) -> dict[str, str]:
        """Return the headers of a right answer, some of them changed or left out."""
        asked, size = self.asked, len(self.data)
        headers: dict[str, str | None] = {
            "Content-Type": "application/octet-stream",
            "Content-Length": str(len(self.part)),
            "Content-Range": f"bytes {asked.first}-{min(asked.end, size) - 1}/{size}",
            "ETag": self.server.etag,
        }
        headers |= {name.replace("_", "-"): value for name, value in changes.items()}
        return {name: value for name, value in headers.items() if value is not None}

    def break_off(self) -> None:
        """Reset the connection."""
        self.keep = False
        self.writer.transport.abort()

    async def send(self, status: int, headers: dict[str, str], body: bytes = b"") -> None:
        self.head(status, headers)
        self.writer.write(body)
        await self.writer.drain()


Fault = Callable[[Exchange], Awaitable[None]]


async def right(exchange: Exchange) -> None:
    """Answer as a server should."""
    if exchange.asked.first >= len(exchange.data):
        size = len(exchange.data)
        headers = {"Content-Length": "0", "Content-Range": f"bytes */{size}"}
        await exchange.send(416, headers)
        return
    await exchange.send(206, exchange.stated(), exchange.part)


async def no_ranges(exchange: Exchange) -> None:
    """Send the whole file, as ``python -m http.server`` does."""
    size = str(len(exchange.data))
    await exchange.send(200, exchange.stated(Content_Range=None, Content_Length=size))
    for at in range(0, len(exchange.data), 1 << 16):
        exchange.writer.write(exchange.data[at : at + (1 << 16)])
        await exchange.writer.drain()
        exchange.server.sent += len(exchange.data[at : at + (1 << 16)])


def stating(status: int = 206, body: bytes | None = None, **changes: str | None) -> Fault:
    """Answer with other headers, another status or another body."""

    async def fault(exchange: Exchange) -> None:
        sent = exchange.part if body is None else body
        length = {} if "Content_Length" in changes else {"Content_Length": str(len(sent))}
        await exchange.send(status, exchange.stated(**length, **changes), sent)

    return fault


def status(code: int, **headers: str) -> Fault:
    """Answer with a status and nothing else."""

    async def fault(exchange: Exchange) -> None:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        await exchange.send(code, {"Content-Length": "0", **named})

    return fault


def broken_after(count: int) -> Fault:
    """Reset the connection after so many bytes of the body."""

    async def fault(exchange: Exchange) -> None:
        await exchange.send(206, exchange.stated(), exchange.part[:count])
        # What was written arrives before the reset.
        await asyncio.sleep(0.02)
        exchange.break_off()

    return fault


async def reset(exchange: Exchange) -> None:
    """Reset the connection without an answer."""
    exchange.break_off()


def stalled_after(count: int) -> Fault:
    """Send so many bytes, then nothing more and keep the connection open."""

    async def fault(exchange: Exchange) -> None:
        await exchange.send(206, exchange.stated(), exchange.part[:count])
        await asyncio.sleep(STALL)

    return fault


def slow(bytes_per_second: float, block: int = 512) -> Fault:
    """Send a right answer slowly."""

    async def fault(exchange: Exchange) -> None:
        exchange.head(206, exchange.stated())
        for at in range(0, len(exchange.part), block):
            exchange.writer.write(exchange.part[at : at + block])
            await exchange.writer.drain()
            await asyncio.sleep(block / bytes_per_second)

    return fault


@dataclass
class FaultServer:
    """Serves one file under every path.

    Parameters
    ----------
    data : bytes
    faults : list of Fault
        What happens to the first requests; the rest are answered right.
    always : Fault, optional
        What happens to all requests after those.
    pages : dict of str to (str, bytes)
        Media type and body of paths that are answered right and are no part of what is counted,
        for browsers, which read the file from the server that their page is from.
    """

    data: bytes
    faults: list[Fault] = field(default_factory=list)
    always: Fault = right
    etag: str | None = '"one"'
    asked: list[Asked] = field(default_factory=list)
    sent: int = 0
    port: int = 0
    connections: int = 0
    open_connections: int = 0
    pages: dict[str, tuple[str, bytes]] = field(default_factory=dict)

    def url(self, path: str = "scene.cogs") -> str:
        return f"http://127.0.0.1:{self.port}/{path}"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self.open_connections += 1
        try:
            while (asked := await self._request(reader)) is not None:
                exchange = Exchange(self, asked, writer)
                if asked.path in self.pages:
                    kind, body = self.pages[asked.path]
                    headers = {"Content-Type": kind, "Content-Length": str(len(body))}
                    await exchange.send(200, headers, body)
                    continue
                self.asked.append(asked)
                fault = self.faults.pop(0) if self.faults else self.always
                await fault(exchange)
                if not exchange.keep:
                    return
        except (ConnectionError, asyncio.CancelledError):
            return
        finally:
            self.open_connections -= 1
            writer.close()

    async def _request(self, reader: asyncio.StreamReader) -> Asked | None:
        try:
            text = (await reader.readuntil(b"\r\n\r\n")).decode()
        except (asyncio.IncompleteReadError, ConnectionError):
            return None
        first, *lines = text.split("\r\n")
        headers = {
            k.lower(): v.strip() for k, _, v in (line.partition(":") for line in lines if line)
        }
        span = headers.get("range", "bytes=0-").removeprefix("bytes=").partition("-")
        end = int(span[2]) + 1 if span[2] else 1 << 60
        return Asked(first.split(" ")[1], headers, int(span[0]), end)


@contextmanager
def serving(server: FaultServer) -> Iterator[FaultServer]:
    """Answer requests in a thread as long as the block lasts."""
    with listening(server._serve) as port:
        server.port = port
        yield server


Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@contextmanager
def listening(handler: Handler) -> Iterator[int]:
    """Give connections to a port, which this gives, to a handler in a thread."""
    ready = threading.Event()
    stop: list[Callable[[], object]] = []
    port: list[int] = []
    writers: list[asyncio.StreamWriter] = []

    async def handled(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        await handler(reader, writer)

    async def main() -> None:
        stopping = asyncio.Event()
        loop = asyncio.get_running_loop()
        stop.append(lambda: loop.call_soon_threadsafe(stopping.set))
        made = await asyncio.start_server(handled, "127.0.0.1", 0, limit=1 << 20)
        port.append(made.sockets[0].getsockname()[1])
        ready.set()
        await stopping.wait()
        # What was accepted last takes its place before the server closes; else it stays open.
        loop.remove_reader(made.sockets[0].fileno())
        await asyncio.sleep(0.01)
        made.close()
        for writer in writers:
            writer.transport.abort()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        # What was aborted is closed by the loop.
        await asyncio.sleep(0.01)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    ready.wait()
    try:
        yield port[0]
    finally:
        stop[0]()
        thread.join()
