"""Load test of `serve` and `view`: many connections at once, most of them badly behaved.

By hand, at full size::

    python tests/tools/delivery/crowd.py serve
    python tests/tools/delivery/crowd.py view
"""

import argparse
import asyncio
import json
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

# Run by hand, the script finds this tree and its test helpers by itself.
sys.path[:0] = [str(Path(__file__).resolve().parents[level]) for level in (1, 3)]

from running import program  # noqa: E402

SCENE_BYTES = 8 << 20
KINDS = ("silent", "dripping", "unread", "slow", "steady")
# Peers that a server must not close.
ANSWERED = ("slow", "steady")


@dataclass
class Crowd:
    """Figures of a load test."""

    answers: int = 0
    wrong: list[str] = field(default_factory=list)
    held: Counter[str] = field(default_factory=Counter)
    slowest_seconds: float = 0.0
    most_rss: int = 0
    most_descriptors: int = 0
    most_sockets: int = 0
    lines: list[str] = field(default_factory=list)

    def report(self) -> dict[str, object]:
        return {
            "right answers": self.answers,
            "wrong answers": len(self.wrong),
            "first wrong": sorted(Counter(self.wrong).items())[:5],
            "held": dict(self.held),
            "slowest answer, s": round(self.slowest_seconds, 2),
            "resident, MB": round(self.most_rss / 1e6, 1),
            "descriptors": self.most_descriptors,
            "of these sockets": self.most_sockets,
            "lines on stderr": len(self.lines),
            "first lines": self.lines[:4],
        }


class Served:
    """A server in a process of its own, whose memory and descriptors are sampled."""

    def __init__(self, process: subprocess.Popen[str], port: int, name: str, data: bytes) -> None:
        self.process = process
        self.port = port
        self.name = name
        self.data = data
        self.figures = Crowd()
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._sample)
        self._watch.start()

    def rss(self) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        return int(status.split("VmRSS:")[1].split()[0]) << 10

    def _sample_descriptors(self) -> None:
        links = []
        for entry in Path(f"/proc/{self.process.pid}/fd").iterdir():
            with suppress(OSError):
                links.append(str(entry.readlink()))
        sockets = sum(link.startswith("socket:") for link in links)
        self.figures.most_descriptors = max(self.figures.most_descriptors, len(links))
        self.figures.most_sockets = max(self.figures.most_sockets, sockets)

    def _sample(self) -> None:
        while not self._over.wait(0.1):
            with suppress(OSError, IndexError):
                self.figures.most_rss = max(self.figures.most_rss, self.rss())
                self._sample_descriptors()

    def close(self) -> None:
        self._over.set()
        self._watch.join()

    def request(self, first: int = 0, end: int | None = None) -> bytes:
        """Return the head of a GET for a range of the scene, or for all of it."""
        wanted = "" if end is None else f"Range: bytes={first}-{end - 1}\r\n"
        return f"GET /{self.name} HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n{wanted}\r\n".encode()


@contextmanager
def server_process(
    kind: str, folder: Path, descriptors: int, extra: tuple[str, ...] = ()
) -> Iterator[Served]:
    """Run `cogsplat serve` or `cogsplat view` under a limit of descriptors."""
    path = folder / ("scene.ply" if kind == "view" else "scene.cogs")
    command = program([kind, path, "--json", *(["--no-open"] if kind == "view" else []), *extra])
    noise = b"\x93COGS" + random.Random(1).randbytes(SCENE_BYTES)
    data = ply_bytes() if kind == "view" else noise
    path.write_bytes(data)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))

    errors = (folder / "errors.txt").open("w+", encoding="utf-8")
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=errors, text=True, preexec_fn=limit
    )
    assert process.stdout is not None
    try:
        printed = ""
        while not printed.endswith("}\n"):
            line = process.stdout.readline()
            assert line, (folder / "errors.txt").read_text(encoding="utf-8")
            printed += line
        port = int(json.loads(printed)["url"].rpartition(":")[2].partition("/")[0])
        if kind == "view":
            data = fetched(port, "scene.ply")
        served = Served(process, port, path.name, data)
        try:
            yield served
        finally:
            served.close()
            process.send_signal(signal.SIGINT)
            process.wait(30)
            errors.seek(0)
            served.figures.lines = errors.read().splitlines()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        errors.close()


