"""Write the corpus of the fuzz targets: a small file of each kind, and inputs that failed.

Run as ``python tests/fuzz/make_corpus.py``; the bytes are the same every time. A file that a fuzzer
finds is added to the folder of its target by hand, under a name that says what it does.
"""

import io
import json
import struct
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).parent / "corpus"
TESTS = ROOT / "tests"
sys.path[:0] = [str(ROOT), *(str(TESTS / name) for name in ("codec", "formats", "fuzz"))]

import hostile_files as hostile  # noqa: E402
import own_files  # noqa: E402
import torch_files  # noqa: E402
from targets import joined  # noqa: E402

import cogsplat  # noqa: E402
from cogsplat.codec.splats import Splats  # noqa: E402
from cogsplat.formats.cogs.description_json import to_json  # noqa: E402
from cogsplat.formats.scenes.registry import write_scene  # noqa: E402
from cogsplat.formats.scenes.supersplat_settings import write_settings  # noqa: E402
from cogsplat.tools.workflow.batch_log import BatchLog  # noqa: E402
from cogsplat.tools.workflow.tune_checkpoint import write_checkpoint  # noqa: E402


def scene(count: int, degree: int) -> Splats:
    rng = np.random.default_rng(count + degree)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    rest = (degree + 1) ** 2 - 1
    return Splats(
        draw(count, 3), draw(count, 3) - 4, draw(count, 4), draw(count), draw(count, 3),
        draw(count, rest, 3) / 8,
    )  # fmt: skip


def scenes(folder: Path) -> Iterator[tuple[str, str, bytes]]:
    """Yield target, name and bytes of scenes that are well."""
    for extension in (".ply", ".compressed.ply", ".glb", ".sog", ".spz", ".splat"):
        for count, degree in ((1, 0), (9, 1), (5, 3)):
            path = folder / f"a{extension}"
            write_scene(scene(count, degree), path, force=True)
            yield extension[1:].replace(".", "_"), f"scene_{count}_{degree}", path.read_bytes()
    path = folder / "a.gltf"
    write_scene(scene(3, 1), path)
    yield "gltf", "scene", joined(path.read_bytes(), b"")
    root, binary = hostile.gltf_root(2, 1)
    root["buffers"] = [{"byteLength": len(binary), "uri": "side.bin"}]
    yield "gltf", "buffer_beside", joined(json.dumps(root).encode(), binary)
    names = [*"xyz", "opacity", *(f"f_dc_{k}" for k in range(3))]
    names += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    lines = ["ply", "format ascii 1.0", "comment cogsplat axes RUB", "element vertex 2"]
    lines += [*(f"property float {name}" for name in names), "property uchar object", "end_header"]
    rows = [" ".join(str(k + row) for k in range(15)) for row in range(2)]
    yield "ply", "text", "\n".join([*lines, *rows, ""]).encode()
    shapes = {"means": (2, 3), "scales": (2, 3), "quats": (2, 4), "opacities": (2,)}
    arrays = {
        name: np.ones(shape, np.float32)
        for name, shape in {**shapes, "sh0": (2, 1, 3), "shN": (2, 3, 3)}.items()
    }
    state = {name: torch_files.tensor(str(k), a) for k, (name, a) in enumerate(arrays.items())}
    storages = {str(k): a.tobytes() for k, a in enumerate(arrays.values())}
    torch_files.saved(folder / "a.pt", {"step": 1, "splats": state}, storages)
    yield "pt", "checkpoint", (folder / "a.pt").read_bytes()
    head = bytearray(4096 + 1024)
    head[1] = 1
    head[4:8] = head[8:12] = head[12:16] = head[16:20] = (1).to_bytes(4, "little")
    head[4096:4104] = (1).to_bytes(4, "little") * 2
    yield "ksplat", "one_splat", bytes(head) + np.ones(11, "<f4").tobytes()


