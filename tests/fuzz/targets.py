"""Fuzz targets: every reader of files of unknown origin, as a function of bytes.

A target writes what it is given to a file, reads it as a program would, and lets no exception pass
but the refusals that are documented. Limits are low, so that an input that costs much is found by
what it costs.
"""

import struct
import tempfile
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import http_scripts
import numpy as np
import own_files
from fault_server import serving

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, CogsplatWarning
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import decoding_tiers
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cameras.colmap_points import read_points
from cogsplat.formats.cogs.description_json import read_description, read_object, to_json
from cogsplat.formats.cogs.description_segment import pack_segments, unpack_description
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.scenes.registry import FORMATS, read_scene, scene_bytes
from cogsplat.formats.scenes.supersplat_settings import parse_settings, write_settings
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import reference_decoder
from cogsplat.tools.pictures.mask_images import read_masks

LIMITS = Limits(decoded_bytes=32 << 20, small_bytes=16 << 20, splats=200_000, cameras=5000)

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")

# More splats than this take the reference decoder, which is plain Python, too long.
_REFERENCE_SPLATS = 400


@dataclass(frozen=True)
class Target:
    """A reader, and what its files are called.

    Parameters
    ----------
    name : str
        Names the target, and its folder in the corpus.
    files : tuple of str
        Files that an input is cut into, in the folder that is read; the first is the one opened.
        Inputs of several files have the lengths of all but the last before them, 4 bytes each.
    read : callable
        Reads the first file, or its folder.
    """

    name: str
    files: tuple[str, ...]
    read: Callable[[Path], object]

    def run(self, data: bytes, folder: Path) -> CogsplatError | None:
        """Read an input, and return the refusal."""
        for name, part in zip(self.files, split(data, len(self.files)), strict=True):
            (folder / name).write_bytes(part)
        with warnings.catch_warnings():
            # A numpy warning means that the reader missed a bad value.
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", CogsplatWarning)
            try:
                self.read(folder / self.files[0])
            except CogsplatError as error:
                check_refusal(error)
                return error
        return None


def split(data: bytes, count: int) -> list[bytes]:
    """Cut an input into its files."""
    parts = []
    for _ in range(count - 1):
        length = struct.unpack("<I", data[:4].ljust(4, b"\0"))[0]
        parts.append(data[4 : 4 + length])
        data = data[4 + length :]
    return [*parts, data]


def joined(*parts: bytes) -> bytes:
    """Make one input of several files."""
    lengths = [struct.pack("<I", len(part)) for part in parts[:-1]]
    return b"".join([*(a + b for a, b in zip(lengths, parts, strict=False)), parts[-1]])


def check_refusal(error: CogsplatError) -> None:
    """A refusal has a stable code, and a message of one line that no terminal obeys."""
    assert error.code == error.code.lower()
    assert error.code.replace("-", "").replace("0", "").isalnum(), error.code
    assert error.message.isprintable(), error.message


def check_splats(splats: Splats) -> None:
    """Assert that splats from a reader have arrays of valid shapes and types."""
    count = len(splats)
    assert count <= LIMITS.splats
    for name in ARRAYS:
        values = getattr(splats, name)
        assert values.dtype == np.float32
        assert len(values) == count
    for name, extra in splats.extras.items():
        assert name
        assert len(extra) == count


def _scene(path: Path) -> None:
    check_splats(read_scene(path, limits=LIMITS))
    scene_bytes(path)


def _cameras(path: Path) -> None:
    found = read_cameras(path, limits=LIMITS)
    assert 0 < len(found) <= LIMITS.cameras


def _model(path: Path) -> None:
    _cameras(path.parent)


def _points(path: Path) -> None:
    found = read_points(path, limits=LIMITS)
    assert 0 < len(found.positions) == len(found.colours) <= LIMITS.splats
    assert np.isfinite(found.positions).all()


def _description(path: Path) -> None:
    """Read a description; assert that it is unchanged after being stored and read again."""
    description = read_description(path, limits=LIMITS)
    segments = pack_segments(description)
    if segments:
        found = unpack_description(segments[0].payload, "stored")
        assert to_json(found) == to_json(description)


def _settings(path: Path) -> None:
    up = np.array([0.0, -1.0, 0.0])
    value = read_object(path, limits=LIMITS)
    settings = parse_settings(value, str(path), "RDF", up)
    write_settings(path, settings.description, settings.first_view, "RDF", up, force=True)
    parse_settings(read_object(path, limits=LIMITS), str(path), "RDF", up)


def _mask(path: Path) -> None:
    view = Camera(4, 3, 4.0, 4.0, 2.0, 1.5, np.eye(3), np.zeros(3), path.stem)
    _, masks = read_masks(path.parent, [view])
    assert masks[0].shape == (3, 4)


def decoded(data: bytes, *, kernels: bool) -> Splats | CogsplatError:
    """Decode a COGS file and check all of it, with numpy alone or with compiled kernels."""
    was = decoding_tiers.is_compiled()
    decoding_tiers.use_compiled(kernels)
    try:
        with open_cogs(BytesSource(data, "a.cogs"), limits=LIMITS) as file:
            splats = file.decode(threads=1)
            file.verify()
            file.cameras()
            file.compensation()
            return splats
    except CogsplatError as error:
        check_refusal(error)
        return error
    finally:
        decoding_tiers.use_compiled(was)


