"""Write or check the conformance vectors in tests/vectors and the lists of vectors in SPEC.md.

Run ``python -m cogsplat.tools.lab.make_vectors`` after every change of the format, and commit its
output with the change. ``--check`` writes nothing and reports differences. It compares decoded
values and refusals always, and bytes if the installed zstd has the version of the manifest.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import msgpack
import zstandard

from cogsplat.formats.cogs.layout import MAJOR, MINOR
from cogsplat.tools.lab.conformance import (
    attribute_vectors,
    compensation_vectors,
    description_vectors,
    drawing_vectors,
    file_fault_order,
    folder_vectors,
    invalid_boxes,
    level_vectors,
    msgpack_vectors,
    payload_fault_order,
    reference_decoder,
    reference_drawing,
    refinement_vectors,
    view_table_vectors,
    worked_example,
    zstd_header_vectors,
)
from cogsplat.tools.lab.conformance import invalid_payload as payloads
from cogsplat.tools.lab.conformance import invalid_root as roots
from cogsplat.tools.lab.conformance import invalid_tables as tables
from cogsplat.tools.lab.conformance import invalid_transform as transform
from cogsplat.tools.lab.conformance.annotated_dump import dump
from cogsplat.tools.lab.conformance.invalid import Invalid
from cogsplat.tools.lab.conformance.valid import SMALLEST, Valid
from cogsplat.tools.lab.conformance.valid import valid as plain_valid
from cogsplat.tools.lab.conformance.valid_transform import valid as transform_valid

_ROOT: Final = Path(__file__).resolve().parents[2]
VECTORS: Final = _ROOT / "tests" / "vectors"
SPEC: Final = _ROOT / "SPEC.md"

ATTRIBUTES: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")
"""Order of the arrays in a ``.f32`` file."""

INVALID: Final[tuple[Callable[[], list[Invalid]], ...]] = (
    roots.preambles,
    roots.packings,
    msgpack_vectors.invalid,
    roots.roots,
    tables.segment_tables,
    tables.chunk_tables,
    tables.codebook_tables,
    tables.index_pages,
    payloads.records,
    payloads.planes,
    zstd_header_vectors.invalid,
    payloads.grids,
    payloads.sorted_means,
    payloads.codebooks,
    payloads.heads_and_tails,
    transform.packings,
    transform.kinds,
    transform.bases,
    transform.large_planes,
    refinement_vectors.invalid_order,
    refinement_vectors.invalid,
    attribute_vectors.invalid_attributes,
    attribute_vectors.invalid_cameras,
    compensation_vectors.invalid,
    view_table_vectors.invalid,
    description_vectors.invalid,
    level_vectors.invalid_ends,
    level_vectors.invalid_levels,
    level_vectors.invalid_opacities,
    invalid_boxes.boxes,
    invalid_boxes.decoded_sizes,
    file_fault_order.invalid,
    payload_fault_order.invalid,
    payload_fault_order.invalid_unused,
)

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]


def valid_vectors() -> list[Valid]:
    """Return the valid vectors, in the order of the manifest."""
    return [
        *plain_valid(),
        *transform_valid(),
        worked_example.valid(),
        *refinement_vectors.valid(),
        *attribute_vectors.valid(),
        *compensation_vectors.valid(),
        *view_table_vectors.valid(),
        *description_vectors.valid(),
        *level_vectors.valid(),
        *msgpack_vectors.valid(),
        *zstd_header_vectors.valid(),
    ]


VIEWERS_MAY_IGNORE: Final[tuple[Callable[[], list[Invalid]], ...]] = (
    attribute_vectors.invalid_attributes,
    attribute_vectors.invalid_cameras,
    compensation_vectors.invalid,
    view_table_vectors.invalid,
    description_vectors.invalid,
    invalid_boxes.decoded_sizes,
)
"""Vectors of content that viewers may ignore (SPEC 8.6); viewers need not refuse them."""


def invalid_vectors() -> list[Invalid]:
    """Return the must-reject vectors, in the order of the manifest."""
    return [vector for make in INVALID for vector in make()]


def conformance_levels() -> dict[str, str]:
    """Return the lowest conformance level that must refuse each file, by name (SPEC 1.4)."""
    aside = {vector.name for make in VIEWERS_MAY_IGNORE for vector in make()}
    return {
        vector.name: "verifier"
        if vector.stage == "verify"
        else ("reader" if vector.name in aside else "viewer")
        for vector in invalid_vectors()
    }


def valid_folders() -> list[folder_vectors.ValidFolder]:
    """Return the valid folders, in the order of the manifest."""
    return folder_vectors.valid({vector.name: vector.data for vector in valid_vectors()})


def invalid_folders() -> list[folder_vectors.InvalidFolder]:
    """Return the must-reject folders, in the order of the manifest."""
    return folder_vectors.invalid({vector.name: vector.data for vector in valid_vectors()})


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _shapes(scene: reference_decoder.Scene) -> dict[str, list[int]]:
    count = len(scene.rows["means"])
    widths = {"means": [3], "scales": [3], "quats": [4], "opacities": [], "sh0": [3]}
    widths["shN"] = [(scene.sh_degree + 1) ** 2 - 1, 3]
    return {name: [count, *widths[name]] for name in ATTRIBUTES}


def _array_bytes(scene: reference_decoder.Scene) -> bytes:
    values = [value for name in ATTRIBUTES for row in scene.rows[name] for value in row]
    return struct.pack(f"<{len(values)}f", *values)


def _rows_sha256(rows: reference_decoder.Rows) -> str:
    values = [value for name in ATTRIBUTES for row in rows[name] for value in row]
    return _sha256(struct.pack(f"<{len(values)}f", *values))


_INFO: Final = ("origin", "axes", "colour_space", "kernel_px", "antialiased", "first_view", "up",
                "core_box")  # fmt: skip


def _valid_entry(vector: Valid) -> tuple[dict[str, Json], bytes]:
    """Return the manifest's entry of a valid vector, and its arrays as bytes."""
    scene = reference_decoder.decode(vector.data)
    arrays = _array_bytes(scene)
    (root_length,) = struct.unpack_from("<I", vector.data, 12)
    root = msgpack.unpackb(vector.data[64 : 64 + root_length])
    entry: dict[str, Json] = {
        "name": vector.name,
        "note": vector.note,
        "clauses": list(vector.covers),
        "bytes": len(vector.data),
        "sha256": _sha256(vector.data),
        "splats": len(scene.rows["means"]),
        "sh_degree": scene.sh_degree,
        "chunk_splats": list(scene.chunk_splats),
        "info": {key: root[key] for key in _INFO if key in root},
        "arrays_sha256": _sha256(arrays),
        "shapes": {name: list(shape) for name, shape in _shapes(scene).items()},
        "prefixes": [[p.size, p.chunks, list(p.tails), list(p.refined)] for p in scene.prefixes],
    }
    coarse = _array_bytes(reference_decoder.decode(vector.data, refine=False))
    if coarse != arrays:
        entry["coarse_sha256"] = _sha256(coarse)
    if any(scene.until):
        entry["until"] = list(scene.until)
    if scene.levels:
        entry["levels"] = [
            [scale, chunks, _rows_sha256(rows)] for scale, chunks, rows in scene.levels
        ]
    if scene.drawn:
        entry["drawn"] = [_rows_sha256(rows) for rows in scene.drawn]
    if scene.attributes:
        entry["attributes"] = [list(kind) for kind in scene.attributes]
        entry["attribute_chunks"] = [
            [chunk, [_sha256(values) for values in parts]]
            for chunk, parts in scene.attribute_values.items()
        ]
    if scene.compensated:
        entry["compensated"] = [
            [chunks, _sha256(struct.pack(f"<{len(values)}f", *values))]
            for chunks, values in scene.compensated.items()
        ]
    if scene.compensated_sets:
        entry["compensated_sets"] = [
            [list(chosen), _sha256(struct.pack(f"<{len(values)}f", *values))]
            for chosen, values in scene.compensated_sets
        ]
    if scene.cameras:
        cameras: list[Json] = [_camera(camera) for camera in scene.cameras]
        entry["cameras"] = cameras
    if scene.view_tables:
        entry["view_tables"] = [
            [list(path), [[list(position), list(shares)] for position, shares in table]]
            for path, table in scene.view_tables
        ]
    if scene.parents:
        entry["parents"] = list(scene.parents)
    if scene.description is not None:
        entry["description"] = scene.description
        entry["pictures"] = {
            name: [*header, _sha256(data)] for name, (header, data) in scene.pictures.items()
        }
    return entry, arrays


