"""Rooms of the tree: what each gives to others and may take, and that its modules have tests."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("codec", "formats", "tools")

MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


# Rooms: every folder of codec, formats and tools, what lies deeper included; what lies beside the
# folders is a room as well. The facade is one module and imports what it likes.
FACADE = "cogsplat"


def room_of(module: str) -> str:
    """Return the room of a module such as ``codec.render.tiles``."""
    parts = module.split(".")
    inside = len(parts) > 1 and (ROOT / parts[0] / parts[1]).is_dir()
    return ".".join(parts[:2]) if inside else parts[0]


def module_of(path: Path) -> str:
    """Return a file's module without the leading ``cogsplat``; that is the facade alone."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def absolute(node: ast.ImportFrom, importer: str, *, is_package: bool) -> str:
    """Return the module that a ``from`` import names, without the leading ``cogsplat``."""
    if not node.level:
        return node.module or ""
    parts = ["cogsplat", *importer.split(".")] if importer != FACADE else [FACADE]
    parts = parts[: len(parts) + is_package - node.level]
    return ".".join([*parts, *([node.module] if node.module else [])])


def taken_by(path: Path) -> Iterator[tuple[str, str]]:
    """Yield module and name of everything of the package that a file takes from another module."""
    importer = module_of(path)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    aliases: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == FACADE:
                    assert alias.name == FACADE, f"{alias.name}: import names, or with `from`"
                    yield FACADE, ""
        elif isinstance(node, ast.ImportFrom):
            source = absolute(node, importer, is_package=path.name == "__init__.py")
            if source.split(".")[0] != FACADE:
                continue
            source = source.removeprefix(FACADE).removeprefix(".")
            for alias in node.names:
                inner = f"{source}.{alias.name}" if source else alias.name
                if is_module(inner):
                    aliases[alias.asname or alias.name] = inner
                else:
                    yield source or FACADE, alias.name
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)):
            continue
        if node.value.id in aliases:
            yield aliases[node.value.id], node.attr


TAKEN = {path: sorted(set(taken_by(path))) for path in [*MODULES, ROOT / "cogsplat/__init__.py"]}


def test_what_a_file_takes_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "codec/order/taker.py"
    source.parent.mkdir(parents=True)
    source.write_text(
        "import numpy as np\nfrom cogsplat.codec.geometry import morton as m\n"
        "from .chunks import plan_chunks\nfrom ..splats import Splats\n"
        "def f():\n    from cogsplat import open\n    return m.interleave(np.zeros(1))\n",
        encoding="utf-8",
    )
    monkeypatch.setattr(sys.modules[__name__], "module_of", lambda path: "codec.order.taker")
    assert sorted(taken_by(source)) == [
        ("codec.geometry.morton", "interleave"),
        ("codec.order.chunks", "plan_chunks"),
        ("codec.splats", "Splats"),
        ("cogsplat", "open"),
    ]
    assert room_of("codec.encode.profiles.vq") == "codec.encode"
    assert room_of("codec.splats") == "codec"


@pytest.mark.parametrize("path", TAKEN, ids=name_of)
def test_no_private_name_crosses_a_room(path: Path) -> None:
    room = room_of(module_of(path))
    private = [(module, name) for module, name in TAKEN[path] if name.startswith("_")]
    assert [taken for taken in private if room_of(taken[0]) != room] == []


@pytest.mark.parametrize("path", TAKEN, ids=name_of)
def test_only_tools_take_the_facade(path: Path) -> None:
    if path.is_relative_to(ROOT / "tools"):
        return
    assert [name for module, name in TAKEN[path] if module == FACADE] == []


@pytest.mark.parametrize(
    "path", [path for path in MODULES if path.name == "__init__.py"], ids=name_of
)
def test_packages_hold_a_docstring_only(path: Path) -> None:
    """Whatever one re-exports, importing its neighbours would import as well, numba among it."""
    (only,) = ast.parse(path.read_text(encoding="utf-8")).body
    assert isinstance(only, ast.Expr)


