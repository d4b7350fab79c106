"""Mutations of files that keep enough of their structure to get past the first check.

Bytes are flipped, cut and overwritten by numbers that readers trip over; JSON gets other values;
what is packed (gzip, zstd, ZIP, glTF's chunks) is changed inside and packed again; and segments
and roots of COGS files get the CRCs of what they became.
"""

import gzip
import io
import json
import random
import struct
import zipfile
import zlib

import zstandard

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.cogs.layout import MAGIC, PREAMBLE_BYTES
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.storage.magic import MANIFEST_MAGIC
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance.file_builder import (
    poke,
    replace_payloads,
    seal,
    split_root,
    with_root,
)

NUMBERS = (0, 1, 2, 3, 127, 128, 255, 256, 65535, 65536, 1 << 18, 1 << 24, (1 << 24) + 1,
           (1 << 31) - 1, 1 << 31, (1 << 32) - 1)  # fmt: skip
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e-38, 1e38, 3e38, float("inf"), float("-inf"), float("nan"))
VALUES = (None, True, False, 0, 1, -1, 2, 255, 256, 1 << 31, 1 << 53, 10**30, 0.5, -0.0, 1e308,
          1e-308, "", "a", "../a", "/a", "data:", "é\U0001f600", "\x1b[2J", [], [[]], {},
          {"a": 0})  # fmt: skip
WORDS = (b"-1", b"0", b"1e999", b"nan", b"4294967296", b"\n", b" ", b"\0", b"\x1b[2J", b"\xff",
         b"9" * 400)  # fmt: skip

# What is inflated to be changed inside; a bomb stays packed.
_MAX_INFLATED = 1 << 16


def mutated(data: bytes, seed: int, max_size: int = 1 << 16) -> bytes:
    """Return a file changed in one to four places, the same for the same seed."""
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 4)):
        data = _inside(data, rng) if rng.random() < 0.6 else _bytes(data, rng)
    return data[:max_size]


def _inside(data: bytes, rng: random.Random) -> bytes:
    """Change what a file wraps, or its bytes where it wraps nothing that is known."""
    if data.startswith(b"\x1f\x8b"):
        return _in_gzip(data, rng)
    if data.startswith(b"PK"):
        return _in_zip(data, rng)
    if data.startswith(MAGIC):
        return _in_cogs(data, rng)
    if data.startswith(MANIFEST_MAGIC):
        return _in_manifest(data, rng)
    if data.startswith(b"glTF"):
        return _in_glb(data, rng)
    if data.startswith(b"NGSP"):
        return _in_spz(data, rng)
    if data.startswith(b"\x89PNG"):
        return _in_png(data, rng)
    if data[:1] in (b"{", b"["):
        return _in_json(data, rng)
    # An input of several files, the first behind its length.
    length = int.from_bytes(data[:4], "little")
    if len(data) > 5 and length <= len(data) - 4:
        if rng.random() < 0.5:
            first = _inside(data[4 : 4 + length], rng) if length else b""
            return struct.pack("<I", len(first)) + first + data[4 + length :]
        return data[: 4 + length] + _bytes(data[4 + length :], rng)
    return _bytes(data, rng)


