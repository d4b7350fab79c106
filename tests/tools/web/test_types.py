"""The TypeScript of the documents is checked against the packed package and the renderers."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from running import ROOT, installed
from web_package import npm

pytestmark = pytest.mark.slow

DOCUMENTS = ("docs/guides/bundlers.md", "docs/guides/sizes.md", "tools/web/README.md")


# Pairs of `module` and `moduleResolution`.
RESOLUTIONS = (("esnext", "bundler"), ("nodenext", "nodenext"))


def test_typescript_of_the_documents_is_correct(tmp_path: Path, web_package: Path) -> None:
    for name in ("package.json", "package-lock.json"):
        shutil.copy(web_package / "examples" / name, tmp_path)
    npm(("ci", "--prefer-offline", "--ignore-scripts", "--no-fund"), tmp_path)
    package = tmp_path / "node_modules" / "cogsplat"
    shutil.copytree(web_package / "dist", package / "dist")
    shutil.copy(web_package / "package.json", package)
    blocks = 0
    for document in DOCUMENTS:
        text = (ROOT / document).read_text(encoding="utf-8")
        for block in re.findall(r"^```ts\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            (tmp_path / f"block{blocks}.ts").write_text(block, encoding="utf-8")
            blocks += 1
    assert blocks >= 8
    compiler = web_package / "node_modules" / "typescript" / "bin" / "tsc"
    for module, resolution in RESOLUTIONS:
        options = {
            "compilerOptions": {
                "strict": True,
                "noEmit": True,
                "target": "es2022",
                "lib": ["es2022", "dom", "dom.iterable"],
                "module": module,
                "moduleResolution": resolution,
                "moduleDetection": "force",
                "types": ["webxr"],
                # Those of the renderers need not be right.
                "skipLibCheck": True,
            },
            "include": ["*.ts"],
        }
        (tmp_path / "tsconfig.json").write_text(json.dumps(options), encoding="utf-8")
        done = subprocess.run(
            [installed("node"), str(compiler), "-p", "."],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{resolution}: {done.stdout}"
