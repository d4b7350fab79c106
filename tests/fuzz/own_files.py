"""Fuzz targets for checkpoints, logs and manifests, which other programs may have changed.

Each reads an input as a command does, within `MOST_BYTES` of memory and `MOST_SECONDS` of its
thread's time.
"""

import functools
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

import cogsplat
from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.fit.checkpoint_arrays import CheckpointArrays
from cogsplat.codec.fit.quantised_training import QuantisedTraining
from cogsplat.codec.fit.tune_config import TuneRequest
from cogsplat.codec.fit.tuning import _TuningRun
from cogsplat.codec.fit.tuning_views import TuningViews
from cogsplat.codec.progress import silent
from cogsplat.codec.streams import decoding_tiers
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.storage.limits import Limits
from cogsplat.tools.cli.encode import encode
from cogsplat.tools.hosting.folder_upload import find_unused, plan_upload
from cogsplat.tools.hosting.object_store import Bucket, StoredObject
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.terminal.config_file import settable_options
from cogsplat.tools.workflow.batch_log import BatchLog
from cogsplat.tools.workflow.batch_manifest import read_manifest
from cogsplat.tools.workflow.tune_checkpoint import read_checkpoint

MOST_BYTES = 64 << 20
MOST_SECONDS = 20.0

RUN = "0123456789abcdef" * 4
"""Fingerprint of the checkpoints of the corpus."""

LIMITS = Limits(decoded_bytes=32 << 20, small_bytes=16 << 20, splats=200_000, cameras=5000)
SPLATS = 9
VECTORS = Path(__file__).resolve().parents[1] / "vectors" / "valid"
OLD = datetime(2020, 1, 1, tzinfo=UTC)


def bounded(read: Callable[[Path], object]) -> Callable[[Path], None]:
    """Return a reader that fails where it takes too much memory or time."""

    @functools.wraps(read)
    def measured(path: Path) -> None:
        # CPython may crash where tracing starts or stops while another thread compiles kernels.
        compiled = decoding_tiers.is_compiled()
        decoding_tiers.use_compiled(False)
        decoding_tiers.LOADER.join()
        tracemalloc.start()
        begin = time.thread_time()
        try:
            read(path)
        finally:
            seconds, peak = time.thread_time() - begin, tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            decoding_tiers.use_compiled(compiled)
            assert peak < MOST_BYTES, f"{peak} bytes"
            assert seconds < MOST_SECONDS, f"{seconds} s"

    return measured


@functools.cache
def tuning_run() -> _TuningRun:
    """Return a run of a small scene, as at the start of ``tune``."""
    cameras = synth_cameras(3, 16, 16)
    views = TuningViews(cameras)
    return _TuningRun(synth(SPLATS), TuneRequest(views), None, None, silent)


def checkpoint_states() -> Iterator[tuple[str, CheckpointArrays]]:
    """Yield name and arrays of checkpoints of the run: after a round, and near its end."""
    run = tuning_run()
    state = {name: np.array(values) for name, values in run.state().items()}
    yield "round", state
    trained = dict(run.trainer.state())
    kept = {f"kept0.{name}": np.array(values) for name, values in trained.items()}
    base = {
        name.replace("splats.", "base."): np.array(values)
        for name, values in trained.items()
        if name.startswith("splats.")
    }
    books = {f"codebook.0.shape.{rows}.0": np.arange(rows, dtype=np.uint8) for rows in (4,)}
    stored = {"stored": np.array((10.0, 600.0, 38.5)), "recoveries": np.array((1, 5))}
    yield "quantised", state | kept | base | books | stored


@bounded
def read_tune_checkpoint(path: Path) -> None:
    """Resume a run; check that all its arrays have one row per splat."""
    state = read_checkpoint(path, RUN)
    run = tuning_run()
    run.restore(state)
    quantised = QuantisedTraining.__new__(QuantisedTraining)
    quantised.restore_codebooks(state)
    count = len(run.trainer.splats)
    assert 0 < count <= SPLATS
    for name, values in run.state().items():
        if name.startswith(("splats.", "base.", "adam_")):
            assert values.dtype == np.float32
            assert len(values) == count


