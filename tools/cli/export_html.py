"""``cogsplat export-html``: an HTML page with the viewer and a scene."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

import click

from cogsplat.formats.storage.atomic import (
    atomic_write,
    exists,
    is_folder,
    open_for_read,
    storage_errors,
)
from cogsplat.formats.storage.regular_files import FileKind, replace_auxiliary
from cogsplat.tools.delivery.viewer_pages import (
    BLOCK_BYTES,
    PAGE_NAME,
    SCENE_NAME,
    linked_page,
    write_standalone_page,
)
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    display_title,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.output_names import HTML, check_name
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath, is_standard_output
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.viewable import viewable

# File in the folder of a page while the files are renamed. After a kill, it tells a later export
# that files of the same names are its own.
_MARKER_NAME: Final = ".cogsplat-export"
_MARKER_LINE: Final = b"unfinished export of cogsplat export-html\n"
_MARKER: Final = FileKind("marker of cogsplat export-html", re.compile(re.escape(_MARKER_LINE)))


@click.command(
    "export-html",
    epilog="\b\nExample:\n"
    "  cogsplat export-html scene.cogs page.html\n"
    "  cogsplat export-html scene.cogs site --folder",
)
@click.argument("scene", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(".html"), metavar="OUT")
@click.option(
    "--folder",
    is_flag=True,
    help="Write a folder instead: a page and the scene as a file of its own, which the page "
    "streams from any web server.",
)
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def export_html(
    scene: Path,
    out: Path,
    folder: bool,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Write a page that shows a scene in any browser.

    OUT is one file with viewer and scene, a third larger than the scene; it opens with a double
    click. With --folder, the scene is a file of its own and is shown while it loads. Scenes of
    other formats than COGS are encoded first.
    """
    if folder and is_standard_output(out):
        raise click.UsageError("--folder with standard output, expected the name of a folder")
    if not folder:
        check_name(out, HTML)
        check_outputs(out, force=force)
    shown = not (quiet or as_json)
    title = display_title(scene)
    with (
        _room_for(out, sorted([*linked_page(title), SCENE_NAME]), force, needed=folder) as replace,
        viewable(scene, threads=threads, shown=shown) as given,
        ExitStack() as outputs,
        open_for_read(given.path) as source,
    ):
        if folder:
            # Files are renamed in the reverse of this order, all or none: the page last.
            for name, content in linked_page(title).items():
                outputs.enter_context(atomic_write(out / name, force=replace)).write(content)
            target = outputs.enter_context(atomic_write(out / SCENE_NAME, force=replace))
            target.writelines(_blocks(source, given.path))
            written, page = target.tell(), out / PAGE_NAME
            if not replace:
                with replace_auxiliary(out / _MARKER_NAME, _MARKER) as marker:
                    marker.write(_MARKER_LINE)
        else:
            target = outputs.enter_context(atomic_write(out, force=force))
            write_standalone_page(title, _blocks(source, given.path), target)
            written, page = target.tell(), out
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(scene),
                "page": display_name(page),
                "bytes": written,
                "splats": given.splats,
                "encoded": given.encoded,
            }
        )
    elif not quiet:
        what = "scene" if folder else "page"
        print_line(f"{page}: {count_text(given.splats, 'splat')}, {what} of {size_text(written)}")


def _blocks(file: BinaryIO, path: Path) -> Iterator[bytes]:
    """Yield the blocks of a file. Errors of reading a block name this file, not the output."""
    while True:
        with storage_errors(path):
            block = file.read(BLOCK_BYTES)
        if not block:
            return
        yield block


@contextmanager
def _room_for(folder: Path, names: list[str], force: bool, *, needed: bool) -> Iterator[bool]:
    """Prepare the folder of a page; yield whether existing files are replaced.

    The folder is created, and `names` are checked as outputs. Files are replaced with `force`, or
    where an export was killed between its renames: its marker is in the folder. The marker is
    removed after the block. A new folder is removed if the block fails. Unless `needed`, nothing is
    created or checked.
    """
    if not needed:
        yield force
        return
    marker = folder / _MARKER_NAME
    outputs = [folder / name for name in names]
    with storage_errors(folder):
        made = not is_folder(folder)
        if made:
            folder.mkdir()
    was_marked = os.path.lexists(marker)
    try:
        replace = force or was_marked
        check_outputs(*outputs, force=replace, auxiliary={marker: _MARKER})
        yield replace
    except BaseException:
        with suppress(OSError):
            if made:
                # Only files of our own: others may have been put there since.
                for path in outputs:
                    path.unlink(missing_ok=True)
            if not (was_marked or any(map(exists, outputs))):
                marker.unlink(missing_ok=True)
            if made:
                folder.rmdir()
        raise
    with storage_errors(marker):
        marker.unlink(missing_ok=True)
