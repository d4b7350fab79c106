"""Files made to cost a reader far more than their size, each small to make.

Every maker writes into a folder and returns the path to read. Sizes are parameters, so that a test
can ask for one that is refused at once and a measurement for the full one.
"""

import gzip
import io
import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import zstandard
from PIL import Image

EXTENSION = "KHR_gaussian_splatting"
MIB = 1 << 20


def flat_webp(side: int) -> bytes:
    """A lossless WebP of one colour, whose alpha is a legal index of a quaternion."""
    out = io.BytesIO()
    pixels = np.full((side, side, 4), 255, np.uint8)
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def lying_zip(files: dict[str, bytes], claimed: dict[str, int]) -> bytes:
    """A ZIP of deflated files whose directory claims other compressed sizes for some."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    data = bytearray(out.getvalue())
    at = 0
    while (at := data.find(b"PK\x01\x02", at)) >= 0:
        length = struct.unpack_from("<H", data, at + 28)[0]
        name = bytes(data[at + 46 : at + 46 + length]).decode()
        if name in claimed:
            struct.pack_into("<I", data, at + 20, claimed[name])
        at += 46 + length
    return bytes(data)


def sog_meta(count: int, image: str) -> dict[str, object]:
    """A meta.json that names one image for everything, without SH above DC."""
    codebook = [k / 256 for k in range(256)]
    return {
        "version": 2,
        "count": count,
        "means": {"mins": [0, 0, 0], "maxs": [1, 1, 1], "files": [image, image]},
        "scales": {"codebook": codebook, "files": [image]},
        "quats": {"files": [image]},
        "sh0": {"codebook": codebook, "files": [image]},
    }


def sog_of_one_entry(folder: Path, *, side: int, count: int, inflated: int) -> Path:
    """A bundle in which all images are one entry that inflates a thousandfold."""
    entry = flat_webp(side)
    entry += bytes(max(0, inflated - len(entry)))
    files = {"meta.json": json.dumps(sog_meta(count, "i.webp")).encode(), "i.webp": entry}
    path = folder / "one_entry.sog"
    path.write_bytes(lying_zip(files, {}))
    return path


def sog_of_overlapping_entries(folder: Path) -> Path:
    """A bundle whose directory says that an image goes on where the directory begins."""
    files = {"meta.json": json.dumps(sog_meta(9, "i.webp")).encode(), "i.webp": flat_webp(16)}
    path = folder / "overlapping.sog"
    path.write_bytes(lying_zip(files, {"i.webp": 4096}))
    return path


def sog_of_many_entries(folder: Path, *, entries: int) -> Path:
    """A bundle whose directory lists very many files without bytes."""
    record = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    start = b"PK\x03\x04" + bytes(26)
    directory = record * entries
    count = min(entries, 0xFFFF)
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, count, count, len(directory), len(start), 0)
    path = folder / "many_entries.sog"
    path.write_bytes(start + directory + end)
    return path


def glb(root: dict[str, object], binary: bytes) -> bytes:
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf_root(splats: int, primitives: int, *, degree: int = 0) -> tuple[dict[str, object], bytes]:
    """A scene whose primitives all name the same accessors, over one run of float32 ones."""
    names = ["POSITION", f"{EXTENSION}:SCALE", f"{EXTENSION}:SH_DEGREE_0_COEF_0"]
    for band in range(1, degree + 1):
        names += [f"{EXTENSION}:SH_DEGREE_{band}_COEF_{m}" for m in range(2 * band + 1)]
    attributes = dict.fromkeys(names, 0)
    attributes |= {f"{EXTENSION}:ROTATION": 1, f"{EXTENSION}:OPACITY": 2}
    binary = np.full(4 * splats, 0.5, "<f4").tobytes()
    primitive = {"mode": 0, "attributes": attributes, "extensions": {EXTENSION: {}}}
    root: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive] * primitives}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": splats, "type": kind}
            for kind in ("VEC3", "VEC4", "SCALAR")
        ],
        "bufferViews": [{"buffer": 0, "byteLength": len(binary)}],
        "buffers": [{"byteLength": len(binary)}],
    }
    return root, binary


def gltf_of_shared_accessors(
    folder: Path, *, splats: int, primitives: int, degree: int = 0
) -> Path:
    path = folder / "shared_accessors.glb"
    path.write_bytes(glb(*gltf_root(splats, primitives, degree=degree)))
    return path


def gltf_with_node(folder: Path, node: dict[str, object]) -> Path:
    """A scene of one primitive whose node has a transform of its own."""
    root, binary = gltf_root(2, 1)
    root["nodes"] = [{"mesh": 0, **node}]
    path = folder / "node.glb"
    path.write_bytes(glb(root, binary))
    return path


def gltf_of_empty_arrays(folder: Path, *, arrays: int) -> Path:
    """A .gltf that is valid but for very many empty arrays beside what counts."""
    root, _ = gltf_root(2, 1)
    root["extras"] = [[]] * arrays
    path = folder / "arrays.gltf"
    path.write_text(json.dumps(root, separators=(",", ":")), encoding="utf-8")
    return path


def spz_of_zeros(
    folder: Path, *, version: int, splats: int, degree: int = 3, padding: int = 0
) -> Path:
    """An SPZ of splats that are all the same, and of version 4 an extension that nobody reads."""
    rows = [
        6 if version == 1 else 9,
        1,
        3,
        3,
        4 if version >= 3 else 3,
        3 * ((degree + 1) ** 2 - 1),
    ]
    flags = 2 if padding else 0
    head = struct.pack("<4sIIBBB", b"NGSP", version, splats, degree, 12, flags)
    extensions = struct.pack("<II", 1, padding) + bytes(padding) if padding else b""
    path = folder / f"zeros_{version}.spz"
    if version < 4:
        deflater = zlib.compressobj(9, zlib.DEFLATED, 31)
        with path.open("wb") as file:
            file.write(deflater.compress(head + b"\0"))
            for row in rows:
                left = row * splats
                while left:
                    file.write(deflater.compress(bytes(min(left, MIB))))
                    left -= min(left, MIB)
            file.write(deflater.flush())
        return path
    full = [row * splats for row in rows if row]
    frames = []
    for size in full:
        packer = zstandard.ZstdCompressor(level=3).compressobj(size=size)
        pieces = [packer.compress(bytes(min(MIB, size - k))) for k in range(0, size, MIB)]
        frames.append(b"".join([*pieces, packer.flush()]))
    toc = [struct.pack("<QQ", len(f), s) for f, s in zip(frames, full, strict=True)]
    start = struct.pack("<BI12x", len(full), 32 + len(extensions))
    path.write_bytes(b"".join([head, start, extensions, *toc, *frames]))
    return path


CAMERA = {
    "width": 4,
    "height": 4,
    "fx": 4.0,
    "fy": 4.0,
    "position": [0, 0, 0],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}


def cameras_json_of_empty_arrays(folder: Path, *, size: int) -> Path:
    """A cameras.json of one camera with very many empty arrays in a key that nobody reads."""
    text = json.dumps([CAMERA])
    path = folder / "arrays.json"
    path.write_text(f'{text[:-2]}, "more": [{"[]," * ((size - len(text)) // 3)}[]]}}]')
    return path


def cameras_json_of_many(folder: Path, *, cameras: int) -> Path:
    path = folder / "many.json"
    entry = json.dumps(CAMERA, separators=(",", ":"))
    path.write_text("[" + ",".join([entry] * cameras) + "]")
    return path


def transforms_json_of_one_picture(folder: Path, *, frames: int) -> Path:
    """A transforms.json whose frames all take their size from one picture."""
    out = io.BytesIO()
    Image.new("L", (4, 4)).save(out, "PNG")
    (folder / "p.png").write_bytes(out.getvalue() + bytes(MIB))
    matrix = np.eye(4).tolist()
    entries = [{"file_path": "p.png", "transform_matrix": matrix}] * frames
    path = folder / "transforms.json"
    path.write_text(json.dumps({"fl_x": 4, "frames": entries}, separators=(",", ":")))
    return path


def colmap(folder: Path, *, images: int) -> Path:
    """A binary model of one lens and many images."""
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<QIiQQ4d", 1, 1, 1, 4, 4, 4.0, 4.0, 2.0, 2.0))
    record = struct.pack("<I7dI", 7, 1, 0, 0, 0, 0, 0, 0, 1) + b"i.png\0" + struct.pack("<Q", 0)
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", images))
        file.write(record * images)
    return folder


def colmap_with_long_line(folder: Path, *, size: int) -> Path:
    """A model in text whose only image has a name of `size` bytes."""
    (folder / "cameras.txt").write_text("1 PINHOLE 4 4 4 4 2 2\n")
    with (folder / "images.txt").open("wb") as file:
        file.write(b"1 1 0 0 0 0 0 0 1 " + b"n" * size + b"\n\n")
    return folder


def ply_of_empty_lists(folder: Path, *, lists: int) -> Path:
    """A big-endian PLY of one splat behind an element of lists without items."""
    names = [*"xyz", "opacity", *(f"f_dc_{k}" for k in range(3))]
    names += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    lines = ["ply", "format binary_big_endian 1.0", f"element face {lists}"]
    lines += ["property list uchar int v", "element vertex 1"]
    lines += [f"property float {name}" for name in names]
    path = folder / "lists.ply"
    path.write_bytes(
        "\n".join([*lines, "end_header\n"]).encode() + bytes(lists) + np.ones(14, ">f4").tobytes()
    )
    return path


def png_with_text_bomb(path: Path, *, side: int, inflated: int) -> Path:
    """A grey PNG with a compressed comment that inflates to `inflated` bytes."""
    out = io.BytesIO()
    Image.new("L", (side, side)).save(out, "PNG")
    data = out.getvalue()
    body = b"zTXtComment\0\0" + zlib.compress(bytes(inflated), 9)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    path.write_bytes(data[:33] + chunk + data[33:])
    return path


def eps(path: Path, *, side: int) -> Path:
    """A picture in PostScript under another name."""
    path.write_bytes(
        b"%!PS-Adobe-3.0 EPSF-3.0\n"
        + f"%%BoundingBox: 0 0 {side} {side}\n%%EndComments\n".encode()
        + b"showpage\n"
    )
    return path


def gzip_of(data: bytes) -> bytes:
    return gzip.compress(data, mtime=0)
