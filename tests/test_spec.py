"""SPEC against the code: clauses, layouts, tables of numbers, limits, and every reason code."""

import ast
import json
import re
import struct
from collections import defaultdict
from fractions import Fraction
from pathlib import Path

import pytest

from cogsplat.codec.segments import view_shares
from cogsplat.codec.splats import MAX_EXTRA_COMPONENTS, MAX_EXTRAS, MAX_SH_DEGREE
from cogsplat.codec.streams import (
    adaptive_step,
    byte_planes,
    grid,
    payload_limits,
    records,
    refinement_bits,
    shn_transform,
    sorted_means,
)
from cogsplat.codec.streams.kinds import KINDS
from cogsplat.formats.cogs import (
    camera_segment,
    canonical_msgpack,
    chunk_decoder,
    decoded_rows,
    description_segment,
    folder_map,
    index_tables,
    layout,
)
from cogsplat.formats.storage.limits import Limits
from cogsplat.tools.lab import make_vectors
from cogsplat.tools.lab.conformance import tolerance, valid

ROOT = Path(__file__).resolve().parents[1]
SPEC = (ROOT / "SPEC.md").read_text(encoding="utf-8")
MANIFEST = json.loads((ROOT / "tests" / "vectors" / "manifest.json").read_text(encoding="utf-8"))

# Every module between the bytes of a file and its rows: whatever else raises a reason code.
READING = sorted(
    {
        *(ROOT / "formats" / "cogs").rglob("*.py"),
        ROOT / "formats" / "storage" / "source.py",
        *(path for path in (ROOT / "codec").rglob("*.py") if "clause=" in path.read_text("utf-8")),
        *(path for path in (ROOT / "codec").rglob("*.py") if "(SPEC " in path.read_text("utf-8")),
    }
)
CLASSES = {
    "FormatError": "format",
    "TruncatedError": "truncated",
    "UnsupportedError": "unsupported",
    "LimitError": "limit",
}
CODE = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)+")
CITED = re.compile(r"SPEC (\d+(?:\.\d+)?)")


def section(heading):
    """The text from a heading to the next one of its level or above."""
    start = re.search(rf"^(#+) {re.escape(heading)}.*$", SPEC, re.MULTILINE)
    assert start, heading
    rest = SPEC[start.end() :]
    end = re.search(rf"^#{{1,{len(start[1])}}} ", rest, re.MULTILINE)
    return rest[: end.start()] if end else rest


def tables(text):
    """Every table as a list of rows of cells, the header left out."""
    found, rows = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip().strip("`") for cell in line.strip("|").split("|")])
        elif rows:
            found.append(rows[2:])
            rows = []
    return found


def number(text):
    return int(text.replace(",", ""))


def registry():
    """Reason code to its class and clauses, from section 12."""
    (rows,) = tables(section("12 "))
    found = {code: (kind, set(clauses.split(", "))) for code, kind, clauses, _ in rows}
    assert len(found) == len(rows)
    return found


def raised(paths):
    """Reason codes that modules raise: by code, its classes and the SPEC clauses cited with it."""
    classes, clauses = defaultdict(set), defaultdict(set)
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = (
                node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            )
            texts = [a.value for a in node.args if isinstance(a, ast.Constant)]
            codes = [t for t in texts if isinstance(t, str) and CODE.fullmatch(t)]
            if not codes:
                continue
            if name in CLASSES:
                classes[codes[0]].add(CLASSES[name])
                stated = [k.value.value for k in node.keywords
                          if k.arg == "clause" and isinstance(k.value, ast.Constant)]  # fmt: skip
                clauses[codes[0]] |= set(stated) | set(CITED.findall(ast.unparse(node)))
            elif name in ("error", "refuse"):
                classes[codes[0]].add("format")
    return classes, clauses


def test_every_clause_the_code_cites_is_a_heading():
    headings = set(re.findall(r"^#{2,4} (\d+(?:\.\d+)?) ", SPEC, re.MULTILINE))
    cited = set()
    for package in ("codec", "formats", "tools"):
        for path in (ROOT / package).rglob("*.py"):
            cited |= set(CITED.findall(path.read_text(encoding="utf-8")))
    assert len(cited) > 20
    assert cited - headings == set()


