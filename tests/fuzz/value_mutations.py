"""Mutations of stored values that keep sizes, types and checksums consistent.

Readers accept most of the mutated files, so that the checks of decoded scenes run as well.
"""

import io
import json
import random
import struct
import zipfile
import zlib

import numpy as np
import zstandard
from targets import joined, split

from cogsplat.formats.storage.images import decode_image, encode_image


def with_other_values(target: str, data: bytes, seed: int) -> bytes:
    """Return a file of a target with some values changed, the same for the same seed."""
    rng = random.Random(seed)
    match target:
        case "ply" | "compressed_ply":
            head, end, body = data.partition(b"end_header\n")
            return head + end + (_flipped(body, rng) if b"ascii" not in head else body)
        case "splat":
            return _flipped(data, rng)
        case "ksplat":
            # A header of 4 KiB, and one of a KiB for each of its sections.
            return data[:5120] + _flipped(data[5120:], rng)
        case "spz":
            return _in_spz(data, rng)
        case "glb":
            length = struct.unpack_from("<I", data, 12)[0]
            start = 20 + length + 8
            return data[:start] + _flipped(data[start:], rng)
        case "gltf":
            page, buffer = split(data, 2)
            return joined(page, _flipped(buffer, rng))
        case "sog" | "pt":
            return _in_zip(data, rng)
        case "description":
            page, picture = split(data, 2)
            value = json.loads(page)
            value["metres_per_unit"] = rng.uniform(0.1, 9)
            for annotation in value.get("annotations", ()):
                annotation["place"] = [rng.uniform(-9, 9) for _ in range(3)]
            return joined(json.dumps(value).encode(), picture)
        case "settings":
            value = json.loads(data)
            value["background"] = {"color": [rng.uniform(0, 1) for _ in range(3)]}
            return json.dumps(value).encode()
        case "cameras_json":
            return json.dumps(_scaled(json.loads(data), rng)).encode()
        case "transforms_json":
            page, picture = split(data, 2)
            value = json.loads(page)
            for frame in value["frames"]:
                # Where a camera stands; the rest of the matrix has to be a rotation.
                for row in frame["transform_matrix"][:3]:
                    row[3] = rng.uniform(-9, 9)
            return joined(json.dumps(value).encode(), picture)
        case "colmap_bin":
            cameras, images = split(data, 2)
            # Behind the count and a camera's number, model and size: its parameters.
            return joined(cameras[:32] + _scaled_doubles(cameras[32:], rng), images)
        case "colmap_txt":
            cameras, images = split(data, 2)
            # Where the images stand, behind their numbers and quaternions.
            place = " ".join(f"{rng.uniform(-9, 9):.3f}" for _ in range(3))
            return joined(
                cameras, images.replace(b"1 0 0 0 0 0 0 1", f"1 0 0 0 {place} 1".encode())
            )
        case "points_bin":
            # Behind the count and the first point's number: where it is.
            return data[:16] + _scaled_doubles(data[16:40], rng) + data[40:]
        case "points_txt":
            place = " ".join(f"{rng.uniform(-9, 9):.3f}" for _ in range(2))
            return data.replace(b"4 0.5 -1 ", f"4 {place} ".encode())
    raise AssertionError(f"{target}: no values are known")


def _flipped(data: bytes, rng: random.Random) -> bytes:
    """Flip some bits and keep the length; of floats none of the highest, which make infinities."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 6) if out else 0):
        at = rng.randrange(len(out))
        # The highest byte of a float holds most of its exponent, the next one its last bit.
        if at % 4 < 2:
            out[at] ^= 1 << rng.randrange(8)
    return bytes(out)


def _in_spz(data: bytes, rng: random.Random) -> bytes:
    if data.startswith(b"\x1f\x8b"):
        inner = zlib.decompress(data, 31)
        deflater = zlib.compressobj(1, zlib.DEFLATED, 31)
        return deflater.compress(inner[:16] + _flipped(inner[16:], rng)) + deflater.flush()
    count, toc = data[15], struct.unpack_from("<I", data, 16)[0]
    sizes = [struct.unpack_from("<QQ", data, toc + 16 * k) for k in range(count)]
    at = toc + 16 * count
    frames = []
    for stored, _ in sizes:
        inner = zstandard.ZstdDecompressor().decompress(data[at : at + stored])
        frames.append(zstandard.compress(_flipped(inner, rng), 1))
        at += stored
    entries = [
        struct.pack("<QQ", len(frame), size) for frame, (_, size) in zip(frames, sizes, strict=True)
    ]
    return b"".join([data[:toc], *entries, *frames])


def _in_zip(data: bytes, rng: random.Random) -> bytes:
    """Change the pixels of the images of a SOG bundle, or the storages of a checkpoint."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    chosen = rng.choice([name for name in files if name.endswith(".webp") or "/data/" in name])
    if chosen.endswith(".webp"):
        pixels = decode_image(files[chosen], chosen)
        changed = np.frombuffer(_flipped(pixels.tobytes(), rng), np.uint8)
        files[chosen] = encode_image(changed.reshape(pixels.shape), chosen)
    else:
        files[chosen] = _flipped(files[chosen], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _scaled(value: object, rng: random.Random) -> object:
    """Return a JSON value whose fractions are a little larger or smaller."""
    if isinstance(value, dict):
        return {key: _scaled(inner, rng) for key, inner in value.items()}
    if isinstance(value, list):
        return [_scaled(inner, rng) for inner in value]
    return value * (1 + rng.uniform(-1e-7, 1e-7)) if isinstance(value, float) else value


def _scaled_doubles(data: bytes, rng: random.Random) -> bytes:
    count = len(data) // 8
    values = struct.unpack(f"<{count}d", data[: 8 * count])
    scaled = (value * (1 + rng.uniform(-1e-7, 1e-7)) for value in values)
    return struct.pack(f"<{count}d", *scaled) + data[8 * count :]
