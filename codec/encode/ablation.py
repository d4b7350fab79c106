"""What an encoder does without, so that what each technique buys can be measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Ablation:
    """Techniques of the `transform` profile, each of which can be switched off.

    Files of any combination are valid and decode as all others do; only their size and their
    quality differ. The other profiles use none of these.

    Parameters
    ----------
    sensitivities : bool
        What errors of positions, shapes and opacities cost, from the scoring pass; otherwise
        guessed from each splat's energy alone.
    chunk_steps : bool
        Steps by what errors cost in the chunk; otherwise one step of each attribute for all.
    fine_means : bool
        Means as fine as each splat is small; otherwise one step a chunk.
    fine_turns : bool
        Rotations as fine as each shape asks; otherwise one step a chunk.
    areas : bool
        Longest axis and opacity make up for areas that coarse scales change.
    colour_basis : bool
        shN by its principal axes; otherwise by its own coefficients.
    view_metric : bool
        Errors of shN weighed by the directions it is seen from; otherwise all directions alike.
    sh0_makes_up : bool
        sh0 makes up for what shN loses, as its views see it on average.
    digits : bool
        Planes of few symbols put several into a byte before zstd.
    """

    sensitivities: bool = True
    chunk_steps: bool = True
    fine_means: bool = True
    fine_turns: bool = True
    areas: bool = True
    colour_basis: bool = True
    view_metric: bool = True
    sh0_makes_up: bool = True
    digits: bool = True