def test_clauses_in_the_text_exist():
    headings = set(re.findall(r"^#{2,4} (\d+(?:\.\d+)?) ", SPEC, re.MULTILINE))
    body = re.sub(r"```.*?```", "", SPEC.split("## Appendix A")[0], flags=re.DOTALL)
    cited = re.findall(r"(?<![\d.,×−-])\(?(?:as |clause |section )?(\d\.\d{1,2})(?![\d.])", body)
    # No section has the number 0: such numbers are quantities and versions before 1.0.
    quantities = {c for c in cited if c.startswith("0.")} | {"1.0", "1.5", "3.33"}
    strange = {c for c in cited if c not in headings} - quantities
    assert strange == set()


def test_clauses_stand_in_order():
    found = re.findall(r"^#{2,4} (\d+)(?:\.(\d+))? ", SPEC, re.MULTILINE)
    numbers = [(int(a), int(b or 0)) for a, b in found]
    assert numbers == sorted(set(numbers))


LAYOUT = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "f32": "f"}


def layout_of(rows):
    """Offsets and the struct format of a table of fields, as far as its offsets are numbers."""
    text, offsets = "<", []
    for offset, size, kind, *_ in rows:
        if not offset.isdigit():
            break
        assert int(offset) == struct.calcsize(text)
        offsets.append(int(offset))
        count = f"{size}s" if kind == "bytes" else LAYOUT[kind]
        if size.isdigit():
            text += count
    return text, offsets


def test_preamble_is_as_the_code_packs_it():
    (rows,) = tables(section("3.1 "))
    text, _ = layout_of(rows)
    assert struct.calcsize(text) == layout.PREAMBLE_BYTES == 64
    preamble = layout.Preamble(0, 1, 0x1234, 0x56789A, 0xBCDEF012)
    fields = dict(
        zip(
            [row[3] for row in rows],
            struct.unpack(text, layout.pack_preamble(preamble)),
            strict=True,
        )
    )
    assert fields["magic"] == layout.MAGIC == bytes.fromhex(rows[0][4].replace(" ", ""))
    stated = ("major", "minor", "root_length", "file_length", "root_crc")
    assert [fields[name] for name in stated] == [0, 1, 0x1234, 0x56789A, 0xBCDEF012]
    assert fields["reserved"] == bytes(32)


def test_record_is_as_the_code_packs_it():
    text, offsets = layout_of(tables(section("6.2 "))[0])
    assert struct.calcsize(text) == records.RECORD.size == 12
    assert offsets == [0, 1, 2, 3, 4, 8, 10, 12]
    assert struct.Struct(text).format == records.RECORD.format


@pytest.mark.parametrize(
    ("clause", "expected"),
    [("6.4 ", grid._ENTRY.format), ("6.14 ", shn_transform.PARAMS.format)],
)
def test_parameters_are_as_the_code_packs_them(clause, expected):
    text, _ = layout_of(tables(section(clause))[0])
    assert text.rstrip("B") == expected.rstrip("B")


def test_numbers_of_attributes_kinds_and_flags():
    _, attributes, kinds, flags = tables(section("6.2 "))
    names = {a: a.name.lower() for a in records.Attribute}
    assert {int(row[0]) for row in attributes} == {int(a) for a in records.Attribute}
    for row in attributes:
        attribute = records.Attribute(int(row[0]))
        assert row[1].split(",")[0].replace(" ", "_").lower() == names[attribute]
        assert int(row[2].split(",")[0]) == records.COMPONENTS[attribute]
        codecs = KINDS[attribute]
        stored = {*codecs, *(c.refined_by for c in codecs.values() if c.refined_by is not None)}
        assert set(row[3].split(", ")) == {k.name.lower() for k in stored}
    assert {int(n): name for n, name, _ in kinds} == {int(k): k.name.lower() for k in records.Kind}
    assert {int(n): name for n, name, _ in flags} == {
        records.ESCAPE: "escape",
        records.INFINITIES: "infinities",
    }


def test_numbers_of_segment_kinds():
    (rows,) = tables(section("5.2 "))
    known = {int(row[0]): row[1] for row in rows if row[0].isdigit()}
    words = {"head": "HEAD", "tail": "TAIL", "shape codebook": "SHAPE_CODEBOOK"}
    words |= {"refinement": "REFINEMENT", "opacities": "OPACITIES"}
    words |= {"cameras": "CAMERAS", "attributes": "ATTRIBUTES"}
    words |= {"compensation": "COMPENSATION", "view table": "VIEW_TABLE"}
    words |= {"description": "DESCRIPTION", "picture": "PICTURE"}
    words |= {f"colour codebook, band {b}": f"COLOUR_BAND{b}" for b in (1, 2, 3)}
    assert {n: words[name] for n, name in known.items()} == {
        int(k): k.name for k in layout.SegmentKind
    }
    assert rows[-1][0] == f"{layout.SKIPPABLE_KIND}–255"


