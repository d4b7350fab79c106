"""``cogsplat batch``: encode the scenes of a manifest that are new or changed."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from queue import SimpleQueue
from typing import Final

import click

from cogsplat.codec.errors import CogsplatError, DataError
from cogsplat.formats.network.object_output import ObjectOutput
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.storage.atomic import TargetExistsError, is_file
from cogsplat.tools.terminal.config_file import settable_options
from cogsplat.tools.terminal.options import (
    json_option,
    quiet_option,
    scheduler_option,
    threads_option,
)
from cogsplat.tools.terminal.output import display_name, print_error_line, print_json, print_line
from cogsplat.tools.terminal.standard_streams import PATH, WRITTEN_PATH, is_file_name
from cogsplat.tools.workflow.batch_log import BATCH_LOG, BatchLog, output_keys
from cogsplat.tools.workflow.batch_manifest import BatchScene, read_manifest, scene_order
from cogsplat.tools.workflow.child_process import child_process
from cogsplat.tools.workflow.output_files import check_outputs

from .encode import encode

# Options of `encode` that `batch` itself sets for every scene.
_SET_BY_BATCH: Final = frozenset({"quiet", "threads", "scheduler"})

# Exit status if any scene failed.
_SOME_FAILED: Final = 3


@dataclass
class _Batch:
    """State of one run over a manifest, which lists the scenes to encode.

    Parameters
    ----------
    folder : Path
        Folder of the manifest, where relative paths begin.
    log : BatchLog
        Log of this run and earlier ones.
    common : tuple of str
        Command-line options of every encode.
    running : set of Popen
        Running encode processes.
    stopped : bool
        Whether `stop` was called; then no further process starts.
    lock : Lock
        Lock of `running` and `stopped`.
    """

    folder: Path
    log: BatchLog
    common: tuple[str, ...]
    running: set[subprocess.Popen[str]] = field(default_factory=set)
    stopped: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def run(self, scenes: Sequence[BatchScene], jobs: int) -> Generator[dict[str, object]]:
        """Encode scenes, a scene after the scenes whose outputs it reads; yield log lines in order.

        Parameters
        ----------
        scenes : sequence of BatchScene
            Scenes of the manifest.
        jobs : int
            Number of scenes encoded at once.
        """
        order = scene_order(scenes, self.folder)
        order.prepare()
        lines: dict[int, dict[str, object]] = {}
        failed: set[str] = set()
        begun: dict[Future[dict[str, object]], int] = {}
        ended: SimpleQueue[Future[dict[str, object]]] = SimpleQueue()
        pool = ThreadPoolExecutor(jobs)
        try:
            for number in range(len(scenes)):
                while number not in lines:
                    for ready in sorted(order.get_ready()):
                        future = pool.submit(self.encode_if_changed, scenes[ready], failed)
                        begun[future] = ready
                        future.add_done_callback(ended.put)
                    future = ended.get()
                    finished = begun.pop(future)
                    lines[finished] = future.result()
                    if lines[finished]["status"] == "failed":
                        failed |= output_keys(self.folder, scenes[finished].made)
                    order.done(finished)
                yield lines[number]
        finally:
            # Terminate the encodes first, because the pool waits for them.
            self.stop()
            pool.shutdown(cancel_futures=True)

    def encode_if_changed(
        self, scene: BatchScene, failed: AbstractSet[str] = frozenset()
    ) -> dict[str, object]:
        """Encode a scene in a process unless its output is up to date; return the log line.

        Parameters
        ----------
        scene : BatchScene
            The scene.
        failed : set of str
            Keys of the outputs of failed scenes (`output_key`). A scene that reads one of them
            fails.
        """
        line: dict[str, object] = {"input": scene.input, "output": scene.output}
        start = time.monotonic()
        try:
            scene.require_well_formed()
            self._require_encoded(scene, failed)
            line["fingerprint"] = scene.fingerprint(self.folder)
            if self._is_up_to_date(scene, line["fingerprint"]):
                return {**line, "status": "skipped"}
            # Outputs of this batch are replaced, other files are not.
            is_own = self.log.owns(scene.output)
            if not is_own:
                self._require_absent(scene)
            self.log.write({**line, "status": "started"})
        except CogsplatError as error:
            failure = {"code": error.code, "message": error.message, "exit_code": error.exit_code}
            return self._logged({**line, "status": "failed", "error": failure})
        words = [*scene.words, *(["--force"] if is_own else []), *self.common, "--json"]
        code, out, err = self._run(["encode", *words, "--", scene.input, scene.output])
        if self.stopped:
            return {**line, "status": "failed", "error": {"code": "interrupted"}}
        line["encode_s"] = round(time.monotonic() - start, 3)
        try:
            report = json.loads(out)
        except ValueError:
            message = (err.strip() or "no output").splitlines()[-1]
            report = {"error": {"code": "ended", "message": message, "exit_code": code}}
        if code or "error" in report:
            return self._logged({**line, "status": "failed", "error": report.get("error")})
        return self._logged({**line, "status": "done", "result": report})

    def _logged(self, line: dict[str, object]) -> dict[str, object]:
        """Add a line to the log; return it."""
        self.log.write(line)
        return line

    def _is_up_to_date(self, scene: BatchScene, fingerprint: object) -> bool:
        """Whether the log lists the same encode as done, and the output has the size listed."""
        done = self.log.done(scene.output)
        if done is None or done.fingerprint != fingerprint:
            return False
        if is_url(scene.output):
            return ObjectOutput(scene.output).size() == done.size_bytes
        path = self.folder / scene.output
        return is_file(path) and path.stat().st_size == done.size_bytes

    def _require_encoded(self, scene: BatchScene, failed: AbstractSet[str]) -> None:
        """Refuse a scene that reads the output of a failed one, even if an earlier one exists."""
        for name in scene.inputs:
            if any(key in failed for key in output_keys(self.folder, [name])):
                raise DataError(
                    "input-failed",
                    f"{scene.output}: reads {name}, which could not be encoded, expected it to be "
                    "encoded first",
                )

    def _require_absent(self, scene: BatchScene) -> None:
        """Refuse outputs that exist."""
        for output in scene.outputs:
            if is_url(output):
                ObjectOutput(output).require_absent()
            elif os.path.lexists(self.folder / output):
                raise TargetExistsError(output)

    def _run(self, words: list[str]) -> tuple[int, str, str]:
        """Run a ``cogsplat`` command in a process; return exit code, output and error output."""
        with ExitStack() as stack:
            with self.lock:
                if self.stopped:
                    return 130, "", "interrupted"
                process = stack.enter_context(child_process(words, self.folder))
                self.running.add(process)
            out, err = process.communicate()
            with self.lock:
                self.running.discard(process)
        return process.returncode, out, err

    def stop(self) -> None:
        """Terminate the running encodes and start no further ones."""
        with self.lock:
            self.stopped = True
            for process in self.running:
                process.terminate()


@click.command(epilog="\b\nExample:\n  cogsplat batch scenes.toml --jobs 2")
@click.argument("manifest", type=PATH)
@click.option(
    "--log",
    type=WRITTEN_PATH,
    metavar="PATH",
    help="Log file. Scenes that it lists as done are skipped unless they have changed.  [default: "
    "MANIFEST.log]",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    metavar="N",
    help="Number of scenes encoded at once, each with --threads threads.",
)
@threads_option
@scheduler_option
@quiet_option
@json_option
def batch(
    manifest: Path,
    log: Path | None,
    jobs: int,
    threads: int,
    scheduler: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Encode every scene of a manifest.

    A manifest is JSON lines such as {"input": "a.ply", "output": "a.cogs", "options": {"quality":
    38}}, or TOML with the same keys in [[scene]], and a table [options] of options of all scenes,
    which a scene can override. Options are those of encode, true for a flag. Paths are relative to
    the folder of the manifest; URLs such as s3://bucket/a.ply are accepted.

    A scene whose input or option names the output of another scene is encoded after it. A line of
    JSON is printed for each scene. A failed scene or a malformed entry does not stop the
    others; the exit status is then 3. After an interruption, the same command continues.
    """
    options = settable_options(encode)
    scenes = read_manifest(
        manifest, {name: options[name] for name in options if name not in _SET_BY_BATCH}
    )
    log = log or manifest.with_name(f"{manifest.name}.log")
    common = [f"--threads={threads}", *([f"--scheduler={scheduler}"] if scheduler else [])]
    folder = manifest.absolute().parent
    check_outputs(
        force=True,
        auxiliary={log: BATCH_LOG},
        inputs=_local_paths(folder, chain.from_iterable(scene.inputs for scene in scenes)),
        others=_local_paths(folder, chain.from_iterable(scene.outputs for scene in scenes)),
    )
    lines: list[dict[str, object]] = []
    # Closed, so that a failure to print ends the encodes before the log is closed.
    with (
        BatchLog(log, folder) as opened,
        closing(_Batch(folder, opened, tuple(common)).run(scenes, jobs)) as encoded,
    ):
        for line in encoded:
            lines.append(line)
            if not (quiet or as_json):
                print_line(json.dumps(line, allow_nan=False))
    counts = {
        status: sum(line["status"] == status for line in lines)
        for status in ("done", "skipped", "failed")
    }
    if as_json:
        report = {"manifest": display_name(manifest), "log": display_name(log), "counts": counts}
        print_json({**report, "scenes": [_without_report(line) for line in lines]})
    elif not quiet:
        print_error_line(", ".join(f"{count} {status}" for status, count in counts.items()))
    if counts["failed"]:
        click.get_current_context().exit(_SOME_FAILED)


def _without_report(line: Mapping[str, object]) -> dict[str, object]:
    """Return a log line that keeps only the file size of the encode report."""
    brief = {key: value for key, value in line.items() if key != "result"}
    result = line.get("result")
    return {**brief, "bytes": result.get("bytes") if isinstance(result, dict) else None}


def _local_paths(folder: Path, names: Iterable[str]) -> list[Path]:
    """Return the paths of names that files can have, without URLs."""
    return [folder / name for name in names if is_file_name(name) and not is_url(name)]
