"""Line and bar charts as SVG, written without a plotting library."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape

from cogsplat.codec.errors import printable

# Picture and its margins, px.
_WIDTH: Final = 860
_HEIGHT: Final = 500
_LEFT: Final = 62
_RIGHT: Final = 196
_TOP: Final = 54
_BOTTOM: Final = 54

# The colour-blind-safe palette of Okabe and Ito without black, and four more colours for long
# legends.
_COLOURS: Final = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#b8a800",
    "#8c510a", "#762a83",
)  # fmt: skip
_SHAPES: Final = (
    "M-4.5,0a4.5,4.5 0 1 0 9,0a4.5,4.5 0 1 0 -9,0z",
    "M-4,-4h8v8h-8z",
    "M0,-5.5l5.5,9.5h-11z",
    "M0,-5.5l5.5,5.5l-5.5,5.5l-5.5,-5.5z",
    "M-5.5,-4h11l-5.5,9.5z",
)

_TITLE: Final = 'font-size="16" font-weight="600"'

_TARGET_TICKS: Final = 7
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Series:
    """A named series of points in a chart.

    Parameters
    ----------
    name : str
        Name in the legend.
    points : tuple of (x, y)
        Points with x above 0.
    style : int
        Number of the colour and marker shape.
    joined : bool
        Whether a line connects the points.
    """

    name: str
    points: tuple[tuple[float, float], ...]
    style: int = 0
    joined: bool = True


def line_chart(
    title: str,
    x_label: str,
    y_label: str,
    series: Sequence[Series],
    *,
    x_text: Callable[[float], str] = lambda x: f"{x:g}",
    note: str = "",
) -> str:
    """Draw a line chart with a logarithmic x axis.

    Parameters
    ----------
    title, x_label, y_label : str
        Title of the chart, labels of the axes.
    series : sequence of Series
        Series, drawn in this order.
    x_text : callable
        Format a tick of the x axis, a power of two.
    note : str
        Line below the title; empty for none.

    Returns
    -------
    str
        An SVG document.
    """
    xs = [x for one in series for x, _ in one.points] or [1.0, 2.0]
    ys = [y for one in series for _, y in one.points] or [0.0, 1.0]
    low, high = math.floor(math.log2(min(xs)) * 2) / 2, math.ceil(math.log2(max(xs)) * 2) / 2
    high = max(high, low + 1)
    ticks = _ticks(min(ys), max(ys))
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def at(x: float, y: float) -> tuple[float, float]:
        across = (math.log2(x) - low) / (high - low)
        up = (y - ticks[0]) / (ticks[-1] - ticks[0])
        return _LEFT + across * width, _TOP + (1 - up) * height

    parts = [
        *_page(_WIDTH, _HEIGHT),
        _text(_LEFT, 22, title, "start", _TITLE),
        _text(_LEFT + width / 2, _HEIGHT - 12, x_label, "middle"),
        f'<text transform="translate(18 {_TOP + height / 2:.1f}) rotate(-90)" '
        f'text-anchor="middle">{_escaped(y_label)}</text>',
    ]
    for tick in ticks:
        _, y = at(2**low, tick)
        parts.append(_line(_LEFT, y, _LEFT + width, y, "#e3e3e3"))
        parts.append(_text(_LEFT - 8, y + 4, f"{tick:g}", "end"))
    for exponent in range(math.ceil(low), math.floor(high) + 1):
        x, _ = at(2.0**exponent, ticks[0])
        parts.append(_line(x, _TOP, x, _TOP + height, "#e3e3e3"))
        parts.append(_text(x, _TOP + height + 18, x_text(2.0**exponent), "middle"))
    parts.append(_line(_LEFT, _TOP + height, _LEFT + width, _TOP + height, "#888"))
    for index, one in enumerate(series):
        parts += _draw(one, at)
        parts += _legend(one, index)
    if note:
        parts.append(_text(_LEFT, 40, note, "start", 'fill="#666" font-size="11"'))
    return "\n".join([*parts, "</svg>", ""])


def bar_chart(title: str, bars: Sequence[tuple[str, float]], *, unit: str) -> str:
    """Draw a horizontal bar chart.

    Parameters
    ----------
    title : str
        Title of the chart.
    bars : sequence of (str, float)
        Name and value of each bar, from top to bottom.
    unit : str
        Unit shown after each value.

    Returns
    -------
    str
        An SVG document.
    """
    left, row = 250, 26
    width, height = _WIDTH - left - 90, _TOP + row * len(bars) + 16
    low = min([0.0, *(value for _, value in bars)])
    span = max([0.0, *(value for _, value in bars)]) - low or 1.0
    parts = [*_page(_WIDTH, height), _text(20, 26, title, "start", _TITLE)]
    zero = left + -low / span * width
    for index, (name, value) in enumerate(bars):
        y = _TOP + row * index
        end = left + (value - low) / span * width
        parts.append(_text(left - 10, y + 15, name, "end"))
        parts.append(
            f'<rect x="{min(zero, end):.1f}" y="{y + 3}" width="{max(abs(end - zero), 1):.1f}" '
            f'height="{row - 8}" fill="{_COLOURS[0] if value >= 0 else _COLOURS[1]}"/>'
        )
        parts.append(_text(max(zero, end) + 6, y + 15, f"{value:+.1f} {unit}", "start"))
    return "\n".join([*parts, "</svg>", ""])


def _page(width: int, height: int) -> list[str]:
    """Return the start of an SVG document with a white background."""
    return [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="system-ui, sans-serif" '
        'font-size="12" fill="#222">',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]


def _draw(one: Series, at: Callable[[float, float], tuple[float, float]]) -> list[str]:
    """Return the line and the markers of a series; `at` maps a point to pixels."""
    colour, shape = _style(one.style)
    pixels = [at(x, y) for x, y in one.points]
    parts: list[str] = []
    if one.joined and len(pixels) > 1:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)
        parts.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2" '
            'stroke-linejoin="round"/>'
        )
    for x, y in pixels:
        parts.append(_marker(x, y, shape, colour))
    return parts


def _legend(one: Series, index: int) -> list[str]:
    """Return the legend's entry of a series, at row `index` of the legend."""
    colour, shape = _style(one.style)
    x, y = _WIDTH - _RIGHT + 24, _TOP + 8 + 20 * index
    dash = _line(x - 9, y, x + 9, y, colour, 2) if one.joined else ""
    return [dash, _marker(x, y, shape, colour), _text(x + 16, y + 4, one.name, "start")]