def fetched(port: int, name: str) -> bytes:
    from http.client import HTTPConnection

    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", f"/{name}")
    body = connection.getresponse().read()
    connection.close()
    return body


def ply_bytes() -> bytes:
    """Return a PLY of 3DGS training with `SCENE_BYTES` bytes of splats."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    count = SCENE_BYTES // (4 * len(names))
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [*(f"property float {name}" for name in names), "end_header", ""]
    import numpy as np

    values = np.random.default_rng(1).normal(size=(count, len(names))).astype("<f4")
    return "\n".join(head).encode() + values.tobytes()


async def connect(port: int, receive_buffer: int | None = None) -> socket.socket:
    peer = socket.socket()
    if receive_buffer is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    peer.setblocking(False)
    try:
        await asyncio.get_running_loop().sock_connect(peer, ("127.0.0.1", port))
    except BaseException:
        peer.close()
        raise
    return peer


async def read_answer(peer: socket.socket, held: bytes = b"") -> tuple[int, bytes]:
    """Return the status and body of an answer with a Content-Length."""
    loop = asyncio.get_running_loop()
    while b"\r\n\r\n" not in held:
        part = await loop.sock_recv(peer, 1 << 16)
        if not part:
            raise ConnectionError(f"closed after {len(held)} bytes of headers")
        held += part
    head, _, body = held.partition(b"\r\n\r\n")
    lines = head.decode("latin-1").split("\r\n")
    fields = dict(line.lower().split(": ", 1) for line in lines[1:])
    length = int(fields["content-length"])
    while len(body) < length:
        part = await loop.sock_recv(peer, 1 << 16)
        if not part:
            raise ConnectionError(f"closed after {len(body)} of {length} bytes")
        body += part
    return int(lines[0].split()[1]), body


async def ask(served: Served, peer: socket.socket, rng: random.Random) -> None:
    """Request a random range and compare the answer."""
    first = rng.randrange(len(served.data) - 30_000)
    end = first + rng.randrange(1, 30_000)
    began = time.monotonic()
    await asyncio.get_running_loop().sock_sendall(peer, served.request(first, end))
    status, body = await asyncio.wait_for(read_answer(peer), 30)
    figures = served.figures
    figures.slowest_seconds = max(figures.slowest_seconds, time.monotonic() - began)
    if (status, body) == (206, served.data[first:end]):
        figures.answers += 1
    else:
        figures.wrong.append(f"status {status}, {len(body)} of {end - first} bytes")


async def hold(served: Served, kind: str, seconds: float, rng: random.Random) -> None:
    """Hold one connection as a peer of one kind."""
    loop = asyncio.get_running_loop()
    small = 4096 if kind in ("unread", "slow") else None
    until = time.monotonic() + seconds
    try:
        peer = await asyncio.wait_for(connect(served.port, small), 30)
    except (OSError, TimeoutError) as error:
        if kind in ANSWERED:
            served.figures.wrong.append(f"{kind}: {type(error).__name__} when connecting")
        return
    with peer:
        try:
            if kind == "dripping":
                for byte in served.request():
                    await loop.sock_sendall(peer, bytes([byte]))
                    if time.monotonic() > until:
                        break
                    await asyncio.sleep(1)
            elif kind == "unread":
                await loop.sock_sendall(peer, served.request())
                await asyncio.sleep(until - time.monotonic())
            elif kind == "slow":
                await loop.sock_sendall(peer, served.request())
                got = b""
                while time.monotonic() < until:
                    part = await asyncio.wait_for(loop.sock_recv(peer, 4096), 30)
                    if not part:
                        raise ConnectionError("closed in a slow download")
                    got += part
                    await asyncio.sleep(0.3)
                body = got.partition(b"\r\n\r\n")[2]
                if not served.data.startswith(body) or not body:
                    served.figures.wrong.append("slow: other bytes")
            elif kind == "steady":
                while time.monotonic() < until:
                    await ask(served, peer, rng)
                    await asyncio.sleep(1)
            else:
                await asyncio.sleep(until - time.monotonic())
        except (OSError, TimeoutError) as error:
            # A server may close peers that neither ask nor read; the others must be answered.
            if kind in ANSWERED:
                served.figures.wrong.append(f"{kind}: {type(error).__name__} {error}")
            return
        served.figures.held[kind] += 1


async def short(served: Served, kind: int, rng: random.Random) -> None:
    """Connect for a moment: ask and close, leave in the middle of a download, or ask nothing."""
    try:
        peer = await asyncio.wait_for(connect(served.port), 30)
        with peer:
            if kind < 2:
                await ask(served, peer, rng)
            elif kind == 2:
                await asyncio.get_running_loop().sock_sendall(peer, served.request())
                await asyncio.sleep(0.01)
    except (OSError, TimeoutError) as error:
        if kind < 2:
            served.figures.wrong.append(f"short: {type(error).__name__} {error}")


async def crowd(
    served: Served,
    held: int,
    per_minute: int,
    seconds: float,
    kinds: tuple[str, ...] = KINDS,
) -> None:
    """Hold connections of some kinds, and open short ones beside them."""
    rng = random.Random(1)
    holders = []
    for index in range(held):
        kind = kinds[index % len(kinds)]
        holders.append(asyncio.create_task(hold(served, kind, seconds, random.Random(index))))
        if index % 50 == 49:
            await asyncio.sleep(0.05)
    await asyncio.sleep(2)
    began = time.monotonic()
    visits = []
    total = round(per_minute * (seconds - 3) / 60)
    for index in range(total):
        due = began + index * 60 / per_minute
        await asyncio.sleep(max(due - time.monotonic(), 0))
        visits.append(asyncio.create_task(short(served, index % 4, rng)))
    await asyncio.gather(*holders, *visits)


async def pipeline(served: Served, requests: int, seconds: float) -> int:
    """Send many requests on one connection without reading; return the bytes that were taken."""
    loop = asyncio.get_running_loop()
    data = memoryview(served.request() * requests)
    sent = 0
    with await connect(served.port, 4096) as peer:
        until = time.monotonic() + seconds
        while sent < len(data) and time.monotonic() < until:
            try:
                sent += peer.send(data[sent : sent + (1 << 16)])
            except BlockingIOError:
                await asyncio.sleep(0.05)
            except OSError:
                break
        await asyncio.sleep(max(until - time.monotonic(), 0))
        with await connect(served.port) as other:
            await ask(served, other, random.Random(1))
    del loop
    return sent


async def burst(served: Served, count: int) -> None:
    """Ask on many connections, one after the other, each closed by the client."""
    rng = random.Random(2)
    for _ in range(count):
        try:
            with await asyncio.wait_for(connect(served.port), 10) as peer:
                await ask(served, peer, rng)
        except (OSError, TimeoutError) as error:
            served.figures.wrong.append(f"burst: {type(error).__name__} {error}")
            return


async def aborted(served: Served, count: int) -> None:
    """Break off many downloads, with a reset."""
    for _ in range(count):
        with await connect(served.port, 4096) as peer:
            await asyncio.get_running_loop().sock_sendall(peer, served.request())
            await asyncio.sleep(0.005)
            linger = b"\1\0\0\0\0\0\0\0"
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=["serve", "view"])
    parser.add_argument("--held", type=int, default=500)
    parser.add_argument("--per-minute", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--requests", type=int, default=100_000)
    parser.add_argument("--flood", type=int, default=1500)
    parser.add_argument("--burst", type=int, default=1300)
    parser.add_argument("--descriptors", type=int, default=1024)
    parser.add_argument("--only", choices=["crowd", "flood", "pipeline", "burst", "aborted"])
    chosen = parser.parse_args()
    runs = {
        "crowd": lambda s: crowd(s, chosen.held, chosen.per_minute, chosen.seconds),
        "flood": lambda s: crowd(
            s, chosen.flood, chosen.per_minute, chosen.seconds / 2, ("unread",)
        ),
        "pipeline": lambda s: pipeline(s, chosen.requests, 20),
        "burst": lambda s: burst(s, chosen.burst),
        "aborted": lambda s: aborted(s, 100),
    }
    for name, run in runs.items():
        if chosen.only not in (None, name):
            continue
        with (
            tempfile.TemporaryDirectory() as folder,
            server_process(chosen.kind, Path(folder), chosen.descriptors) as served,
        ):
            before = served.rss()
            result = asyncio.run(run(served))
        shown = {"result": result, "resident before, MB": round(before / 1e6, 1)}
        print(f"{chosen.kind} {name}:", json.dumps(shown | served.figures.report(), indent=1))


if __name__ == "__main__":
    main()
