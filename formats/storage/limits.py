"""What reading a file of unknown origin may cost, and the refusals where it would cost more."""

from __future__ import annotations

from dataclasses import dataclass

from cogsplat.codec.errors import LimitError
from cogsplat.codec.splats import sh_coefficients

# Means, scales, quaternions, opacity and sh0 of one splat, float32.
_ROW_BYTES = 4 * (3 + 3 + 4 + 1 + 3)

# What any COGS file may decode to, whatever its size (SPEC 9.2).
_COGS_SMALL_BYTES = 64 << 20


@dataclass(frozen=True)
class Limits:
    """What a reader allocates and returns at most for a file that it does not trust (SPEC 9.2).

    Parameters
    ----------
    decoded_bytes : int
        Bytes of the decoded arrays, extra attributes among them, and of what is unpacked on the
        way to them; of a COGS file also its codebooks, its codes of compensation, its view table
        and its cameras.
    expansion : int
        Those bytes per byte of a COGS file, above 64 MiB. A splat of SH degree 3 takes 236 bytes:
        the default admits every scene of a byte a splat or more.
    foreign_expansion : int
        Those bytes per byte of a scene in another format, where they are more than `small_bytes`.
        Trained scenes reach about 20 (SOG and SPZ at SH degree 3).
    small_bytes : int
        Bytes that a file of any size may take: arrays that are smaller are not held against
        `foreign_expansion`, and what parsed JSON takes may be no more.
    splats : int
        Splats of one scene.
    cameras : int
        Cameras of one file, and images of one COLMAP model.

    Examples
    --------
    >>> limits = Limits(splats=1000)
    >>> limits.allowed(1_000_000)
    323108864
    >>> limits.require_scene(1001, sh_degree=0, source_bytes=1 << 20, where="a.spz")
    Traceback (most recent call last):
    ...
    cogsplat.codec.errors.LimitError: a.spz: 1001 splats, expected at most 1000 (limit splats)
    """

    decoded_bytes: int = 1 << 35
    expansion: int = 256
    foreign_expansion: int = 64
    small_bytes: int = 48 << 20
    splats: int = 1 << 29
    cameras: int = 100_000

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"limit {name} of {value}, expected 0 or more")

    def allowed(self, source_bytes: int) -> int:
        """Return the bytes that may be decoded from a COGS file of so many (SPEC 9.2)."""
        return min(self.decoded_bytes, _COGS_SMALL_BYTES + self.expansion * source_bytes)

    def require_scene(
        self,
        splats: int,
        *,
        sh_degree: int,
        source_bytes: int,
        where: str,
        beside_bytes: int = 0,
        copies: int = 1,
    ) -> None:
        """Refuse a foreign scene that takes more than its file may cost, before it is allocated.

        Parameters
        ----------
        splats : int
            Splats that the file counts.
        sh_degree : int
            Highest SH degree of the arrays to be allocated.
        source_bytes : int
            Bytes of the file, and of files that it names.
        where : str
            Name of the file for messages.
        beside_bytes : int
            Bytes of extra attributes, and of what is unpacked on the way and held beside the
            arrays.
        copies : int
            How many times the arrays exist at once while the scene is put together.

        Raises
        ------
        LimitError
            ``too-many-splats``; ``decoded-size``.
        """
        self.require_splats(splats, where)
        row_bytes = _ROW_BYTES + 12 * (sh_coefficients(sh_degree) - 1)
        needed = copies * splats * row_bytes + beside_bytes
        self.require_memory(needed, source_bytes, f"{where}: {splats} splats")

    def require_splats(self, count: int, where: str) -> None:
        """Refuse more splats than may be read from one file.

        Raises
        ------
        LimitError
            ``too-many-splats``.
        """
        if count > self.splats:
            raise LimitError(
                "too-many-splats",
                f"{where}: {count} splats, expected at most {self.splats} (limit splats)",
            )

    def require_memory(self, needed: int, source_bytes: int, what: str) -> None:
        """Refuse to unpack a foreign file into more bytes than it may cost.

        Parameters
        ----------
        needed : int
            Bytes about to be allocated for the file, all together.
        source_bytes : int
            Bytes of the file, and of files that it names.
        what : str
            Name of the file and what takes the bytes, for messages.

        Raises
        ------
        LimitError
            ``decoded-size``.
        """
        allowed = min(
            self.decoded_bytes, max(self.small_bytes, self.foreign_expansion * source_bytes)
        )
        if needed > allowed:
            raise LimitError(
                "decoded-size",
                f"{what} take {needed} bytes of memory, expected at most {allowed} from "
                f"{source_bytes} bytes (limits memory and expansion)",
            )

    def require_cameras(self, count: int, where: str) -> None:
        """Refuse more cameras than may be read from one file.

        Raises
        ------
        LimitError
            ``too-many-cameras``.
        """
        if count > self.cameras:
            raise LimitError(
                "too-many-cameras",
                f"{where}: {count} cameras or images, expected at most {self.cameras} "
                "(limit cameras)",
            )