def _camera(camera: reference_decoder.Camera) -> Json:
    return {key: list(value) if isinstance(value, list) else value for key, value in camera.items()}


def _invalid_entry(vector: Invalid, level: str) -> dict[str, Json]:
    return {
        "name": vector.name,
        "note": vector.note,
        "code": vector.code,
        "clause": vector.clause,
        "stage": vector.stage,
        "level": level,
        "partial": vector.partial,
        "bytes": len(vector.data),
        "sha256": _sha256(vector.data),
    }


def _invalid_folder_entry(folder: folder_vectors.InvalidFolder) -> dict[str, Json]:
    return {
        "name": folder.name,
        "note": folder.note,
        "code": folder.code,
        "clause": folder.clause,
        "stage": folder.stage,
        "partial": folder.partial,
    }


def _drawing_entry(drawing: drawing_vectors.Drawing, picture: bytes) -> dict[str, Json]:
    camera: dict[str, Json] = asdict(drawing.camera)
    return {
        "name": drawing.name,
        "scene": drawing.scene,
        "note": drawing.note,
        "camera": camera,
        "sha256": _sha256(picture),
    }


def _manifest_text(manifest: Mapping[str, Json]) -> str:
    """Return the manifest as JSON, one vector per line."""
    parts = []
    for key, value in manifest.items():
        if isinstance(value, list):
            lines = ",\n".join(
                json.dumps(entry, ensure_ascii=False, separators=(",", ":")) for entry in value
            )
            parts.append(f"{json.dumps(key)}: [\n{lines}\n]")
        else:
            parts.append(f"{json.dumps(key)}: {json.dumps(value)}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def make_vectors() -> tuple[dict[str, Json], dict[str, bytes]]:
    """Return the manifest, and file contents by path below `VECTORS`."""
    files: dict[str, bytes] = {}
    good: list[Json] = []
    for vector in valid_vectors():
        entry, arrays = _valid_entry(vector)
        good.append(entry)
        files[f"valid/{vector.name}.cogs"] = vector.data
        files[f"valid/{vector.name}.f32"] = arrays
    bad: list[Json] = []
    level_of = conformance_levels()
    for refused in invalid_vectors():
        bad.append(_invalid_entry(refused, level_of[refused.name]))
        files[f"invalid/{refused.name}.cogs"] = refused.data
    good_folders: list[Json] = []
    for folder in valid_folders():
        stands_for: dict[str, Json] = {**folder.stands_for}
        good_folders.append({"name": folder.name, "note": folder.note, "manifests": stands_for})
        files |= {f"folders/{folder.name}/{name}": x for name, x in folder.objects.items()}
    bad_folders: list[Json] = []
    for broken in invalid_folders():
        bad_folders.append(_invalid_folder_entry(broken))
        files |= {f"invalid-folders/{broken.name}/{n}": x for n, x in broken.objects.items()}
    scenes = drawing_vectors.scenes()
    files |= {f"drawings/{name}.cogs": data for name, data in scenes.items()}
    pictures: list[Json] = []
    for drawing in drawing_vectors.drawings():
        values = reference_drawing.draw(scenes[drawing.scene], drawing.camera)
        picture = struct.pack(f"<{len(values)}f", *values)
        pictures.append(_drawing_entry(drawing, picture))
        files[f"drawings/{drawing.name}.f32"] = picture
    manifest: dict[str, Json] = {
        "format": f"{MAJOR}.{MINOR}",
        "zstd": ".".join(str(part) for part in zstandard.ZSTD_VERSION),
        "arrays": list(ATTRIBUTES),
        "valid": good,
        "invalid": bad,
        "folders": good_folders,
        "invalid_folders": bad_folders,
        "drawings": pictures,
    }
    return manifest, files


def spec_blocks() -> dict[str, str]:
    """Return the generated blocks of SPEC, by the name in their markers."""
    good, bad = valid_vectors(), invalid_vectors()
    smallest = next(vector for vector in good if vector.name == SMALLEST)
    listed = ["| file | clauses | what |", "|---|---|---|"]
    listed += [f"| `{v.name}` | {', '.join(v.covers)} | {v.note} |" for v in good]
    refused = ["| reason code | files |", "|---|---|"]
    for code in sorted({vector.code for vector in bad}):
        names = [f"`{vector.name}`" for vector in bad if vector.code == code]
        refused.append(f"| `{code}` | {', '.join(names)} |")
    return {
        "dump": "\n".join(["```text", *dump(smallest.data), "```"]),
        "worked": "\n".join(["```text", *worked_example.lines(), "```"]),
        "valid": "\n".join(listed),
        "invalid": "\n".join(refused),
        "folders": "\n".join(_folder_lists()),
        "drawings": "\n".join(_drawing_list()),
    }


def _folder_lists() -> list[str]:
    lines = ["| folder | what |", "|---|---|"]
    lines += [f"| `{folder.name}` | {folder.note} |" for folder in valid_folders()]
    lines += ["", "| folder to refuse | reason code | what |", "|---|---|---|"]
    lines += [f"| `{f.name}` | `{f.code}` | {f.note} |" for f in invalid_folders()]
    return lines


def _drawing_list() -> list[str]:
    lines = ["| picture | scene | size, px | what |", "|---|---|---|---|"]
    for drawing in drawing_vectors.drawings():
        size = f"{drawing.camera.width} × {drawing.camera.height}"
        lines.append(f"| `{drawing.name}` | `{drawing.scene}` | {size} | {drawing.note} |")
    return lines


def replace_blocks(text: str, blocks: Mapping[str, str]) -> str:
    """Return SPEC with the generated blocks between their markers replaced."""
    for name, block in blocks.items():
        first, last = f"<!-- vectors: {name} -->", "<!-- end of vectors -->"
        before, found, rest = text.partition(first)
        _, ended, behind = rest.partition(last)
        if not found or not ended:
            raise ValueError(f"no place for {name} between its markers")
        text = f"{before}{first}\n\n{block}\n\n{last}{behind}"
    return text


def differences() -> list[str]:
    """Compare the committed vectors with newly made ones; return a line per difference."""
    manifest, files = make_vectors()
    committed = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
    same_zstd = committed["zstd"] == manifest["zstd"]
    skipped = set() if same_zstd else {"bytes", "sha256", "prefixes"}

    def compared(entries: Sequence[Mapping[str, Json]]) -> dict[str, dict[str, Json]]:
        return {
            str(entry["name"]): {k: v for k, v in entry.items() if k not in skipped}
            for entry in entries
        }

    found = []
    for part in ("valid", "invalid", "folders", "invalid_folders", "drawings"):
        new: Json = manifest[part]
        old = compared(committed[part])
        fresh = compared(json.loads(json.dumps(new)))
        found += [
            f"{part}/{name}: the manifest's entry"
            for name in sorted(old.keys() | fresh.keys())
            if old.get(name) != fresh.get(name)
        ]
    there = {
        path.relative_to(VECTORS).as_posix() for path in VECTORS.rglob("*/*") if path.is_file()
    }
    found += [f"{name}: not a vector, or missing" for name in sorted(there ^ files.keys())]
    for name in sorted(there & files.keys()):
        content = (VECTORS / name).read_bytes()
        if content != files[name] and (same_zstd or name.endswith(".f32")):
            found.append(f"{name}: its bytes")
        elif name.startswith("valid/") and name.endswith(".cogs"):
            arrays = _array_bytes(reference_decoder.decode(content))
            if arrays != files[name.removesuffix(".cogs") + ".f32"]:
                found.append(f"{name}: its decoded values")
    text = SPEC.read_text(encoding="utf-8")
    if replace_blocks(text, spec_blocks()) != text:
        found.append("SPEC.md: the dump or the lists of vectors")
    return found


def write() -> None:
    """Write the vectors, the manifest and SPEC's generated blocks; delete obsolete vectors."""
    manifest, files = make_vectors()
    for path in VECTORS.rglob("*/*"):
        if path.is_file() and path.relative_to(VECTORS).as_posix() not in files:
            path.unlink()
    for name, content in files.items():
        (VECTORS / name).parent.mkdir(parents=True, exist_ok=True)
        (VECTORS / name).write_bytes(content)
    (VECTORS / "manifest.json").write_text(_manifest_text(manifest), encoding="utf-8")
    text = SPEC.read_text(encoding="utf-8")
    SPEC.write_text(replace_blocks(text, spec_blocks()), encoding="utf-8")


def main() -> int:
    """Write the vectors, or with ``--check`` compare the committed ones; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, prog="make_vectors")
    parser.add_argument("--check", action="store_true", help="write nothing, list differences")
    if parser.parse_args().check:
        found = differences()
        print("\n".join([*found, f"{len(found)} differences"]))
        return 1 if found else 0
    write()
    good, bad = len(valid_vectors()), len(invalid_vectors())
    print(f"{good} valid and {bad} must-reject files in {VECTORS}")
    print(f"{len(valid_folders())} valid and {len(invalid_folders())} must-reject folders")
    print(f"{len(drawing_vectors.drawings())} pictures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