def _style(number: int) -> tuple[str, str]:
    """Return the colour of a series style and the SVG path of its marker, by number."""
    return _COLOURS[number % len(_COLOURS)], _SHAPES[number % len(_SHAPES)]


def _ticks(low: float, high: float) -> list[float]:
    """Return tick values: round numbers from below `low` to above `high`."""
    span = max(high - low, 1e-3)
    unit = 10 ** math.floor(math.log10(span / _TARGET_TICKS))
    step = next(s * unit for s in _STEPS if s * unit * _TARGET_TICKS >= span)
    first, last = math.floor(low / step), math.ceil(high / step)
    return [k * step for k in range(first, max(last, first + 1) + 1)]


def _marker(x: float, y: float, shape: str, colour: str) -> str:
    """Return a marker at a pixel."""
    return (
        f'<path d="{shape}" transform="translate({x:.1f} {y:.1f})" fill="{colour}" '
        'stroke="#fff" stroke-width="1"/>'
    )


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: int = 1) -> str:
    """Return a line between two pixels."""
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
        f'stroke-width="{width}"/>'
    )


def _escaped(text: str) -> str:
    """Escape text for XML."""
    # File names may contain control characters and lone surrogates, which XML and UTF-8 forbid.
    return escape(printable(text))


def _text(x: float, y: float, text: str, anchor: str, extra: str = "") -> str:
    """Return a line of text at a pixel."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {extra}>{_escaped(text)}</text>'
