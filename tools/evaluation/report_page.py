"""Report on an encode: figures, plots and images in one self-contained HTML file."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import printable
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.tools.pictures.png import to_image
from cogsplat.tools.pictures.svg_charts import Series, line_chart
from cogsplat.tools.terminal.output import display_title, size_text

from .byte_inventory import ChunkSizes, StoredSize, chunk_sizes, stored_sizes
from .photos import Photos
from .prefix_quality import PREFIX_FRACTIONS, Colour, PrefixQuality, decode_fraction

DIFFERENCE_GAIN: Final = 8
"""Factor on differences, which would otherwise be invisible."""

# Longest side of an image in the report, px.
_THUMBNAIL_PX: Final = 480
# Number of views shown: the worst, the median and the best.
_SHOWN_VIEWS: Final = 3

_STYLE: Final = """
:root{color-scheme:light dark;--ink:#1d2125;--soft:#5d666f;--line:#dfe3e7;--paper:#fff;
--card:#f5f7f8;--bar:#0072b2}
@media(prefers-color-scheme:dark){:root{--ink:#e8eaec;--soft:#9aa3ab;--line:#33393f;
--paper:#16191c;--card:#1f2428;--bar:#4aa3d8}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,sans-serif}
main{max-width:1080px;margin:0 auto;padding:32px 24px 64px}
h1{font-size:26px;line-height:1.2;margin:0 0 4px;overflow-wrap:anywhere}
h2{font-size:18px;margin:44px 0 12px}
p{margin:0 0 12px;color:var(--soft);max-width:75ch}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;
margin:24px 0 0}
.tile{background:var(--card);border-radius:8px;padding:12px 14px}
.tile b{display:block;font-size:22px;font-weight:600;line-height:1.25;
font-variant-numeric:tabular-nums}
.tile span{color:var(--soft);font-size:13px}
.plot{background:#fff;border:1px solid var(--line);border-radius:8px;padding:8px;overflow-x:auto}
.plot svg{display:block;max-width:100%;height:auto;margin:0 auto}
.wide{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:right;padding:5px 10px;border-bottom:1px solid var(--line);white-space:nowrap}
th{font-weight:500;font-size:13px;color:var(--soft)}
th.l,td.l{text-align:left}
td.meter{width:34%;min-width:120px}
.meter i{display:block;height:12px;min-width:1px;border-radius:2px;background:var(--bar)}
.row{display:grid;gap:10px;margin:0 0 18px;align-items:start}
figure{margin:0}
figure img{display:block;width:100%;height:auto;border-radius:4px;background:#000}
figcaption{font-size:13px;color:var(--soft);padding:4px 2px}
footer{margin-top:48px;color:var(--soft);font-size:13px}
"""


@dataclass(frozen=True, eq=False)
class ReportInput:
    """Input of a report: the source, the file, the test views and the quality of prefixes.

    Parameters
    ----------
    scene : Path
        Path of the source, for its name.
    source_bytes : int
        Size of the source's file, bytes.
    source : Splats
        The source scene.
    path : Path
        The COGS file.
    cameras : sequence of Camera
        Test views, at least one.
    test_views : str
        Description of the test views, e.g. their origin.
    background : tuple of float
        RGB colour of the background.
    photos : Photos or None
        Photos of the test views.
    qualities : sequence of PrefixQuality
        Quality at each of `PREFIX_FRACTIONS`; the whole file is last.
    settings : sequence of (str, str)
        Name and value of each setting of the encode.
    threads : int
        Number of threads, 0 for all cores.
    """

    scene: Path
    source_bytes: int
    source: Splats
    path: Path
    cameras: Sequence[Camera]
    test_views: str
    background: Colour
    photos: Photos | None
    qualities: Sequence[PrefixQuality]
    settings: Sequence[tuple[str, str]]
    threads: int = 0


def write_report(
    inputs: ReportInput, path: Path, *, force: bool = False, progress: Progress = silent
) -> int:
    """Write a report as an HTML file; return the file's size in bytes.

    Parameters
    ----------
    inputs : ReportInput
        Input of the report.
    path : Path
        The output.
    force : bool
        Whether an existing file may be replaced.
    progress : Progress
        Called with ``report``.

    Raises
    ------
    StorageError
        See `atomic_write`, e.g. ``exists``.
    CogsplatError
        The COGS file cannot be read.
    """
    progress("report", 0, 1)
    page = render_page(inputs).encode()
    with atomic_write(path, force=force) as file:
        file.write(page)
    progress("report", 1, 1)
    return len(page)


def render_page(inputs: ReportInput) -> str:
    """Return the report as an HTML document."""
    with cogsplat.open(inputs.path) as file:
        chunks, kept, predicted = chunk_sizes(file), file.root.splats, file.chunks.quality
        ends = [chunk.head_offset + chunk.head_bytes for chunk in chunks]
        sizes = stored_sizes(file)
    curve = [(end, float(db)) for end, db in zip(ends, predicted, strict=True) if db]
    name = _escaped(display_title(inputs.scene))
    sections = [
        _tiles(inputs, kept, float(predicted[-1]) if len(predicted) else 0.0),
        "<h2>Quality as bytes arrive</h2>"
        f"<p>PSNR against the source's own pictures in {_escaped(inputs.test_views)}; roaming "
        "views are farther back than these cameras and rotated. The predicted curve is the "
        "estimate that the encoder stored in the file, from its own views. It includes every "
        "chunk's tail, but is drawn at the end of the chunk's head.</p>",
        f'<div class="plot">{_curves(inputs, curve)}</div>',
        _quality_table(inputs.qualities),
        "<h2>Pictures</h2>"
        f"<p>Source, decoded file, and their difference times {DIFFERENCE_GAIN}.</p>",
        *_pictures(inputs),
        "<h2>Where the bytes are</h2>",
        _attributes(sizes, kept),
        "<h2>Chunks</h2>",
        _chunks(chunks, ends, predicted),
        "<h2>Settings</h2>",
        _table(["", ""], [[_escaped(a), _escaped(b)] for a, b in inputs.settings], left=2),
        f"<footer>cogsplat {_escaped(cogsplat.__version__)}</footer>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{name}: encode report</title><style>{_STYLE}</style></head>\n<body><main>"
        f"<h1>{name}</h1><p>as {_escaped(display_title(inputs.path))}</p>\n"
        + "\n".join(sections)
        + "\n</main></body></html>\n"
    )


def _escaped(text: str) -> str:
    """Escape text for HTML."""
    # Names of files and cameras may contain control characters and lone surrogates.
    return escape(printable(text))


def _tiles(inputs: ReportInput, kept: int, predicted_db: float) -> str:
    """Return the tiles with the main figures."""
    size = inputs.path.stat().st_size
    whole = inputs.qualities[-1]
    tiles = [
        (size_text(size), f"{size / max(kept, 1):.2f} bytes per splat"),
        (f"{inputs.source_bytes / size:.1f}×", f"smaller than {size_text(inputs.source_bytes)}"),
        (f"{kept:,}", f"of {len(inputs.source):,} splats"),
        (f"{whole.held_out_db:.2f} dB", f"test views, SSIM {whole.held_out_ssim:.4f}"),
        (f"{whole.worst_db:.2f} dB", f"worst view, {whole.worst_view}"),
        (f"{whole.roam_db:.2f} dB", "roaming views"),
    ]
    if predicted_db:
        tiles.append((f"{predicted_db:.2f} dB", "predicted by the encoder"))
    if inputs.photos and whole.photos_db is not None:
        lost = inputs.photos.source_db - whole.photos_db
        tiles.append((f"{whole.photos_db:.2f} dB", f"against photos, {lost:.2f} dB lost"))
    cells = (
        f'<div class="tile"><b>{_escaped(big)}</b><span>{_escaped(small)}</span></div>'
        for big, small in tiles
    )
    return f'<div class="tiles">{"".join(cells)}</div>'


def _curves(inputs: ReportInput, predicted: Sequence[tuple[int, float]]) -> str:
    """Return the chart of PSNR by bytes received."""

    def points(of: Callable[[PrefixQuality], float | None]) -> tuple[tuple[float, float], ...]:
        pairs = ((q.size_bytes, of(q)) for q in inputs.qualities if q.splats)
        return tuple((float(max(size, 1)), db) for size, db in pairs if db is not None)

    series = [
        Series("test views", points(lambda q: q.held_out_db)),
        Series("roaming", points(lambda q: q.roam_db), style=2),
        Series("worst view", points(lambda q: q.worst_db), style=1),
    ]
    if predicted:
        series.append(Series("predicted", tuple((float(x), y) for x, y in predicted), style=6))
    if inputs.photos:
        series.append(Series("photos", points(lambda q: q.photos_db), style=3))
    return line_chart(
        "PSNR after the first bytes", "bytes received", "PSNR, dB", series,
        x_text=lambda x: size_text(int(x)).replace(".0 ", " ").replace(".00 ", " "),
    )  # fmt: skip


def _quality_table(qualities: Sequence[PrefixQuality]) -> str:
    """Return the table of the prefixes' quality."""
    rows = []
    for q in qualities:
        row = [
            f"{q.share:.0%}", size_text(q.size_bytes), f"{q.splats:,}",
            f"{q.held_out_db:.2f}", f"{q.held_out_ssim:.4f}", f"{q.worst_db:.2f}",
            f"{q.roam_db:.2f}", f"{q.roam_ssim:.4f}",
        ]  # fmt: skip
        rows.append(row + ([f"{q.photos_db:.2f}"] if q.photos_db is not None else []))
    heads = ["share", "bytes", "splats", "PSNR dB", "SSIM", "worst dB", "roam dB", "roam SSIM"]
    heads += ["photos dB"] if len(rows[0]) > len(heads) else []
    return _table(heads, rows, left=0)


def _pictures(inputs: ReportInput) -> list[str]:
    """Return rows of images: source, decoded file and difference; then prefixes of one view."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    whole = cogsplat.decode(inputs.path, threads=inputs.threads)
    config = RenderConfig(background=inputs.background, threads=inputs.threads)
    found = view_quality.view_qualities(
        inputs.source, whole, inputs.cameras,
        background=inputs.background, threads=inputs.threads,
    )  # fmt: skip
    ranked = np.argsort([quality.psnr_db for quality in found], kind="stable")
    ranks = np.unique(np.linspace(0, len(ranked) - 1, min(_SHOWN_VIEWS, len(ranked))).round())
    parts = []
    for rank in ranks.astype(int):
        view = int(ranked[rank])
        camera, quality = inputs.cameras[view], found[view]
        source, ours = render(inputs.source, camera, config), render(whole, camera, config)
        what = {0: "worst view", len(ranked) - 1: "best view"}.get(int(rank), "median view")
        figures = [
            _figure(source, f"{what}, {camera.name}: source"),
            _figure(ours, f"decoded, PSNR {quality.psnr_db:.2f} dB, SSIM {quality.ssim:.4f}"),
            _figure(np.abs(np.clip(source, 0, 1) - np.clip(ours, 0, 1)) * DIFFERENCE_GAIN,
                    f"difference ×{DIFFERENCE_GAIN}"),
        ]  # fmt: skip
        parts.append(_row(figures))
    camera = inputs.cameras[int(ranked[len(ranked) // 2])]
    strip = []
    for prefix_quality, fraction in zip(inputs.qualities, PREFIX_FRACTIONS, strict=True):
        prefix = decode_fraction(inputs.path, fraction, threads=inputs.threads)
        size = size_text(prefix_quality.size_bytes)
        text = f"{fraction:.0%}, {size}: {len(prefix):,} splats"
        strip.append(_figure(render(prefix, camera, config), text))
    parts.append(f"<p>{_escaped(camera.name)} from prefixes of the file.</p>")
    parts.append(_row(strip))
    return parts


def _row(figures: Sequence[str]) -> str:
    """Return figures side by side."""
    columns = f"grid-template-columns:repeat({len(figures)},minmax(0,1fr))"
    return f'<div class="row" style="{columns}">{"".join(figures)}</div>'


def _figure(pixels: NDArray[np.floating], caption: str) -> str:
    """Return a figure with an embedded PNG and a caption."""
    image = to_image(pixels)
    image.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
    page = io.BytesIO()
    image.save(page, format="PNG", optimize=True)
    data = base64.b64encode(page.getvalue()).decode()
    text = _escaped(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{data}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _attributes(sizes: Sequence[StoredSize], splats: int) -> str:
    """Return the table of bytes by stream, largest first."""
    total = sum(size.stored_bytes for size in sizes)
    largest = max(size.stored_bytes for size in sizes)
    rows = [
        [
            _escaped(size.segment),
            _escaped(size.label),
            f"{size.stored_bytes:,}",
            f"{size.stored_bytes / total:.1%}",
            f"{8 * size.stored_bytes / max(splats, 1):.2f}",
            f'<i style="width:{100 * size.stored_bytes / largest:.1f}%"></i>',
        ]
        for size in sorted(sizes, key=lambda size: -size.stored_bytes)
    ]
    heads = ["segment", "stream", "bytes", "share", "bits per splat", ""]
    return _table(heads, rows, left=2, meter=True)


def _chunks(
    chunks: Sequence[ChunkSizes], ends: Sequence[int], predicted: NDArray[np.float32]
) -> str:
    """Return the table of chunks."""
    rows = [
        [
            str(chunk.number),
            f"{chunk.splats:,}",
            f"{chunk.head_bytes:,}",
            f"{chunk.tail_bytes:,}",
            f"{(chunk.head_bytes + chunk.tail_bytes) / chunk.splats:.2f}",
            size_text(end),
            f"{chunk.share_so_far:.1%}" if chunk.share_so_far is not None else "-",
            f"{db:.2f}" if db else "-",
        ]
        for chunk, end, db in zip(chunks, ends, predicted, strict=True)
    ]
    heads = [
        "chunk", "splats", "head B", "tail B", "B per splat", "head ends at",
        "contribution so far", "predicted dB",
    ]  # fmt: skip
    return _table(heads, rows, left=0)


def _table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, left: int, meter: bool = False
) -> str:
    """Return an HTML table.

    Parameters
    ----------
    heads : sequence of str
        Headings of the columns, as HTML; all empty for no heading.
    rows : sequence of sequence of str
        Cells, as HTML: the caller escapes text.
    left : int
        Number of left-aligned columns.
    meter : bool
        Whether the last column shows bars, and so is styled for them.
    """

    def tag(kind: str, column: int, text: str) -> str:
        css_class = "l" if column < left else ""
        css_class = "meter" if meter and kind == "td" and column == len(heads) - 1 else css_class
        return f"<{kind}{f' class={css_class}' if css_class else ''}>{text}</{kind}>"

    head = "".join(tag("th", c, text) for c, text in enumerate(heads)) if any(heads) else ""
    body = "".join(
        f"<tr>{''.join(tag('td', c, text) for c, text in enumerate(row))}</tr>" for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'
