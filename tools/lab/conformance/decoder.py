"""The decoders of this project behind the conformance protocol: numpy, compiled, reference.

Run ``python -m cogsplat.tools.lab.conformance.decoder numpy|compiled|reference``.
"""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.streams import decoding_tiers
from cogsplat.formats.cogs.folder_map import MANIFEST_SUFFIX
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import FileSource

from . import reference_decoder, reference_drawing
from .protocol import Answer
from .reference_folders import file_of_folder

ARRAYS: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")
KINDS: Final = ("numpy", "compiled", "reference")


def hello(kind: str) -> Answer:
    """Return the answer to ``hello``: name, version and capabilities of a decoder of `KINDS`."""
    return {
        "name": f"cogsplat ({kind})",
        "version": cogsplat.__version__,
        "level": "reader" if kind == "reference" else "verifier",
        # The reference decoder reads valid, complete files only.
        "refuses": kind != "reference",
        "partial": kind != "reference",
        "folders": True,
        # Pictures of this project's renderer need numba.
        "draws": kind == "reference" or find_spec("numba") is not None,
    }


def answer_request(kind: str, request: Answer) -> Answer:
    """Return the answer to a request, writing decoded arrays or a picture to ``out``."""
    if request.get("op") == "hello":
        return hello(kind)
    path, out = Path(str(request["path"])), Path(str(request["out"]))
    if request.get("op") == "draw":
        return _draw(kind, path, out, request["camera"])
    if kind == "reference":
        return _decode_by_reference(path, out, request)
    try:
        # The file name decides between file and folder; commands look at the first bytes.
        source = FolderSource(path) if path.suffix == MANIFEST_SUFFIX else FileSource(path)
        with open_cogs(source, partial=bool(request["partial"])) as file:
            if request["verify"]:
                file.verify()
            splats = file.decode(refine=bool(request["refine"]), extras=False)
    except CogsplatError as error:
        return {"ok": False, "code": error.code, "message": error.message}
    rows = [getattr(splats, name).astype("<f4").tobytes() for name in ARRAYS]
    out.write_bytes(b"".join(rows))
    return {"ok": True, "splats": len(splats)}


def _draw(kind: str, path: Path, out: Path, camera: Any) -> Answer:
    """Answer a ``draw`` request for a complete file."""
    if kind == "reference":
        values = reference_drawing.draw(path.read_bytes(), reference_drawing.Camera(**camera))
        picture = np.array(values, np.float32)
    else:
        from cogsplat.codec.render.rasteriser import render

        with cogsplat.open(path) as file:
            splats = file.decode()
        rotation, translation = (np.array(camera[key]) for key in ("rotation", "translation"))
        pose = {"rotation": rotation.reshape(3, 3), "translation": translation}
        picture = render(splats, Camera(**{**camera, **pose}))
    out.write_bytes(picture.astype("<f4").tobytes())
    return {"ok": True}


def _decode_by_reference(path: Path, out: Path, request: Answer) -> Answer:
    """Answer a ``decode`` request with the reference decoder."""
    data = path.read_bytes()
    if path.suffix == MANIFEST_SUFFIX:
        objects = {f"segments/{x.name}": x.read_bytes() for x in path.parent.glob("segments/*")}
        data = file_of_folder({path.name: data, **objects}, path.name)
    scene = reference_decoder.decode(data, refine=bool(request["refine"]))
    rows = [np.array(scene.rows[name], np.float32).astype("<f4").tobytes() for name in ARRAYS]
    out.write_bytes(b"".join(rows))
    return {"ok": True, "splats": len(scene.rows["means"])}


def main(arguments: list[str]) -> int:
    """Answer requests from standard input until it ends."""
    if len(arguments) != 1 or arguments[0] not in KINDS:
        print(f"expected one of {', '.join(KINDS)}", file=sys.stderr)
        return 2
    (kind,) = arguments
    # Else the numpy decoder would switch to compiled kernels as soon as they are loaded.
    if not decoding_tiers.use_compiled(kind == "compiled") and kind == "compiled":
        print("numba is not installed, expected the extra `encode`", file=sys.stderr)
        return 4
    for line in sys.stdin:
        print(json.dumps(answer_request(kind, json.loads(line))), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