def harm(folder: Path) -> Iterator[tuple[str, str, bytes]]:
    """Yield files that took too much, or failed in a way that no file may."""
    mib = 1 << 20
    path = hostile.sog_of_one_entry(folder, side=16, count=9, inflated=8 * mib)
    yield "sog", "one_entry_inflated_for_every_image", path.read_bytes()
    path = hostile.sog_of_one_entry(folder, side=1024, count=mib, inflated=mib)
    yield "sog", "a_million_splats_in_one_colour", path.read_bytes()
    path = hostile.sog_of_overlapping_entries(folder)
    yield "sog", "overlapping_entries", path.read_bytes()
    path = hostile.sog_of_many_entries(folder, entries=400)
    yield "sog", "many_entries", path.read_bytes()
    path = hostile.gltf_of_shared_accessors(folder, splats=100, primitives=40)
    yield "glb", "shared_accessors", path.read_bytes()
    for name, node in {
        "matrix_1e308": {"matrix": [1e308] * 16},
        "scale_-1e-110": {"scale": [-1e-110] * 3},
        "scale_0": {"scale": [0, 0, 0]},
        "rotation_1e200": {"rotation": [1e200] * 4},
    }.items():
        yield "glb", name, hostile.gltf_with_node(folder, node).read_bytes()
    root, binary = hostile.gltf_root(2, 1)
    root["extensionsRequired"] = ["\x1b]0;title\x07\x1b[2J"]
    yield "glb", "escape_sequences", hostile.glb(root, binary)
    path = hostile.gltf_of_empty_arrays(folder, arrays=5000)
    yield "gltf", "empty_arrays", joined(path.read_bytes(), b"")
    for version in (1, 2, 3, 4):
        path = hostile.spz_of_zeros(folder, version=version, splats=60_000)
        yield "spz", f"zeros_{version}", path.read_bytes()
    path = hostile.ply_of_empty_lists(folder, lists=2000)
    yield "ply", "empty_lists", path.read_bytes()
    path = hostile.cameras_json_of_empty_arrays(folder, size=6000)
    yield "cameras_json", "empty_arrays", path.read_bytes()
    path = hostile.cameras_json_of_many(folder, cameras=12)
    yield "cameras_json", "many", path.read_bytes()
    path = hostile.transforms_json_of_one_picture(folder, frames=20)
    picture = (folder / "p.png").read_bytes()[:100]
    yield "transforms_json", "one_picture", joined(path.read_bytes(), picture)
    hostile.colmap(folder, images=3)
    parts = [(folder / f"{name}.bin").read_bytes() for name in ("cameras", "images")]
    yield "colmap_bin", "model", joined(*parts)
    hostile.colmap_with_long_line(folder, size=66_000)
    parts = [(folder / f"{name}.txt").read_bytes() for name in ("cameras", "images")]
    yield "colmap_txt", "long_line", joined(*parts)
    yield "colmap_txt", "model", joined(parts[0], b"1 1 0 0 0 0 0 0 1 a b.png\n1 2 3\n")
    track = struct.pack("<2I", 1, 0)
    points = struct.pack("<Q", 2)
    points += struct.pack("<Q3d3BdQ", 4, 0.5, -1.0, 2.0, 255, 128, 0, 0.7, 2) + 2 * track
    points += struct.pack("<Q3d3BdQ", 9, 1e300, 0.0, 0.0, 1, 2, 3, 0.1, 0)
    yield "points_bin", "model", points
    yield "points_bin", "track_beyond_the_file", points[:-8] + struct.pack("<Q", 1 << 61)
    yield "points_txt", "model", b"# points\n4 0.5 -1 2e0 255 128 0 0.7 1 0 1 0\n"
    yield "points_txt", "long_line", b"4 0.5 -1 2 255 128 0 0.7" + 40_000 * b" 1" + b"\n"
    yield "points_txt", "beyond_doubles", b"4 1e999 0 0 1 2 3 0.1\n"
    # An object stored under the number 2²⁶, and a frame of 2⁶⁴ - 1 bytes.
    pickles = {"large_memo": b"\x80\x02}r\x00\x00\x00\x04."}
    pickles["large_frame"] = b"\x80\x04\x95" + b"\xff" * 8 + b"}."
    # Tuples of eight references to the tuple before, whose hash and text take seconds to hours.
    levels = (b"(" + 8 * (b"h" + bytes([k])) + b"tq" + bytes([k + 1]) + b"0" for k in range(16))
    nested = b"K\0q\0000" + b"".join(levels) + b"h\x10"
    pickles["key_of_nested_tuples"] = b"\x80\x02}" + nested + b"K\x01s."
    pickles["id_of_nested_tuples"] = b"\x80\x02" + nested + b"Q."
    for name, pickled in pickles.items():
        with zipfile.ZipFile(folder / "a.pt", "w") as archive:
            archive.writestr(zipfile.ZipInfo("archive/data.pkl"), pickled)
        yield "pt", name, (folder / "a.pt").read_bytes()
    path = hostile.png_with_text_bomb(folder / "v.png", side=4, inflated=8 * mib)
    yield "mask", "text_that_inflates", path.read_bytes()
    yield "mask", "eps", hostile.eps(path, side=4).read_bytes()


