"""Memory and size limits for reading untrusted files."""

from __future__ import annotations

from dataclasses import dataclass

from cogsplat.codec.errors import LimitError
from cogsplat.codec.splats import sh_coefficients

# Bytes of the means, scales, quaternion, opacity and sh0 of one splat, float32.
_ROW_BYTES = 4 * (3 + 3 + 4 + 1 + 3)

# Decoded size that a COGS file of any size may reach (SPEC 9.2).
_COGS_SMALL_BYTES = 64 << 20


@dataclass(frozen=True)
class Limits:
    """Limits on the memory and content of untrusted files (SPEC 9.2).

    Parameters
    ----------
    decoded_bytes : int
        Maximum decoded size: bytes of arrays, extra attributes and intermediate data. For a COGS
        file, codebooks, compensation codes, view table and cameras count as well.
    expansion : int
        Maximum number of decoded bytes per byte of a COGS file, in addition to 64 MiB. A splat of
        SH degree 3 takes 236 bytes, so the default admits scenes of one byte per splat.
    foreign_expansion : int
        Maximum ratio of decoded size to file size for other formats; it applies to decoded sizes
        above `small_bytes`. Trained scenes reach about 20 (SOG and SPZ at SH degree 3).
    small_bytes : int
        Decoded size that a file of another format may reach at any length, bytes; also the memory
        limit of parsed JSON.
    splats : int
        Maximum number of splats of a scene.
    cameras : int
        Maximum number of cameras of a file, and of images of a COLMAP model.

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
        """Return the maximum decoded size of a COGS file of `source_bytes`, bytes (SPEC 9.2)."""
        return min(self.decoded_bytes, _COGS_SMALL_BYTES + self.expansion * source_bytes)

    def require_scene(
        self,
        splats: int,
        *,
        sh_degree: int,
        source_bytes: int,
        where: str,
        extra_bytes: int = 0,
        copies: int = 1,
    ) -> None:
        """Refuse a scene of another format above the limits, before its arrays are allocated.

        Parameters
        ----------
        splats : int
            Number of splats according to the file.
        sh_degree : int
            Highest SH degree of the arrays.
        source_bytes : int
            Length of the file and of the files that it refers to, bytes.
        where : str
            Name of the file for messages.
        extra_bytes : int
            Memory of extra attributes and intermediate data, bytes.
        copies : int
            Number of copies of the arrays that exist at once.

        Raises
        ------
        LimitError
            ``too-many-splats``; ``decoded-size``.
        """
        self.require_splats(splats, where)
        row_bytes = _ROW_BYTES + 12 * (sh_coefficients(sh_degree) - 1)
        needed = copies * splats * row_bytes + extra_bytes
        self.require_memory(needed, source_bytes, f"{where}: {splats} splats")

    def require_splats(self, count: int, where: str) -> None:
        """Refuse a splat count above the limit.

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
        """Refuse a memory demand above the limits for a file of another format.

        Parameters
        ----------
        needed : int
            Memory to be allocated in total, bytes.
        source_bytes : int
            Length of the file and of the files that it refers to, bytes.
        what : str
            Name of the file and of the data, for messages.

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
                f"{what} take {needed} bytes of memory, expected at most {allowed} for a file of "
                f"{source_bytes} bytes (limits memory and expansion)",
            )

    def require_cameras(self, count: int, where: str) -> None:
        """Refuse a camera count above the limit.

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
