"""Summary of a scene's description for the terminal."""

from __future__ import annotations

from typing import Final

from cogsplat.formats.cogs.description import Description, Picture
from cogsplat.tools.terminal.output import count_text

# Longest text in a summary, characters.
_SHOWN: Final = 100


def description_facts(description: Description) -> list[tuple[str, str]]:
    """Return labels and texts of a description for `print_facts`; texts are empty where unset."""
    path, reference = description.path, description.georeference
    colour = description.background
    scale = description.metres_per_unit
    return [
        ("title", description.title or ""),
        ("text", _shown(description.text or "")),
        ("licence", description.licence or ""),
        ("credits", _shown(description.credits or "")),
        ("date", description.date or ""),
        ("scale", "" if scale is None else f"{scale:g} m for a unit of the scene"),
        ("unit", description.unit or ""),
        ("background", "" if colour is None else _hexadecimal(colour)),
        ("views", _names([view.name for view in description.views])),
        (
            "path",
            ""
            if path is None
            else f"{count_text(len(path.stops), 'stop')} in {path.stops[-1].time:g} s"
            + (", over and over" if path.loop else ""),
        ),
        ("annotations", _names([one.title for one in description.annotations])),
        ("location", "" if reference is None else _shown(reference.crs)),
        ("poster", _picture(description.poster)),
        ("sky", _picture(description.sky)),
    ]


def _shown(text: str) -> str:
    """Return a text on one line, cut to the length of a summary."""
    line = " ".join(text.split())
    return line if len(line) <= _SHOWN else f"{line[: _SHOWN - 1]}…"


def _names(names: list[str]) -> str:
    """Return a count and the names as text; empty for none."""
    return _shown(f"{len(names)}: {', '.join(names)}") if names else ""


def _hexadecimal(colour: tuple[float, float, float]) -> str:
    """Return a colour such as ``#ff8000``."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)


def _picture(picture: Picture | None) -> str:
    """Return type and size of a picture as text; empty for none."""
    if picture is None:
        return ""
    return f"{picture.width}x{picture.height} px, {picture.media_type.removeprefix('image/')}"