def own(folder: Path) -> Iterator[tuple[str, str, bytes]]:
    """Yield files of our own: checkpoints, manifests and a log."""
    for name, state in own_files.checkpoint_states():
        path = folder / f"{name}.npz"
        write_checkpoint(path, own_files.RUN, state)
        yield "checkpoint", name, path.read_bytes()
    options = {"quality": 38.5, "no-jitter": True, "cameras": "cameras.json", "report": "a.html"}
    scene = {"input": "a.ply", "output": "a.cogs", "options": options}
    yield "batch_jsonl", "scene", json.dumps(scene).encode()
    lines = [json.dumps({**scene, "output": f"{name}.cogs"}) for name in "bcd"]
    yield "batch_jsonl", "scenes", "\n".join([*lines, ""]).encode()
    toml = '[[scene]]\ninput = "a.ply"\noutput = "a.cogs"\noptions = {quality = 38.5}\n'
    more = toml.replace("a.", "b.").replace("{quality = 38.5}", "{no-jitter = true}")
    yield "batch_toml", "scene", toml.encode()
    yield "batch_toml", "scenes", f"{toml}\n{more}".encode()
    path = folder / "a.log"
    with BatchLog(path, folder) as log:
        line = {"input": "a.ply", "output": "a.cogs", "fingerprint": "0" * 64}
        log.write({**line, "status": "started"})
        log.write({**line, "status": "done", "result": {"bytes": 3}})
        log.write({**line, "output": "b.cogs", "status": "started"})
        log.write({**line, "output": "b.cogs", "status": "failed", "error": {"code": "exists"}})
    yield "batch_log", "two_scenes", path.read_bytes()
    for vector in own_files.MANIFEST_VECTORS:
        manifest = own_files.vector_manifest(vector, folder / vector)
        yield "folder", vector, manifest
        yield "upload", vector, manifest


def descriptions(folder: Path) -> Iterator[tuple[str, str, bytes]]:
    """Yield descriptions and settings of the SuperSplat viewer."""
    source = (ROOT / "tests" / "vectors" / "valid" / "pictures.cogs").read_bytes()
    with cogsplat.open(source) as file:
        poster = file.description(pictures=True).poster.data
    path = (ROOT / "tests" / "vectors" / "valid" / "description.cogs").read_bytes()
    with cogsplat.open(path) as file:
        described = file.description()
        level = np.array([0.0, -1.0, 0.0])
        write_settings(
            folder / "settings.json", described, described.views[0], "RDF", level, force=True
        )
    value = {**to_json(described), "poster": "p.jpg"}
    yield "description", "every_key", joined(json.dumps(value).encode(), poster)
    yield "description", "poster", joined(b'{"poster": {"file": "p.jpg"}}', poster)
    yield "description", "title", joined(b'{"title": "Garden", "metres_per_unit": 1}', b"")
    yield "settings", "every_key", (folder / "settings.json").read_bytes()


def own_harm(folder: Path) -> Iterator[tuple[str, str, bytes]]:
    """Yield files of our own kinds that took too much, or met a traceback."""
    page = io.BytesIO()
    np.save(page, np.zeros(3))
    yield "checkpoint", "plain_array", page.getvalue()
    directory = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, 1000, 0, 0)
    yield "checkpoint", "directory_before_the_file", directory
    path = folder / "a.npz"
    write_checkpoint(path, own_files.RUN, {"steps": np.array(3)})
    yield "checkpoint", "missing_arrays", path.read_bytes()
    for name, run in (("zeros", own_files.RUN), ("zeros_of_another_run", "f" * 64)):
        write_checkpoint(path, run, {})
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            entry = zipfile.ZipInfo("splats.means.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, bytes(1 << 24))
        yield "checkpoint", name, path.read_bytes()
    scene = {"input": "a.ply", "output": "a.cogs"}
    names = {"nul": "a\0b", "surrogate": "\ud800", "long_name": "n" * 500, "stream": "-"}
    for name, text in names.items():
        yield "batch_jsonl", name, json.dumps({**scene, "input": text}).encode()
    same = [json.dumps(scene), json.dumps({**scene, "output": "./a.cogs"})]
    yield "batch_jsonl", "two_spellings", "\n".join(same).encode()
    yield "batch_toml", "scene_of_a_number", b"scene = 3\n"


def main() -> None:
    """Write the corpus of every target but COGS, whose corpus is the conformance vectors."""
    for made in (scenes, harm, own, descriptions, own_harm):
        with tempfile.TemporaryDirectory() as folder:
            for target, name, data in made(Path(folder)):
                path = CORPUS / target / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)


if __name__ == "__main__":
    main()