def test_keys_are_those_the_code_writes():
    def keys(clause):
        return [
            name.strip("` ") for row in tables(section(clause))[0] for name in row[0].split(", ")
        ]

    types = {"u1": "u8", "<u4": "u32", "<u8": "u64", "<f4": "f32", "<f8": "f64"}
    for clause, table in (
        ("5.3 ", index_tables.SegmentTable),
        ("5.4 ", index_tables.ChunkTable),
        ("5.6 ", index_tables.PageTable),
    ):
        stated = {row[0].strip("`"): tuple(row[1:3]) for row in tables(section(clause))[0]}
        assert list(stated) == list(table.COLUMNS)
        for name, column in table.COLUMNS.items():
            rows = f"{column.width} " if column.width > 1 else ""
            assert stated[name][0] == rows + types[column.dtype]
            assert stated[name][1].startswith("optional") == column.is_optional
    source = (ROOT / "formats" / "cogs" / "root.py").read_text(encoding="utf-8")
    for clause in ("4.2 ", "4.4 ", "5.5 ", "5.7 ", "5.11 "):
        assert [key for key in keys(clause) if f'"{key}"' not in source] == []
    source = (ROOT / "formats" / "cogs" / "camera_segment.py").read_text(encoding="utf-8")
    assert [key for key in keys("5.8 ") if f'"{key}"' not in source] == []
    source = (ROOT / "formats" / "cogs" / "description_segment.py").read_text(encoding="utf-8")
    source += (ROOT / "formats" / "cogs" / "root.py").read_text(encoding="utf-8")
    assert [key for key in keys("5.13 ") + keys("5.14 ") if f'"{key}"' not in source] == []
    source = (ROOT / "formats" / "cogs" / "compensation_segment.py").read_text(encoding="utf-8")
    assert [key for key in keys("5.9 ") if f'"{key}"' not in source] == []


def test_limits_are_the_constants():
    (rows,) = tables(section("9.1 "))
    assert {what: number(most) for what, most, _ in rows} == {
        "end of the root, bytes": layout.MAX_ROOT_END,
        "file, bytes": layout.MAX_FILE_BYTES,
        "manifest of a folder, bytes": folder_map.MAX_MANIFEST_BYTES,
        "splats of a file": layout.MAX_SPLATS,
        "splats of a chunk": payload_limits.MAX_CHUNK_SPLATS,
        "segments of a file": layout.MAX_SEGMENTS,
        "pages that an index lists": layout.MAX_PAGES,
        "pages on the way from the root to a chunk": layout.MAX_PAGE_DEPTH,
        "bytes of a page": layout.MAX_PAGE_BYTES,
        "attributes": MAX_EXTRAS,
        "components of an attribute": MAX_EXTRA_COMPONENTS,
        "cameras": layout.MAX_CAMERAS,
        "levels of a scene": layout.MAX_LEVELS,
        "viewpoints of a view table": view_shares.MAX_VIEWS,
        "bytes of a description": layout.MAX_DESCRIPTION_BYTES,
        "bytes of a picture": layout.MAX_PICTURE_BYTES,
        "width and height of a picture, px": description_segment.MAX_PICTURE_SIDE,
        "views, and annotations, of a description": description_segment.MAX_VIEWS,
        "stops of a path": description_segment.MAX_STOPS,
        "nesting of values in root and pages": canonical_msgpack.MAX_DEPTH,
        "values of a msgpack map": canonical_msgpack.MAX_VALUES,
        "values of a map of cameras, and of a description": layout.MAX_CAMERA_VALUES,
        "codebooks": layout.MAX_CODEBOOKS,
        "rows of a codebook": payload_limits.MAX_CODEBOOK_ROWS,
        "streams of a payload": payload_limits.MAX_STREAMS,
        "radix of a packed plane": max(byte_planes.DIGITS),
        "bytes of a decoded plane": payload_limits.MAX_PLANE_BYTES,
        "zstd window, bytes": payload_limits.MAX_WINDOW_BYTES,
        "levels of a grid": grid.MAX_LEVELS,
        "levels of the cells of sorted means": sorted_means.MAX_CELLS,
        "coordinates of a basis stream": shn_transform.MAX_BASIS_ROWS,
        "extra bits of a row": adaptive_step.MAX_EXTRA_BITS,
        "bits of a refinement, an axis": refinement_bits.MAX_BITS,
        "SH degree": MAX_SH_DEGREE,
    }