@functools.cache
def _options() -> dict[str, object]:
    return dict(settable_options(encode))


@bounded
def read_batch_manifest(path: Path) -> None:
    """Read the scenes of a batch; a scene has a fingerprint, or fails alone."""
    for scene in read_manifest(path, _options()):  # type: ignore[arg-type]
        assert all(isinstance(text, str) for text in (*scene.inputs, *scene.outputs, *scene.words))
        if "://" in scene.input:
            continue
        with suppress(CogsplatError):
            assert len(scene.fingerprint(path.parent)) == 64


@bounded
def read_batch_log(path: Path) -> None:
    """Continue a log: lines that are none are skipped, and a new line is read back."""
    with BatchLog(path, path.parent) as log:
        for name in ("a.cogs", "./a.cogs", "", "x"):
            assert (log.done(name) is None) or log.owns(name)
        log.write({"output": "new.cogs", "status": "started"})
    with BatchLog(path, path.parent) as log:
        assert log.owns("new.cogs")


@functools.cache
def _vector_objects() -> dict[str, bytes]:
    """Return the objects of all folders that manifests of the corpus stand for, by name."""
    import tempfile

    found: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as name:
        for vector in MANIFEST_VECTORS:
            folder = Path(name) / vector
            cogsplat.unpack(VECTORS / f"{vector}.cogs", folder)
            for path in (folder / "segments").iterdir():
                found[f"segments/{path.name}"] = path.read_bytes()
    return found


MANIFEST_VECTORS = ("pages", "chunks", "vq", "description")


def vector_manifest(vector: str, folder: Path) -> bytes:
    """Return the manifest of a conformance vector."""
    cogsplat.unpack(VECTORS / f"{vector}.cogs", folder)
    return (folder / "manifest.cogsm").read_bytes()


def _place_objects(folder: Path) -> None:
    """Write the objects of a manifest into its folder."""
    (folder / "segments").mkdir()
    for name, data in _vector_objects().items():
        (folder / name).write_bytes(data)


def read_folder(path: Path) -> None:
    """Decode a folder whose manifest is the input."""
    _place_objects(path.parent)
    _decode_folder(path)


@bounded
def _decode_folder(path: Path) -> None:
    with cogsplat.open(path, limits=LIMITS) as file:
        splats = file.decode(threads=1)
        file.verify()
        assert len(splats) == file.root.splats <= LIMITS.splats


@dataclass
class _StoredFolder(Bucket):
    """A bucket with the files of a folder."""

    folder: Path
    name: str = "memory"

    def objects(self, folder: str = "") -> Iterator[StoredObject]:
        for path in sorted((self.folder / folder).rglob("*.*")):
            name = path.relative_to(self.folder).as_posix()
            yield StoredObject(name, path.stat().st_size, OLD)

    def top_objects(self) -> list[StoredObject]:
        return [entry for entry in self.objects() if "/" not in entry.name]

    def read(self, name: str) -> bytes | None:
        path = self.folder / name
        return path.read_bytes() if path.is_file() else None


def read_upload(path: Path) -> None:
    """Plan an upload of a folder into a bucket that has it, and find what may be deleted there."""
    _place_objects(path.parent)
    _plan(path)


@bounded
def _plan(path: Path) -> None:
    bucket = _StoredFolder(path.parent)
    unused = set(find_unused(bucket, older_than=timedelta(0)).names)
    # A manifest whose scene can be read never loses an object.
    source = FolderSource(path)
    try:
        plan = plan_upload(source, path, bucket)
        assert not plan.manifest_changes
        assert not unused & set(source.objects())
    finally:
        source.close()
