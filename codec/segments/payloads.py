"""The payloads of one chunk: head, refinement and tail (SPEC 7)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import records


@dataclass(frozen=True)
class Payloads:
    """The encoded segments of one chunk and the codebooks they need.

    Parameters
    ----------
    head : bytes
    tail : bytes or None
        None where the scene has no SH above DC.
    head_needs, tail_needs : tuple of int
    order : (n,) int64
        Which of the chunk's rows, as it was given, stands in each place as it is stored.
    refinement : bytes or None
        What makes the head's values fine; None where they are.
    refinement_drop : float
        Squared error of the picture that it removes.
    """

    head: bytes
    tail: bytes | None
    head_needs: tuple[int, ...]
    tail_needs: tuple[int, ...]
    order: NDArray[np.int64] = field(compare=False)
    refinement: bytes | None = None
    refinement_drop: float = 0.0

    def compressed(self, *, digits: bool = True) -> Payloads:
        """Return the same with compressed planes, where these are stored as they are.

        Parameters
        ----------
        digits : bool
            As `records.pack` takes it.
        """

        def of(plain: bytes | None) -> bytes | None:
            return None if plain is None else records.compress_payload(plain, digits=digits)

        head = records.compress_payload(self.head, digits=digits)
        return replace(self, head=head, tail=of(self.tail), refinement=of(self.refinement))