def _bytes(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    # Headers decide what is done with the rest: half of all changes are among the first bytes.
    at = rng.randrange(min(len(out), rng.choice((64, 1 << 30))) + 1)
    match rng.randrange(8):
        case 0 if at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        case 1:
            del out[at : at + rng.randint(1, 16)]
        case 2:
            del out[at:]
        case 3:
            out[at:at] = rng.randbytes(rng.randint(1, 8))
        case 4:
            out[at : at + 4] = struct.pack("<I", rng.choice(NUMBERS))
        case 5:
            out[at : at + 2] = struct.pack("<H", rng.choice(NUMBERS) & 0xFFFF)
        case 6:
            out[at : at + 4] = struct.pack("<f", rng.choice(FLOATS))
        case _:
            out[at:at] = rng.choice(WORDS)
    return bytes(out)


def _in_gzip(data: bytes, rng: random.Random) -> bytes:
    try:
        inner = zlib.decompressobj(31).decompress(data, _MAX_INFLATED)
    except zlib.error:
        return _bytes(data, rng)
    return gzip.compress(_bytes(inner, rng), 1, mtime=0)


def _in_zip(data: bytes, rng: random.Random) -> bytes:
    out = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if any(entry.file_size > _MAX_INFLATED for entry in archive.infolist()):
                return _bytes(data, rng)
            files = {name: archive.read(name) for name in archive.namelist()}
            stored = max((entry.compress_type for entry in archive.infolist()), default=0)
    # Damaged by an earlier change, in one of the many ways that zipfile has of saying so.
    except Exception:
        return _bytes(data, rng)
    if not files:
        return _bytes(data, rng)
    chosen = rng.choice(sorted(files))
    files[chosen] = _inside(files[chosen], rng)
    # What is stored may have to stay so to be read.
    method = rng.choice((stored, stored, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _in_cogs(data: bytes, rng: random.Random) -> bytes:
    """Change a segment, or the root, and give it the CRCs and hashes that fit."""
    try:
        index = read_scene_index(BytesSource(data), partial=False)
        if not len(index.segments) or rng.random() < 0.3:
            root, behind = split_root(data)
            return with_root(_bytes(root, rng), behind)
        row = rng.randrange(len(index.segments))
        start = int(index.offsets[row])
        payload = data[start : start + int(index.segments.length[row])]
        return replace_payloads(data, {row: _bytes(payload, rng)})
    # Damaged by an earlier change.
    except (CogsplatError, ValueError, LookupError, struct.error):
        return _bytes(data, rng)


def _in_manifest(data: bytes, rng: random.Random) -> bytes:
    """Change the root of a manifest, or the tables behind it, with the CRCs that fit."""
    if len(data) < PREAMBLE_BYTES:
        return _bytes(data, rng)
    root, behind = split_root(data)
    if rng.random() < 0.4:
        root = _bytes(root, rng)
    elif rng.random() < 0.3 or len(behind) < 8:
        behind = _bytes(behind, rng)
    else:
        # A table of places ends in its CRC; without pages there is one.
        places = bytearray(behind[:-4])
        at = rng.randrange(len(places))
        number = struct.pack("<I", rng.choice(NUMBERS))
        places[at : at + 4] = number[: len(places) - at]
        behind = bytes(places) + struct.pack("<I", zlib.crc32(places))
    head = poke(data[:PREAMBLE_BYTES], 12, "I", len(root))
    return seal(poke(head, 24, "I", zlib.crc32(root))) + root + behind


def _in_glb(data: bytes, rng: random.Random) -> bytes:
    chunks = []
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        chunks.append((kind, data[at + 8 : at + 8 + length]))
        at += 8 + length
    if not chunks:
        return _bytes(data, rng)
    index = rng.randrange(len(chunks)) if rng.random() < 0.3 else 0
    kind, content = chunks[index]
    chunks[index] = kind, _in_json(content, rng) if index == 0 else _bytes(content, rng)
    body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _in_spz(data: bytes, rng: random.Random) -> bytes:
    """Change a stream of version 4 and pack it again, with sizes that fit."""
    try:
        count, toc = data[15], struct.unpack_from("<I", data, 16)[0]
        sizes = [struct.unpack_from("<QQ", data, toc + 16 * k) for k in range(min(count, 6))]
        at = toc + 16 * len(sizes)
        frames = []
        for stored, _ in sizes:
            frames.append(data[at : at + stored])
            at += stored
        chosen = rng.randrange(len(frames))
        inner = zstandard.ZstdDecompressor().decompress(frames[chosen], _MAX_INFLATED)
    except (struct.error, IndexError, ValueError, zstandard.ZstdError):
        return _bytes(data, rng)
    inner = _bytes(inner, rng)
    frames[chosen] = zstandard.compress(inner, 1)
    entries = [(len(f), len(inner) if k == chosen else sizes[k][1]) for k, f in enumerate(frames)]
    return b"".join([data[:toc], *(struct.pack("<QQ", *entry) for entry in entries), *frames])


def _in_png(data: bytes, rng: random.Random) -> bytes:
    """Change a chunk and give it a right CRC."""
    chunks = []
    at = 8
    while at + 12 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    if not chunks:
        return _bytes(data, rng)
    index = rng.randrange(len(chunks))
    kind, content = chunks[index]
    chunks[index] = kind, _bytes(content, rng)
    if rng.random() < 0.2:
        chunks.insert(rng.randrange(len(chunks) + 1), chunks[index])
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )


def _in_json(data: bytes, rng: random.Random) -> bytes:
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return _bytes(data, rng)
    if not isinstance(value, dict | list):
        return _bytes(data, rng)
    place, key = value, None
    for _ in range(rng.randint(1, 8)):
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            break
        key = rng.choice(keys)
        if not isinstance(place[key], dict | list) or not place[key]:
            break
        if rng.random() < 0.85:
            place = place[key]
            key = None
    if key is None:
        return json.dumps(value, separators=(",", ":")).encode()
    match rng.randrange(4):
        case 0:
            del place[key]
        case 1 if isinstance(place, list):
            place += [place[key]] * rng.randint(1, 20)
        case 2 if isinstance(place[key], int | float):
            place[key] = place[key] * rng.choice((-1, 2, 0.5, 1e30)) + rng.choice((0, 1, -1))
        case _:
            place[key] = rng.choice(VALUES)
    return json.dumps(value, separators=(",", ":")).encode()