# Modules whose tests bear another module's name, and the file that they are in.
TESTED_IN = {
    "codec/encode/adam.py": "encode/test_compensation_fit.py",
    "codec/encode/config.py": "encode/test_encoder.py",
    "codec/encode/encoded.py": "encode/test_encoder.py",
    "codec/encode/presets.py": "encode/test_pipeline.py",
    "codec/encode/profiles/means.py": "encode/profiles/test_transform.py",
    "codec/encode/shift_optimiser.py": "encode/test_compensation_fit.py",
    "codec/rate/costs.py": "rate/test_allocation.py",
    "codec/segments/bands.py": "segments/test_heads.py",
    "codec/segments/codebooks.py": "segments/test_heads.py",
    "codec/segments/payloads.py": "encode/profiles/test_chunk_streams.py",
    "codec/segments/stream_set.py": "segments/test_heads.py",
    "codec/segments/tails.py": "segments/test_heads.py",
    "codec/streams/codebook_index.py": "streams/test_records.py",
    "codec/streams/compiled.py": "streams/test_kernels.py",
    "codec/streams/inputs.py": "streams/test_refinement_bits.py",
    "codec/streams/kernels_adaptive_step.py": "streams/test_kernels.py",
    "codec/streams/kernels_bits.py": "streams/test_kernels.py",
    "codec/streams/kernels_grid.py": "streams/test_kernels.py",
    "codec/streams/kernels_planes.py": "streams/test_kernels.py",
    "codec/streams/kernels_shn_transform.py": "streams/test_kernels.py",
    "codec/streams/kernels_sorted_means.py": "streams/test_kernels.py",
    "codec/streams/kernels_swing_twist.py": "streams/test_kernels.py",
    "codec/streams/kinds.py": "streams/test_records.py",
    "codec/streams/limits.py": "streams/test_byte_planes.py",
    "codec/streams/quaternion.py": "streams/test_records.py",
    "codec/streams/refinement_digits.py": "rate/test_refinement_split.py",
    "codec/streams/scalar.py": "streams/test_records.py",
    "codec/streams/zstd_frames.py": "streams/test_byte_planes.py",
    "formats/cameras/files.py": "cameras/test_nerfstudio.py",
    "formats/cogs/cameras.py": "cogs/test_extras.py",
    "formats/cogs/index.py": "cogs/test_reader.py",
    "formats/cogs/msgpack_map.py": "cogs/test_root.py",
    "formats/scenes/gltf/embedded_buffers.py": "scenes/gltf/test_scene.py",
    "formats/scenes/gltf/file.py": "scenes/gltf/test_scene.py",
    "formats/scenes/ply/foreign_layouts.py": "scenes/ply/test_scene.py",
    "formats/scenes/ply/header.py": "scenes/ply/test_scene.py",
    "formats/scenes/sog/files.py": "scenes/sog/test_scene.py",
    "formats/scenes/spz/container.py": "scenes/spz/test_scene.py",
    "formats/scenes/spz/values.py": "scenes/spz/test_scene.py",
    "formats/storage/images.py": "scenes/sog/test_scene.py",
    "formats/storage/pictures.py": "test_hostile.py",
}


def has_tests_of_its_name(path: Path) -> bool:
    return (ROOT / "tests" / path.relative_to(ROOT)).with_name(f"test_{path.name}").is_file()


def test_each_module_has_tests_of_its_name() -> None:
    subjects = [
        path
        for path in MODULES
        if path.name != "__init__.py" and not path.is_relative_to(ROOT / "tools")
    ]
    assert len(subjects) > 100
    missing = {name_of(path) for path in subjects if not has_tests_of_its_name(path)}
    assert missing - TESTED_IN.keys() == set()


@pytest.mark.parametrize("module", TESTED_IN)
def test_modules_tested_elsewhere_are_there(module: str) -> None:
    assert (ROOT / module).is_file()
    assert (ROOT / "tests" / module.split("/")[0] / TESTED_IN[module]).is_file()
