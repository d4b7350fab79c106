"""``cogsplat batch``: encode many scenes, and go on where an earlier run ended."""

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
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.workflow.batch_manifest import BatchScene, read_manifest

from .encode import encode

# Options of `encode` that `batch` itself sets for every scene.
_SET_BY_BATCH: Final = frozenset({"quiet", "threads", "scheduler"})

# Exit status where some scenes failed and the others are done.
_SOME_FAILED: Final = 3


@dataclass
class _Batch:
    """One run over a manifest: what was done before, and what is under way."""

    folder: Path
    log: Path
    common: tuple[str, ...]
    before: Mapping[str, Mapping[str, object]]
    quiet: bool
    running: set[subprocess.Popen[str]] = field(default_factory=set)
    stopped: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def encode(self, scene: BatchScene) -> dict[str, object]:
        """Encode a scene in a process of its own; return its line of the log."""
        line: dict[str, object] = {"input": scene.input, "output": scene.output}
        start = time.monotonic()
        earlier = self.before.get(scene.output, {})
        try:
            line["fingerprint"] = scene.fingerprint(self.folder)
            same = earlier.get("fingerprint") == line["fingerprint"]
            if same and self._is_there(scene, earlier):
                return {**line, "status": "skipped"}
        except CogsplatError as error:
            told = {"code": error.code, "message": error.message, "exit_code": error.exit_code}
            return {**line, "status": "failed", "error": told}
        # What an earlier run has made may be replaced; what is not ours may not.
        words = [*scene.words, *(["--force"] if earlier else []), *self.common]
        code, out, err = self._run(["encode", scene.input, scene.output, *words, "--json"])
        line["encode_s"] = round(time.monotonic() - start, 3)
        try:
            told = json.loads(out)
        except ValueError:
            message = (err.strip() or "no output").splitlines()[-1]
            told = {"error": {"code": "ended", "message": message, "exit_code": code}}
        if code or "error" in told:
            return {**line, "status": "failed", "error": told.get("error")}
        return {**line, "status": "done", "result": told}

    def _is_there(self, scene: BatchScene, earlier: Mapping[str, object]) -> bool:
        result = earlier.get("result")
        expected = result.get("bytes") if isinstance(result, dict) else None
        if is_url(scene.output):
            return ObjectOutput(scene.output).size() == expected
        path = self.folder / scene.output
        return path.is_file() and path.stat().st_size == expected

    def _run(self, words: list[str]) -> tuple[int, str, str]:
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
        """End what is under way."""
        with self.lock:
            self.stopped = True
            for process in self.running:
                process.terminate()

    def write(self, line: Mapping[str, object]) -> None:
        """Add a line to the log and print it."""
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
    type=PATH,
    metavar="PATH",
    help="Where the lines go; scenes that it says are done, and that have not changed since, are "
    "left out.  [default: MANIFEST.log]",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    metavar="N",
    help="Scenes that are encoded at once, each with --threads.",
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

    A line of JSON is printed for each. A manifest is JSON lines such as {"input": "a.ply",
    "output": "a.cogs", "options": {"quality": 38}}, or TOML with the same keys in [[scene]].
    Options are those of encode, true for a flag; paths begin at the manifest's folder; addresses
    such as s3://bucket/a.ply may stand for them. A scene that fails does not stop the others; the
    exit status is then 3.
    """
    options = settable_options(encode)
    scenes = read_manifest(
        manifest, {name: options[name] for name in options if name not in _SET_BY_BATCH}
    )
    log = log or manifest.with_name(f"{manifest.name}.log")
    common = [f"--threads={threads}", *([f"--scheduler={scheduler}"] if scheduler else [])]
    folder = manifest.absolute().parent
    run = _Batch(folder, log, tuple(common), _logged(log), quiet or as_json)
    lines: list[dict[str, object]] = []
    pool = ThreadPoolExecutor(jobs)
    try:
        for future in [pool.submit(run.encode, scene) for scene in scenes]:
            lines.append(future.result())
            run.write(lines[-1])
    finally:
        # Before the pool waits for what is under way.
        run.stop()
        pool.shutdown(cancel_futures=True)
    counts = {
        status: sum(line["status"] == status for line in lines)
        for status in ("done", "skipped", "failed")
    }
    if as_json:
        report = {"manifest": display_name(manifest), "log": display_name(log), "counts": counts}
        print_json({**report, "scenes": [_brief(line) for line in lines]})
    elif not quiet:
        print_error_line(", ".join(f"{count} {status}" for status, count in counts.items()))
    if counts["failed"]:
        click.get_current_context().exit(_SOME_FAILED)


def _brief(line: Mapping[str, object]) -> dict[str, object]:
    """Return a line with the bytes of the file in place of all that its encode told."""
    brief = {key: value for key, value in line.items() if key != "result"}
    result = line.get("result")
    return {**brief, "bytes": result.get("bytes") if isinstance(result, dict) else None}


def _logged(log: Path) -> dict[str, Mapping[str, object]]:
    """Return the last line of each output that an earlier run has written to a log."""
    found: dict[str, Mapping[str, object]] = {}
    if not log.exists():
        return found
    with open_for_read(log) as file:
        lines = file.read().decode(errors="replace").splitlines()
    for text in lines:
        try:
            line = json.loads(text)
        except ValueError:
            # A run that was cut off may have left half a line; its scene is encoded again.
            continue
        if isinstance(line, dict) and line.get("status") == "done":
            found[str(line.get("output"))] = line
    return found
