"""Decode an encoded scene from its payloads alone, without a container."""

from cogsplat.codec.segments import codebooks as segments_codebooks
from cogsplat.codec.segments import heads, tails
from cogsplat.codec.splats import Splats, empty


def books(encoded):
    """Codebooks by number, as the segments would give them."""
    degree = encoded.scene.sh_degree
    out = {}
    for number, book in enumerate(encoded.codebooks):
        payloads = [memoryview(payload) for payload in book.payloads]
        if book.attribute == "shape":
            out[number] = segments_codebooks.decode_shape_codebook(payloads[0], book.rows, "shape")
        else:
            bands = dict(enumerate(payloads, start=1))
            out[number] = segments_codebooks.decode_colour_codebook(
                bands, book.rows, degree, "colour"
            )
    return out


def chunk(payloads, rows, degree, codebooks=None, *, refine=True) -> Splats:
    """Rows of one chunk from the codebooks it says it needs."""
    given = codebooks or {}
    out = empty(degree, rows)
    needed = {number: given[number] for number in payloads.head_needs}
    finer = payloads.refinement if refine else None
    finer = None if finer is None else memoryview(finer)
    heads.decode_head(memoryview(payloads.head), needed, out, "head", finer)
    if payloads.tail is not None:
        needed = {number: given[number] for number in payloads.tail_needs}
        tails.decode_tail(memoryview(payloads.tail), needed, out.shN, "tail")
    return out


def chunks(encoded, *, refine=True) -> list[Splats]:
    """Rows of every chunk."""
    codebooks, degree = books(encoded), encoded.scene.sh_degree
    return [
        chunk(part.payloads, part.splats, degree, codebooks, refine=refine)
        for part in encoded.chunks
    ]
