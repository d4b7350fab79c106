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


def crossings() -> dict[str, dict[str, set[str]]]:
    """Return what other rooms take of each room: names by module within the room."""
    found: dict[str, dict[str, set[str]]] = {}
    for path, names in TAKEN.items():
        for module, name in names:
            room = room_of(module)
            if room in (FACADE, room_of(module_of(path))):
                continue
            inside = module.removeprefix(room).removeprefix(".")
            found.setdefault(room, {}).setdefault(inside, set()).add(name)
    return found


def defined_in(path: Path) -> set[str]:
    """Return the names that a module defines at its top level."""
    names: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            bound = [name for target in node.targets for name in ast.walk(target)]
            names |= {name.id for name in bound if isinstance(name, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return names


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


# The doors of codec and formats: the names that each room gives to others, by module. Who changes
# one of them changes other rooms as well. The rooms of tools are programs and have no doors.
DOORS: dict[str, dict[str, str]] = {
    "codec": {
        "cameras": "Camera",
        "compiling": "DeclaredKernel called_with compiled declared declared_in",
        "errors": (
            "Cancelled CogsplatError CogsplatWarning DataError FormatError LimitError "
            "MissingExtraError StorageError TruncatedError UnsupportedError printable"
        ),
        "executor": "Executor LocalThreads",
        "metrics": "PSNR_CAP_DB SSIM_BORDERS psnr ssim",
        "progress": "Progress StageCost TimedProgress WholeProgress silent",
        "splats": (
            "EXTRA_DTYPES Extra MAX_EXTRAS MAX_EXTRA_COMPONENTS MAX_EXTRA_NAME_BYTES "
            "MAX_SH_DEGREE SceneInfo Splats concatenate empty sh_coefficients"
        ),
        "threads": "one_blas_thread ordered_map thread_count",
        "workspace": "Gather IN_MEMORY Workspace Zeros",
    },
    "codec.clustering": {
        "few_rows": "train",
        "hierarchical_kmeans": "train_palette",
        "kmeans": "TrainingConfig nearest train",
        "scalar_kmeans": "nearest_scalars train_scalars",
    },
    "codec.encode": {
        "compensation_fit": "blank compensated plan_layers usual_errors",
        "config": "Ablation EncodeConfig MAX_QUALITY_DB MIN_QUALITY_DB",
        "encoded": "EncodeReport EncodedChunk EncodedCodebook EncodedLevel EncodedScene",
        "encoder": "encode_chunks",
        "needed_kernels": "needed_kernels",
        "preview_chunks": "PreviewMaker prepend_preview",
        "pipeline": "SizeOf encode",
        "prefix_quality": "PrefixEvaluator predicted",
        "prepared": "PreparedScene prepare",
        "presets": "DEFAULT_PRESET PRESETS",
        "memory": "memory_need",
        "profiles.vq": "clip_strays",
        "rate_control": "Target to_psnr",
        "scored_views": "score_given",
        "stage_costs": "order_costs render_cost score_cost stage_costs",
    },
    "codec.fit": {
        "lessons": "lessons_of views_apart",
        "shares": "count_for_size",
        "level_encoding": "LevelEncoding encode_levels",
        "levels": ("LevelledSplats LevelsConfig grow_levels train_for_all_scales train_levels"),
        "preview_training": "PreviewConfig TrainedPreview",
        "points_start": "splats_from_points",
        "smaller_pictures": "averaged scaled_camera",
        "trainer": "TrainConfig",
        "tune_config": "TuneConfig",
        "tuning": "Milestone State tune",
    },
    "codec.geometry": {
        "bounds": "CUT_SIGMA box",
        "covariance": "MIN_RELATIVE_SCALE decompose principal_axes scale_factor vectors",
        "floaters": "floaters",
        "frustum": "ALPHA_MIN NEAR in_frustum in_picture visible_depth",
        "merging": "merge",
        "morton": "MAX_LEVELS deinterleave interleave spatial_order",
        "rotations": "from_matrices largest_w matrices multiply unit",
        "sh": ("C0 C1 C2_XX_YY C2_XY C2_ZZ C3_0 C3_1 C3_2 C3_3 C3_XX_YY COLOUR_OFFSET basis terms"),
        "transforms": "AxesChange axes_change convert_axes transform transform_camera",
    },
    "codec.order": {
        "baselines": "antimatter descending sgss",
        "chunks": "DEFAULT_LARGEST FIRST_SPLATS GROWTH plan_chunks sort_runs",
        "gain_effort": "GainEffort",
        "objects": "ATTRIBUTE Arrangement arrange labels_of ranked require with_labels",
        "objects_from_masks": "assign",
        "octree": "MAX_DEPTH",
        "orders": (
            "FIRST_VIEW FRUSTUM ORDERS OrderConfig POSE_RULES Unordered needs_scores order_rows "
            "require_order split_name"
        ),
        "prefix_inflation": "Inflation effective_splats inflate typical",
    },
    "codec.partition": {
        "basic_cuboids": "BasicCuboids basic_cuboids",
        "box_costs": "Box BoxCosts box_costs waste",
        "cuboid_program": "cheapest_partition",
        "grid_trees": "kd_partition octree_partition",
        "guillotine": "cut_costs",
        "nested_cells": "DEFAULT_LARGEST NestedCells WHOLE nested_cells parents",
    },
    "codec.rate": {
        "allocation": "equal_step lagrangian shn_step step_per_value",
        "costs": "Costs SH0_COST SH0_WEIGHT costs limit_colour_steps limit_steps positive_energy",
        "energy_costs": "EnergyCosts SHN_COST",
        "head_coarseness": "FINE HeadCoarseness head_coarseness",
        "pruning": "PruneConfig keep_mask",
        "refinement_split": "DEFERRED_BIT_PRICE Split entropy_bits split",
        "segment_order": (
            "ChunkSegments MISSING_ALL MISSING_COMPENSATED OrderedKind OrderedSegment SegmentGain "
            "missing_shares missing_shares_from_mse order_segments tail_distortion_drop"
        ),
    },
    "codec.render": {
        "blend_weights": "PEAK SQUARE WEIGHT add_weights",
        "blending": (
            "ALPHA_MAX BLUE GREEN LANES PIXELS PLANES PLANES_COMPARED RED REST blend_pixel "
            "blend_tile footprint_in_tile open_pixels rows_in_tile tile_area"
        ),
        "cuda_device": "DEVICES cuda_device require_device",
        "cuda_views": "CudaScene CudaView",
        "gradients": "Gradient gradient",
        "jit": "inner_kernel kernel",
        "label_votes": "label_votes",
        "marginal_gains": "marginal_gains",
        "peak_weights": "peak_weights",
        "projection": "FLAT Footprints GUARD NARROW SHEAR fill_rotation project",
        "rasteriser": "RenderConfig cuda_view render render_tiles render_views",
        "sensitivities": (
            "COLUMNS PAIRS_AT_ONCE Sensitivities add_moments from_columns view_sensitivities"
        ),
        "shading": "footprint_colours row_colours sh_terms",
        "tiles": "TILE TileLists gather tile_lists",
    },
    "codec.scheduling": {
        "chunk_ratios": (
            "PoseRatios along by_boxes by_sgss by_view_table counted_splats over_usual"
        ),
        "poses": "Pose path",
        "scheduler": "Holdings Scheduler Unit best_chain urgencies window_bytes",
    },
    "codec.scoring": {
        "chunk_contributions": "PIXELS chunk_contributions",
        "contribution": "LEAST_WEIGHT MOST_BY_VIEW ScoreConfig Scores score unscored",
        "reference_views": "PICTURE_PIXELS ReferenceViews render_references",
    },
    "codec.segments": {
        "attributes": "AttributeType attribute_bytes pack_attributes types_of unpack_attributes",
        "chunk_sets": "equivalent_prefixes is_closed",
        "chunks": "decode_chunk",
        "codebooks": (
            "Codebook ColourCodebook ShapeCodebook decode_colour_codebook decode_shape_codebook"
        ),
        "compensation": (
            "Compensation Layer MAX_CODE_BITS OPACITY_STEP SCALE_STEP STRENGTH_STEP code_bits "
            "pack_codes packed_bytes unpack_codes"
        ),
        "heads": "decode_head",
        "opacities": "MAX_LOGIT decode_opacities pack_opacities",
        "payloads": "Payloads",
        "tails": "decode_tail",
        "view_table": (
            "MAX_CODES MAX_VIEWS ViewTable pack_codes share_codes stored_directions unpack_codes"
        ),
    },
    "codec.streams": {
        "adaptive_step": "StepModel fit",
        "bit_fields": "pack",
        "byte_planes": "LENGTH_MASK pack_plane unpack_plane",
        "codebook_index": "gather read_indices write",
        "compiled": "KERNEL_MODULES prepare ready use",
        "float32": "write",
        "grid": "ENTRY_BYTES Grid MAX_LEVELS MAX_VALUE fit",
        "grid_planes": "split_planes",
        "inputs": "Inputs",
        "kinds": "codebook_use codec_of read refined_by",
        "limits": "MAX_CHUNK_SPLATS MAX_CODEBOOK_ROWS MAX_PLANE_BYTES",
        "opacity_differences": "write",
        "quaternion": "PER_ROW write",
        "records": (
            "Attribute COMPONENTS ESCAPE INFINITIES Kind SH_BANDS StoredStream Stream "
            "compressed pack pack_plain unpack"
        ),
        "refinement_bits": "coarse_codes half_of write",
        "refinement_digits": "MAX_RADIX parse write",
        "scalar": "parse write write_with_infinities",
        "scale_differences": "accumulate differences_of write",
        "sh0_transform": "parse write",
        "shn_transform": "MAX_BASIS_ROWS codebook_use parse write",
        "sorted_means": "MAX_CELLS cells_of codes_of morton_order pack_differences values write",
        "swing_twist": "BASE_STEP decompose split write",
        "whole_chunk": "ChunkArrays read",
    },
    "codec.views": {
        "low_discrepancy": "STEP_1D",
        "planner": "ViewPlan ViewPlanConfig plan plan_views",
        "view_clusters": "view_clusters",
        "view_sets": "evenly hold_out jitter roam",
    },
    "formats.cameras": {
        "colmap_points": "find_points read_points",
        "camera_files": "read_cameras",
        "inria": "write_cameras_json",
    },
    "formats.cogs": {
        "between_levels": "decode_between",
        "cameras": "check_cameras",
        "canonical_msgpack": "MAX_DEPTH MAX_VALUES Value pack unpack",
        "folder_map": "FolderMap MANIFEST_NAME MANIFEST_SUFFIX is_manifest",
        "folder_places": "SEGMENT_FOLDER check_object",
        "folder_source": "FolderSource manifest_path names_folder",
        "folder_writer": "Unpacked check_manifest_name pack_cogs unpack_cogs",
        "layout": (
            "COLOUR_BANDS MAGIC MAJOR MINOR PREAMBLE_BYTES SKIPPABLE_KIND SegmentKind "
            "unpack_preamble"
        ),
        "open_file": "manifest_address open_place source_of_place with_place",
        "packing": "folder_files pack unpack",
        "reader": "CogsFile open_cogs",
        "root": "Root",
        "scene": "save size_bytes",
        "sources": "cogs_source",
        "verification": "Finding finding_of findings",
        "writer": "Segment write_cogs",
    },
    "formats.network": {
        "answers": "Answer NeighbouringTransport Stated",
        "download": "download",
        "faults": "PassingFault",
        "object_output": "ObjectOutput",
        "open_url": "open_url transport_of",
        "options": "MIB NetworkOptions",
        "range_source": "RangeSource",
        "segment_cache": "SegmentCache",
        "traffic": "Traffic",
        "urls": "HTTP_SCHEMES STORE_SCHEMES is_url scheme_of shown",
    },
    "formats.scenes": {
        "compressed_ply": "CHUNK_SPLATS read_compressed_ply write_compressed_ply",
        "gltf.gltf_scene": "read_gltf write_gltf",
        "ksplat": "read_ksplat",
        "memory_cap": "working_memory",
        "ply.ply_scene": "read_ply write_ply write_ply_parts",
        "quantised_values": "morton_order unit_opacities",
        "registry": (
            "FORMATS Format WRITABLE format_of format_to_write is_cogs read_scene scene_bytes "
            "scene_files write_scene"
        ),
        "sog.lod_meta": "StreamedSog read_lod_meta",
        "sog.sog_scene": "read_sog sog_files write_sog",
        "splat": "read_splat write_splat",
        "spz.spz_scene": "SPZ_AXES VERSIONS read_spz write_spz",
        "spz.spz_values": "PRECISIONS",
    },
    "formats.storage": {
        "atomic": (
            "StrPath TargetExistsError atomic_write check_output open_for_read storage_error "
            "storage_errors sync_all"
        ),
        "byte_counts": "ByteCount parse_byte_count parse_bytes",
        "images": "MAX_SIDE decode_image encode_image image_size picture_size",
        "json_stream": "JsonStream MAX_VALUE_BYTES",
        "limits": "Limits",
        "magic": "COGS_MAGIC MANIFEST_MAGIC describe",
        "pictures": "read_picture",
        "scratch_files": "ScratchFiles",
        "siblings": "sibling",
        "source": (
            "Cancel FileSource PrefixSource Readable RemoteSource Source has_arrived is_there "
            "opening_bytes prefetching require_within source_of stored_bytes"
        ),
        "strict_json": "JsonObject parse_object",
        "torch_file": "CODE TorchTensor open_torch read_state_dict",
        "zip_directory": "open_zip",
    },
}


def test_rooms_take_what_stands_in_the_doors() -> None:
    """A name that one room takes of another is listed, so that whoever changes it knows."""
    doors = {
        room: {module: set(names.split()) for module, names in modules.items()}
        for room, modules in DOORS.items()
    }
    found = {room: names for room, names in crossings().items() if not room.startswith("tools")}
    assert found.keys() == doors.keys()
    wrong = []
    for room in doors:
        for module in sorted(doors[room].keys() | found[room].keys()):
            listed, taken = doors[room].get(module, set()), found[room].get(module, set())
            if taken - listed:
                wrong.append(f"{room}, {module}: taken and not listed: {sorted(taken - listed)}")
            if listed - taken:
                wrong.append(f"{room}, {module}: listed and not taken: {sorted(listed - taken)}")
    assert not wrong, "DOORS of tests/test_rooms.py:\n" + "\n".join(wrong)


def test_doors_lead_to_what_is_defined_there() -> None:
    for room, modules in DOORS.items():
        for module, names in modules.items():
            path = ROOT.joinpath(*room.split("."), *module.split(".")).with_suffix(".py")
            assert set(names.split()) - defined_in(path) == set(), path


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


def test_training_and_cuda_alone_take_torch() -> None:
    """Whoever imports it waits for seconds, and it comes with the extra `train` only."""
    takers = {
        name_of(path)
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""] * (node.level == 0)
        )
        if name.split(".")[0] in ("torch", "gsplat")
    }
    # Those of `codec/render` import them where a device is asked for.
    on_device = {f"codec/render/cuda_{name}.py" for name in ("device", "pairs", "views")}
    assert takers == {"codec/fit/autograd.py", *on_device}
    at_once = [
        node
        for path in on_device
        for node in ast.parse((ROOT / path).read_text(encoding="utf-8")).body
        if isinstance(node, ast.Import)
    ]
    assert not {"torch", "gsplat"} & {alias.name for node in at_once for alias in node.names}


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
    "codec/fit/splat_kernels.py": "fit/test_drawing.py",
    "codec/render/cuda_pairs.py": "render/test_cuda_views.py",
    "codec/fit/storing.py": "fit/test_tuning.py",
    "codec/fit/tile_kernels.py": "fit/test_drawing.py",
    "codec/rate/costs.py": "rate/test_allocation.py",
    "codec/segments/bands.py": "segments/test_heads.py",
    "codec/segments/codebooks.py": "segments/test_heads.py",
    "codec/segments/payloads.py": "encode/profiles/test_chunk_streams.py",
    "codec/segments/stream_set.py": "segments/test_heads.py",
    "codec/segments/tails.py": "segments/test_heads.py",
    "codec/streams/compiled.py": "streams/test_kernels.py",
    "codec/streams/inputs.py": "streams/test_refinement_bits.py",
    "codec/streams/kernels_adaptive_step.py": "streams/test_kernels.py",
    "codec/streams/kernels_bits.py": "streams/test_kernels.py",
    "codec/streams/kernels_chunk.py": "segments/test_chunks.py",
    "codec/streams/kernels_chunk_layout.py": "segments/test_chunks.py",
    "codec/streams/kernels_grid.py": "streams/test_kernels.py",
    "codec/streams/kernels_planes.py": "streams/test_kernels.py",
    "codec/streams/kernels_shn_transform.py": "streams/test_kernels.py",
    "codec/streams/kernels_sorted_means.py": "streams/test_kernels.py",
    "codec/streams/kernels_swing_twist.py": "streams/test_kernels.py",
    "codec/streams/limits.py": "streams/test_byte_planes.py",
    "codec/streams/stored_planes.py": "streams/test_records.py",
    "codec/streams/zstd_frames.py": "streams/test_byte_planes.py",
    "formats/cameras/camera_files.py": "cameras/test_nerfstudio.py",
    "formats/cogs/cameras.py": "cogs/test_extras.py",
    "formats/cogs/index.py": "cogs/test_reader.py",
    "formats/cogs/msgpack_map.py": "cogs/test_root.py",
    "formats/cogs/stored_file.py": "cogs/test_reader.py",
    "formats/network/range_reader.py": "network/test_range_source.py",
    "formats/scenes/gltf/file.py": "scenes/gltf/test_gltf_scene.py",
    "formats/scenes/ply/foreign_layouts.py": "scenes/ply/test_ply_scene.py",
    "formats/scenes/ply/header.py": "scenes/ply/test_ply_scene.py",
    "formats/scenes/sog/bundle.py": "scenes/sog/test_sog_scene.py",
    "formats/scenes/spz/container.py": "scenes/spz/test_spz_scene.py",
    "formats/scenes/spz/spz_values.py": "scenes/spz/test_spz_scene.py",
    "formats/storage/images.py": "scenes/sog/test_sog_scene.py",
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
