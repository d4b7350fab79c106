"""``cogsplat batch``: encode the scenes of a manifest that are new or changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.network.object_output import ObjectOutput
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.storage.atomic import open_for_read, storage_errors
from cogsplat.tools.terminal.config_file import settable_options
from cogsplat.tools.terminal.options import (
    json_option,
    quiet_option,
    scheduler_option,
    threads_option,
)
from cogsplat.tools.terminal.output import display_name, print_error_line, print_json, print_line
from cogsplat.tools.terminal.standard_streams import PATH, WRITTEN_PATH
from cogsplat.tools.workflow.batch_manifest import BatchScene, read_manifest

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
    log : Path
        Log file, with a line for each encode.
    common : tuple of str
        Command-line options of every encode.
    before : mapping of str to mapping
        Last log line of each output finished by earlier runs, by output.
    quiet : bool
        Whether to print nothing.
    running : set of Popen
        Running encode processes.
    stopped : bool
        Whether `stop` was called; then no further process starts.
    lock : Lock
        Lock of `running` and `stopped`.
    """

    folder: Path
    log: Path
    common: tuple[str, ...]
    before: Mapping[str, Mapping[str, object]]
    quiet: bool
    running: set[subprocess.Popen[str]] = field(default_factory=set)
    stopped: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def encode_if_changed(self, scene: BatchScene) -> dict[str, object]:
        """Encode a scene in a process unless its output is up to date; return the log line."""
        line: dict[str, object] = {"input": scene.input, "output": scene.output}
        start = time.monotonic()
        earlier = self.before.get(scene.output, {})
        try:
            line["fingerprint"] = scene.fingerprint(self.folder)
            same = earlier.get("fingerprint") == line["fingerprint"]
            if same and self._is_up_to_date(scene, earlier):
                return {**line, "status": "skipped"}
        except CogsplatError as error:
            failure = {"code": error.code, "message": error.message, "exit_code": error.exit_code}
            return {**line, "status": "failed", "error": failure}
        # Outputs of an earlier run are replaced, other files are not.
        words = [*scene.words, *(["--force"] if earlier else []), *self.common]
        code, out, err = self._run(["encode", scene.input, scene.output, *words, "--json"])
        line["encode_s"] = round(time.monotonic() - start, 3)
        try:
            report = json.loads(out)
        except ValueError:
            message = (err.strip() or "no output").splitlines()[-1]
            report = {"error": {"code": "ended", "message": message, "exit_code": code}}
        if code or "error" in report:
            return {**line, "status": "failed", "error": report.get("error")}
        return {**line, "status": "done", "result": report}

    def _is_up_to_date(self, scene: BatchScene, earlier: Mapping[str, object]) -> bool:
        """Whether the output exists with the size that the log lists."""
        result = earlier.get("result")
        expected = result.get("bytes") if isinstance(result, dict) else None
        if is_url(scene.output):
            return ObjectOutput(scene.output).size() == expected
        path = self.folder / scene.output
        return path.is_file() and path.stat().st_size == expected

    def _run(self, words: list[str]) -> tuple[int, str, str]:
        """Run a ``cogsplat`` command in a process; return exit code, output and error output."""
        root = Path(cogsplat.__file__).parents[1]
        paths = [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        command = [sys.executable, "-P", "-m", "cogsplat.tools.main", *words]
        with self.lock:
            if self.stopped:
                return 130, "", "interrupted"
            process = subprocess.Popen(
                command,
                cwd=self.folder,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
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

    def write(self, line: Mapping[str, object]) -> None:
        """Add a line to the log, unless its scene was skipped, and print it, unless quiet."""
        text = json.dumps(line, allow_nan=False)
        if line["status"] != "skipped":
            with storage_errors(self.log), self.log.open("a", encoding="utf-8") as file:
                file.write(f"{text}\n")
        if not self.quiet:
            print_line(text)


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
    38}}, or TOML with the same keys in [[scene]]. Options are those of encode, true for a flag.
    Paths are relative to the folder of the manifest; URLs such as s3://bucket/a.ply are accepted.

    A line of JSON is printed for each scene. A failed scene does not stop the others; the exit
    status is then 3.
    """
    options = settable_options(encode)
    scenes = read_manifest(
        manifest, {name: options[name] for name in options if name not in _SET_BY_BATCH}
    )
    log = log or manifest.with_name(f"{manifest.name}.log")
    common = [f"--threads={threads}", *([f"--scheduler={scheduler}"] if scheduler else [])]
    folder = manifest.absolute().parent
    run = _Batch(folder, log, tuple(common), _read_log(log), quiet or as_json)
    lines: list[dict[str, object]] = []
    pool = ThreadPoolExecutor(jobs)
    try:
        for future in [pool.submit(run.encode_if_changed, scene) for scene in scenes]:
            lines.append(future.result())
            run.write(lines[-1])
    finally:
        # Terminate the encodes first, because the pool waits for them.
        run.stop()
        pool.shutdown(cancel_futures=True)
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


def _read_log(log: Path) -> dict[str, Mapping[str, object]]:
    """Return the last line of each finished output in the log of earlier runs."""
    found: dict[str, Mapping[str, object]] = {}
    if not log.exists():
        return found
    with open_for_read(log) as file:
        lines = file.read().decode(errors="replace").splitlines()
    for text in lines:
        try:
            line = json.loads(text)
        except ValueError:
            # An interrupted run may have left half a line; its scene is encoded again.
            continue
        if isinstance(line, dict) and line.get("status") == "done":
            found[str(line.get("output"))] = line
    return found
