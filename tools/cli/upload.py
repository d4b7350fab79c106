"""``cogsplat upload``: a folder of objects into a bucket."""

from __future__ import annotations

from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.formats.cogs.folder_source import FolderSource, names_folder
from cogsplat.tools.hosting.folder_upload import (
    UnusedObjects,
    delete_unused,
    find_unused,
    plan_upload,
    upload_folder,
)
from cogsplat.tools.hosting.object_store import Bucket
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import count_text, print_json, print_line, size_text
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber

# A hundred years; far larger numbers overflow in dates.
_MAX_HOURS: Final = 876_000


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat upload scene s3://bucket/scene --dry-run\n"
    "  cogsplat upload scene s3://bucket/scene --delete"
)
@click.argument("folder", type=PATH, metavar="FOLDER")
@click.argument("bucket", metavar="s3://BUCKET/PREFIX")
@click.option("--endpoint", metavar="URL", help="Address of an S3 server such as R2 or MinIO.")
@click.option("--region", metavar="NAME", help="Region of the bucket.")
@click.option("--dry-run", is_flag=True, help="Print the plan without writing or deleting.")
@click.option(
    "--delete",
    is_flag=True,
    help="Delete unused objects of the bucket after the upload, with confirmation.",
)
@click.option("--yes", is_flag=True, help="Delete without confirmation.")
@click.option(
    "--older-than",
    type=FiniteNumber(0, _MAX_HOURS),
    default=24.0,
    show_default=True,
    metavar="HOURS",
    help="Least age of deleted objects, hours: readers may still hold an older manifest.",
)
@click.option(
    "--concurrency",
    type=click.IntRange(1, 64),
    default=8,
    show_default=True,
    metavar="N",
    help="Number of simultaneous uploads.",
)
@partial_option
@limits_option
@quiet_option
@json_option
def upload(
    folder: Path,
    bucket: str,
    endpoint: str | None,
    region: str | None,
    dry_run: bool,
    delete: bool,
    yes: bool,
    older_than: float,
    concurrency: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Upload a folder of objects to a bucket.

    Only missing objects are sent, with media type and cache headers. The manifest is sent last, so
    that readers never find one with missing objects. A repeated upload resumes an interrupted one.
    Credentials come from the environment (AWS_ACCESS_KEY_ID …), as for gs:// and az:// addresses.
    """
    if partial_accepted():
        raise click.UsageError("--partial with an upload, expected a complete folder")
    if not names_folder(folder):
        raise click.UsageError(
            f"{folder}: is a file, expected a folder: `cogsplat convert {folder} folder/` makes one"
        )
    settings = {"endpoint": endpoint, "region": region}
    target = Bucket(bucket, {name: value for name, value in settings.items() if value})
    with (
        Stages(shown=not (quiet or as_json)) as stages,
        # Opening it first refuses a folder that is no scene or lacks an object.
        cogsplat.open(folder, limits=current_limits()),
        closing(FolderSource(folder)) as source,
    ):
        plan = plan_upload(source, folder, target)
        if not dry_run:
            upload_folder(plan, source, target, concurrency=concurrency, progress=stages)
    unused = UnusedObjects()
    if delete:
        age = timedelta(hours=older_than)
        unused = find_unused(target, older_than=age)
        if unused.names and not dry_run:
            if not yes:
                _confirm(unused, target.name, as_json=as_json)
            unused = delete_unused(unused, target, older_than=age)
    if as_json:
        print_json(
            {
                "source": str(folder),
                "output": target.name,
                "dry_run": dry_run,
                "objects_written": len(plan.objects),
                "object_bytes_written": plan.object_bytes,
                "objects_shared": plan.num_existing,
                "manifest_written": plan.manifest_changes,
                "deleted": len(unused.names),
                "deleted_bytes": unused.size_bytes,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        would = "would be " if dry_run else ""
        print_line(
            f"{target.name}: {count_text(len(plan.objects), 'object')} {would}written "
            f"({size_text(plan.object_bytes)}), {plan.num_existing:,} there already; manifest "
            f"{plan.manifest.name} {would + 'written' if plan.manifest_changes else 'the same'}"
        )
        if delete:
            print_line(
                f"{target.name}: {count_text(len(unused.names), 'object')} {would}deleted "
                f"({size_text(unused.size_bytes)}), {unused.num_recent:,} unused and too new"
            )


def _confirm(unused: UnusedObjects, name: str, *, as_json: bool) -> None:
    """Ask whether to delete unused objects; abort the command without consent."""
    question = (
        f"Delete {count_text(len(unused.names), 'object')} ({size_text(unused.size_bytes)}) of "
        f"{name} that {count_text(len(unused.manifests), 'manifest')} do not need?"
    )
    if as_json:
        raise click.UsageError("--delete and --json, expected --yes with them")
    click.confirm(question, abort=True, err=True)