def same_bits(found: Splats, expected: Splats) -> bool:
    """Tell whether two scenes are equal to the bit, NaN included."""
    return all(
        getattr(found, name).tobytes() == getattr(expected, name).tobytes() for name in ARRAYS
    )


def _cogs(path: Path) -> None:
    """Numpy and kernels agree on the verdict, its code and the bits; so does the second decoder."""
    data = path.read_bytes()
    plain, fast = decoded(data, kernels=False), decoded(data, kernels=True)
    if isinstance(plain, CogsplatError) or isinstance(fast, CogsplatError):
        codes = [getattr(found, "code", "accepted") for found in (plain, fast)]
        assert codes[0] == codes[1], codes
        assert isinstance(plain, CogsplatError)
        raise plain
    assert same_bits(plain, fast)
    check_splats(plain)
    if len(plain) <= _REFERENCE_SPLATS:
        rows = reference_decoder.decode(data).rows
        for name in ARRAYS:
            values = getattr(plain, name)
            expected = np.array(rows[name], np.float32).reshape(values.shape)
            assert values.tobytes() == expected.tobytes(), name


_HTTP_SECONDS = 60

# Waits are short, and a request is repeated twice; a scene is 2 to 12 requests.
_HTTP: dict[str, Any] = {
    "connect_seconds": 1.0,
    "longest_wait_seconds": 0.01,
    "pause_seconds": 0.001,
    "retries": 2,
}
_HTTP_REQUESTS = 400
_HTTP_SENT_BYTES = 64 << 20


def _read_url(url: str, how: str, network: NetworkOptions) -> Splats:
    """Decode a scene at a URL, perhaps after a stream of it or chunk by chunk from the last."""
    if how == "decode":
        return cogsplat.decode(url, network=network, limits=LIMITS)
    with cogsplat.open(url, network=network, limits=LIMITS) as file:
        if how == "stream":
            with file.stream() as updates:
                assert all(update.chunk < file.num_chunks for update in updates)
        else:
            for chunk in reversed(range(file.num_chunks)):
                file.decode([chunk])
        return file.decode()


def _http(path: Path) -> None:
    """Read a scene from the server of a script: right splats or a refusal, within bounds."""
    script = http_scripts.parsed(path.read_bytes())
    via = http_scripts.via_of(script)
    outcome: list[Splats | BaseException] = []
    server = http_scripts.server_of(script)
    # Compiling kernels may take a minute, and changes filters of warnings in all threads.
    decoding_tiers.use_compiled(False)
    # The server may also send the other file, as a whole.
    expected = (http_scripts.decoded_file(via), http_scripts.decoded_file("other"))
    with serving(server):
        store = {"endpoint": f"http://127.0.0.1:{server.port}", "skip_signature": "true"}
        network = NetworkOptions(
            **_HTTP,
            idle_seconds=http_scripts.idle_seconds_of(script),
            options_of_store=store | {"region": "us-east-1"},
        )
        url = {"s3": "s3://bucket/scene.cogs", "folder": server.url("scene/")}.get(
            via, server.url()
        )

        def read() -> None:
            try:
                outcome.append(_read_url(url, http_scripts.how_of(script), network))
            except BaseException as error:
                outcome.append(error)

        # A reader that waits for ever is a finding, not the end of the search.
        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        reader.join(_HTTP_SECONDS)
        assert outcome, f"no end after {_HTTP_SECONDS} s"
    assert len(server.asked) <= _HTTP_REQUESTS, len(server.asked)
    assert server.sent <= _HTTP_SENT_BYTES, server.sent
    if isinstance(outcome[0], BaseException):
        raise outcome[0]
    assert any(
        len(outcome[0]) == len(splats) and same_bits(outcome[0], splats) for splats in expected
    )


_SCENES = tuple(
    Target(
        extension[1:].replace(".", "_"),
        ("a" + extension, "side.bin") if extension == ".gltf" else ("a" + extension,),
        own_files.bounded(_scene) if extension == ".pt" else _scene,
    )
    for format_ in FORMATS
    for extension in format_.extensions
    # Three names for one format; of glTF's two, each is a container of its own.
    if extension not in (".pth", ".ckpt")
)

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        *_SCENES,
        Target("cogs", ("a.cogs",), _cogs),
        Target("cameras_json", ("cameras.json",), _cameras),
        Target("transforms_json", ("transforms.json", "p.png"), _cameras),
        Target("colmap_bin", ("cameras.bin", "images.bin"), _model),
        Target("colmap_txt", ("cameras.txt", "images.txt"), _model),
        Target("points_bin", ("points3D.bin",), _points),
        Target("points_txt", ("points3D.txt",), _points),
        Target("description", ("d.json", "p.jpg"), _description),
        Target("settings", ("settings.json",), _settings),
        Target("mask", ("v.png",), _mask),
        Target("checkpoint", ("a.npz",), own_files.read_tune_checkpoint),
        Target("batch_jsonl", ("a.jsonl",), own_files.read_batch_manifest),
        Target("batch_toml", ("a.toml",), own_files.read_batch_manifest),
        Target("batch_log", ("a.log",), own_files.read_batch_log),
        Target("folder", ("manifest.cogsm",), own_files.read_folder),
        Target("upload", ("manifest.cogsm",), own_files.read_upload),
        Target("http", ("answers.json",), _http),
    )
}
"""By name; a folder of the corpus each."""


def run_once(target: Target, data: bytes) -> CogsplatError | None:
    """Read an input in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="cogsplat-fuzz-") as folder:
        return target.run(data, Path(folder))