def test_limits_name_known_codes():
    codes = {code for _, _, code in tables(section("9.1 "))[0]}
    assert codes - {""} <= registry().keys()


def test_tolerances_are_the_constants():
    ((means, *others),) = tables(section("8.6 "))
    assert "2^−10" in means[1]
    assert tolerance.MEANS_RELATIVE == 2**-10
    assert "⅛" in means[1]
    assert tolerance.MEANS_SIGMAS == 1 / 8
    stated = [float(Fraction(re.search(r"\d[\d./]*", limit)[0])) for _, limit, _ in others]
    assert [name for name, *_ in others] == ["scales", "quats", "opacities", "sh0", "shN"]
    assert stated == [
        tolerance.SCALES,
        tolerance.QUAT_ANGLE,
        tolerance.OPACITY_UNIT,
        tolerance.SH0,
        tolerance.SHN,
    ]


def test_tolerances_of_pictures_are_the_constants():
    text = section("B.4 ")
    assert "within 2^−10" in text
    assert tolerance.PICTURE_VALUE == 2**-10
    assert "at most 1/80" in text
    assert tolerance.PICTURE_RMS == 1 / 80


def test_decoded_bytes_are_counted_as_stated():
    text = section("9.2 ")
    assert f"{Limits().expansion} bytes more for each byte" in text
    assert f"{Limits().allowed(0) >> 20} MiB" in text
    for number in (
        decoded_rows._HEAD_ROW_BYTES,
        decoded_rows.SCRATCH_ROW_BYTES,
        decoded_rows._SCRATCH_COORDINATE_BYTES,
        chunk_decoder._COMPENSATION_ROW_BYTES,
        canonical_msgpack.VALUE_BYTES,
    ):
        assert re.search(rf"(?<![\d,]){number}(?![\d,])", text), number
    assert f"{camera_segment._CAMERA_BYTES:,} bytes each" in text


def test_version_is_the_code_s():
    assert f"Version {layout.MAJOR}.{layout.MINOR}," in SPEC
    assert MANIFEST["format"] == f"{layout.MAJOR}.{layout.MINOR}"


def test_reason_codes_are_those_the_code_raises():
    classes, clauses = raised(READING)
    listed = registry()
    # What writers and callers meet is no verdict on a file.
    reading = {code: kinds for code, kinds in classes.items() if kinds & set(CLASSES.values())}
    assert len(reading) > 50
    assert reading.keys() == listed.keys()
    for code, kinds in reading.items():
        assert kinds == {listed[code][0]}, code
        assert {c for c in clauses[code] if "." in c} <= listed[code][1], code


def test_reason_codes_have_files():
    broken = defaultdict(set)
    for entry in [*MANIFEST["invalid"], *MANIFEST["invalid_folders"]]:
        broken[entry["code"]].add(entry["clause"])
    listed = registry()
    # No file breaks this rule: it is about a file that changes.
    assert listed.keys() - broken.keys() == {"source-changed"}
    for code, clauses in broken.items():
        assert clauses <= listed[code][1], code


def test_clauses_of_a_reason_code_name_it():
    for code, (_, clauses) in registry().items():
        for clause in clauses:
            chapter = clause.split(".")[0]
            # The codes of 4.2 serve all maps of sections 4 and 5.
            named = section(f"{clause} ") + section("4.2 " if chapter == "5" else f"{chapter} ")
            assert f"`{code}`" in named, (code, clause)


def test_dump_and_lists_come_from_the_files():
    assert make_vectors.replace_blocks(SPEC, make_vectors.spec_blocks()) == SPEC
    smallest = (ROOT / "tests" / "vectors" / "valid" / f"{valid.SMALLEST}.cogs").read_bytes()
    lines = section("Appendix A").split("```text\n")[1].split("```")[0].splitlines()
    shown = b"".join(bytes.fromhex(line[7:54]) for line in lines)
    assert shown == smallest


def test_links_to_nowhere_are_not_there():
    assert "](" not in SPEC
