"""Payloads of one chunk: head, refinement and tail (SPEC 7)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import records


@dataclass(frozen=True)
class Payloads:
    """Encoded segments of one chunk, and the codebooks that they need.

    Parameters
    ----------
    head : bytes
        Payload of the head.
    tail : bytes or None
        None for a scene without SH above DC.
    head_needs, tail_needs : tuple of int
        Numbers of the codebooks that head and tail need.
    order : (n,) int64
        Input row of each stored row.
    refinement : bytes or None
        Refinement of the head's values; None if the head is fine already.
    refinement_drop : float
        Squared error of rendered images that the refinement removes.
    """

    head: bytes
    tail: bytes | None
    head_needs: tuple[int, ...]
    tail_needs: tuple[int, ...]
    order: NDArray[np.int64] = field(compare=False)
    refinement: bytes | None = None
    refinement_drop: float = 0.0

    def compress(self, *, digits: bool = True) -> Payloads:
        """Return the payloads with compressed planes; the planes must be uncompressed.

        Parameters
        ----------
        digits : bool
            Whether to pack several symbols per byte, as digits of a number, where this is smaller.
        """

        def compress_optional(plain: bytes | None) -> bytes | None:
            return None if plain is None else records.compress_payload(plain, digits=digits)

        head = records.compress_payload(self.head, digits=digits)
        tail, refinement = compress_optional(self.tail), compress_optional(self.refinement)
        return replace(self, head=head, tail=tail, refinement=refinement)
