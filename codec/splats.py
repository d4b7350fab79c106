"""Scenes of splats as arrays: validation, selection and concatenation of rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .capture import Capture
from .errors import DataError
from .trained_arrays import TRAINED_NAMES, as_floats, log_scales, logits, wxyz

F32 = NDArray[np.float32]

MAX_SH_DEGREE = 3

Extra = NDArray[np.number]

EXTRA_DTYPES: Final = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")
"""Types of extra attributes, in numpy's notation without byte order."""

MAX_EXTRAS: Final = 256
MAX_EXTRA_NAME_BYTES: Final = 255
MAX_EXTRA_COMPONENTS: Final = 16


# Rows checked at once, which bounds temporary arrays.
_BLOCK: Final = 1 << 16


def sh_coefficients(degree: int) -> int:
    """Return K, the number of SH coefficients per channel at `degree`, DC included."""
    return (degree + 1) ** 2


@dataclass(frozen=True)
class SceneInfo:
    """Metadata of a scene: frame, colour space and anti-aliasing.

    Parameters
    ----------
    origin : tuple of float
        World position of the zero of the means, scene units, float64.
    axes : str
        Directions of +x, +y, +z: R right / L left, U up / D down, F front / B back.
        3DGS training writes ``"RDF"``.
    colour_space : str
        Space of the rendered colour, ``"srgb"`` (display-referred) or ``"linear"``.
    kernel_px : float
        Variance that the renderer adds to projected covariances, px²: 0.3 in 3DGS, 0.1 in
        Mip-Splatting.
    antialiased : bool
        Whether opacities are rescaled by the area that the kernel adds (Mip-Splatting, section
        4.2).
    capture : Capture
        Viewpoints of the training pictures, by which splats keep their trained thickness in
        pictures of any size; none where they are not known, and of anti-aliased scenes.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: str = "RDF"
    colour_space: str = "srgb"
    kernel_px: float = 0.3
    antialiased: bool = False
    capture: Capture = ()


@dataclass(frozen=True, eq=False)
class Splats:
    """N splats as C-ordered float32 arrays.

    Parameters
    ----------
    means : (N, 3) float32
        Centres, scene units.
    scales : (N, 3) float32
        Natural logarithm of the standard deviations.
    quats : (N, 4) float32
        Rotations, wxyz, any non-zero norm.
    opacities : (N,) float32
        Opacity logits; ±inf is legal.
    sh0 : (N, 3) float32
        DC coefficient per channel.
    shN : (N, K-1, 3) float32
        Higher SH coefficients, K = (degree + 1)².
    info : SceneInfo
        Frame, colour space and anti-aliasing of the scene.
    extras : mapping of str to (N,) or (N, c) array
        Attributes of the splats that are not drawn, such as labels and normals, of `EXTRA_DTYPES`.
        At most `MAX_EXTRAS`, c from 1 to `MAX_EXTRA_COMPONENTS`, names of 1 to
        `MAX_EXTRA_NAME_BYTES` bytes in UTF-8.

    Raises
    ------
    DataError
        ``bad-shape`` or ``bad-dtype``: an array has the wrong shape or type; ``bad-extra``: too
        many extras, or an invalid name.

    Notes
    -----
    Construction checks shapes and types and copies only arrays that are not C-ordered.
    `invalid_rows` finds rows whose values cannot be drawn.
    """

    means: F32
    scales: F32
    quats: F32
    opacities: F32
    sh0: F32
    shN: F32  # noqa: N815 - the field's name
    info: SceneInfo = field(default_factory=SceneInfo)
    extras: Mapping[str, Extra] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _require_array("means", self.means)
        _require_array("shN", self.shN)
        n = len(self.means)
        expected: dict[str, tuple[int, ...]] = {
            "means": (n, 3),
            "scales": (n, 3),
            "quats": (n, 4),
            "opacities": (n,),
            "sh0": (n, 3),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            _require_array(name, array)
            if array.shape != shape:
                raise DataError("bad-shape", f"{name} has shape {array.shape}, expected {shape}")
        rest = self.shN.shape
        legal = [sh_coefficients(d) - 1 for d in range(MAX_SH_DEGREE + 1)]
        if len(rest) != 3 or rest[0] != n or rest[2] != 3 or rest[1] not in legal:
            raise DataError("bad-shape", f"shN has shape {rest}, expected ({n}, {legal}, 3)")
        for name in (*expected, "shN"):
            array = getattr(self, name)
            if array.dtype != np.float32:
                raise DataError("bad-dtype", f"{name} is {array.dtype}, expected float32")
            if not array.flags.c_contiguous:
                object.__setattr__(self, name, np.ascontiguousarray(array))
        object.__setattr__(self, "extras", _validate_extras(self.extras, n))

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """SH degree, 0 to 3."""
        return {0: 0, 3: 1, 8: 2, 15: 3}[self.shN.shape[1]]

    @property
    def nbytes(self) -> int:
        """Size of all arrays, bytes."""
        arrays = (self.means, self.scales, self.quats, self.opacities, self.sh0, self.shN)
        return sum(array.nbytes for array in (*arrays, *self.extras.values()))

    def __getitem__(
        self, rows: int | slice | Sequence[int] | NDArray[np.integer] | NDArray[np.bool_]
    ) -> Splats:
        """Return the splats of the given rows: views for a slice or an index, else copies.

        Examples
        --------
        >>> scene = empty(degree=1, n=10)
        >>> len(scene[2:5]), len(scene[scene.opacities > 1]), len(scene[-1])
        (3, 0, 1)
        """
        if isinstance(rows, int | np.integer):
            index = range(len(self))[rows]
            return self.take(slice(index, index + 1))
        return self.take(rows if isinstance(rows, slice) else np.asarray(rows))

    def __repr__(self) -> str:
        extras = f", extras {', '.join(self.extras)}" if self.extras else ""
        return f"<Splats: {len(self):,} of SH degree {self.sh_degree}{extras}>"

    @classmethod
    def from_arrays(
        cls,
        means: ArrayLike,
        scales: ArrayLike,
        quats: ArrayLike,
        opacities: ArrayLike,
        sh0: ArrayLike,
        shN: ArrayLike | None = None,
        *,
        scale_space: str = "log",
        opacity_space: str = "logit",
        quat_order: str = "wxyz",
        info: SceneInfo | None = None,
        extras: Mapping[str, Extra] | None = None,
    ) -> Splats:
        """Create splats from array-likes of any float type.

        Parameters
        ----------
        means : (N, 3)
            Centres, scene units.
        scales : (N, 3)
            Scales in `scale_space`.
        quats : (N, 4)
            Quaternions in `quat_order`, any non-zero norm.
        opacities : (N,) or (N, 1)
            Opacities in `opacity_space`.
        sh0 : (N, 3), (N, 1, 3), or (N, K, 3) with all coefficients if `shN` is not given
            DC coefficients, channels last.
        shN : (N, K-1, 3), optional
            Coefficients above DC, channels last.
        scale_space : str
            ``log`` (natural logarithm, as trained) or ``linear`` (standard deviations).
        opacity_space : str
            ``logit`` (as trained) or ``unit`` (0 to 1).
        quat_order : str
            ``wxyz`` or ``xyzw``.
        info : SceneInfo, optional
            Metadata of the scene; by default that of 3DGS training.
        extras : mapping of str to array, optional
            Extra attributes by name.

        Returns
        -------
        Splats

        Raises
        ------
        DataError
            ``bad-shape``, ``bad-dtype``, or ``bad-value`` for a linear scale of 0 or less or a unit
            opacity outside 0 to 1.
        ValueError
            The space or order is unknown.

        Examples
        --------
        >>> scene = Splats.from_arrays(
        ...     np.zeros((2, 3)), np.full((2, 3), 0.1), [[0, 0, 0, 1]] * 2, [[0.5], [1.0]],
        ...     np.zeros((2, 4, 3)), scale_space="linear", opacity_space="unit", quat_order="xyzw",
        ... )
        >>> scene
        <Splats: 2 of SH degree 1>
        """
        arrays = {
            name: as_floats(name, values)
            for name, values in (
                ("means", means), ("scales", scales), ("quats", quats),
                ("opacities", opacities), ("sh0", sh0),
            )
        }  # fmt: skip
        colour = arrays["sh0"]
        if shN is None:
            whole = colour[:, None] if colour.ndim == 2 else colour
            if whole.ndim != 3 or whole.shape[1] < 1:
                raise DataError(
                    "bad-shape", f"sh0 has shape {colour.shape}, expected (N, 3) or (N, K, 3)"
                )
            colour, rest = whole[:, 0], whole[:, 1:]
        else:
            rest = as_floats("shN", shN)
            if colour.ndim == 3 and colour.shape[1] == 1:
                colour = colour[:, 0]
        opacity = arrays["opacities"]
        if opacity.ndim == 2 and opacity.shape[1] == 1:
            opacity = opacity[:, 0]
        return cls(
            means=np.ascontiguousarray(arrays["means"]),
            scales=np.ascontiguousarray(log_scales(arrays["scales"], scale_space)),
            quats=np.ascontiguousarray(wxyz(arrays["quats"], quat_order)),
            opacities=np.ascontiguousarray(logits(opacity, opacity_space)),
            sh0=np.ascontiguousarray(colour),
            shN=np.ascontiguousarray(rest),
            info=info or SceneInfo(),
            extras=extras or {},
        )

    @classmethod
    def from_gsplat(cls, state: Mapping[str, object], *, info: SceneInfo | None = None) -> Splats:
        """Create splats from the parameters of a gsplat or nerfstudio model.

        Parameters
        ----------
        state : mapping of str to tensor or array
            Parameters by name: ``means scales quats opacities sh0 shN`` in gsplat; nerfstudio calls
            the last two ``features_dc`` and ``features_rest``. Names may have a prefix such as
            ``_model.gauss_params.``. Torch tensors may be on any device. Values are log scales,
            wxyz quaternions and logit opacities.
        info : SceneInfo, optional
            Metadata of the scene; by default that of 3DGS training.

        Raises
        ------
        DataError
            ``missing-array``: a parameter is missing; otherwise see `from_arrays`.

        Examples
        --------
        >>> state = {
        ...     "means": np.zeros((2, 3)), "scales": np.zeros((2, 3)), "quats": np.ones((2, 4)),
        ...     "opacities": np.zeros(2), "sh0": np.zeros((2, 1, 3)), "shN": np.zeros((2, 15, 3)),
        ... }
        >>> Splats.from_gsplat(state)
        <Splats: 2 of SH degree 3>
        """
        found: dict[str, NDArray[np.float32]] = {}
        for name, others in TRAINED_NAMES.items():
            keys = [
                key for key in state for other in others
                if key == other or key.endswith("." + other)
            ]  # fmt: skip
            if not keys:
                raise DataError(
                    "missing-array",
                    f"no {name} among {sorted(map(str, state))[:12]}, expected one of {others}",
                )
            found[name] = as_floats(name, state[keys[0]])
        return cls.from_arrays(
            found["means"],
            found["scales"],
            found["quats"],
            found["opacities"],
            found["sh0"],
            found["shN"],
            info=info,
        )

    def drop_invalid(self) -> Splats:
        """Return the splats without the rows of `invalid_rows`."""
        return self.take(~self.invalid_rows())

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_] | slice) -> Splats:
        """Return the splats of the given rows, copied; a slice gives views."""
        return replace(
            self,
            means=self.means[rows],
            scales=self.scales[rows],
            quats=self.quats[rows],
            opacities=self.opacities[rows],
            sh0=self.sh0[rows],
            shN=self.shN[rows],
            extras={name: values[rows] for name, values in self.extras.items()},
        )

    def without_extras(self) -> Splats:
        """Return the splats without extra attributes; the arrays are shared."""
        return replace(self, extras={}) if self.extras else self

    def with_sh_degree(self, degree: int) -> Splats:
        """Return the splats with SH reduced to `degree`; unchanged if their degree is lower."""
        if not 0 <= degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {degree}, expected 0 to {MAX_SH_DEGREE}")
        if degree >= self.sh_degree:
            return self
        return replace(self, shN=np.ascontiguousarray(self.shN[:, : sh_coefficients(degree) - 1]))

    def with_capture(self, capture: Capture) -> Splats:
        """Return a scene with capture viewpoints, if it has none of its own.

        Parameters
        ----------
        capture : Capture
            Viewpoints in the space of the means; they are not used by anti-aliased scenes.
        """
        if not capture or self.info.capture or self.info.antialiased:
            return self
        return replace(self, info=replace(self.info, capture=capture))

    def without_capture(self) -> Splats:
        """Return the scene without capture viewpoints: drawn as thick in every picture."""
        return replace(self, info=replace(self.info, capture=()))

    def invalid_rows(self) -> NDArray[np.bool_]:
        """Return a mask of the rows that cannot be drawn: NaN, infinite values, zero quaternions.

        Infinite opacity logits are valid.

        Returns
        -------
        (N,) bool
        """
        bad = np.isnan(self.opacities)
        # In blocks: one flag per value would take a fifth of the scene's memory.
        for start in range(0, len(self), _BLOCK):
            part = bad[start : start + _BLOCK]
            for array in (self.means, self.scales, self.quats, self.sh0, self.shN):
                rows = array[start : start + _BLOCK]
                part |= ~np.isfinite(rows.reshape(len(rows), math.prod(rows.shape[1:]))).all(axis=1)
            with np.errstate(invalid="ignore", over="ignore"):
                quats = self.quats[start : start + _BLOCK].astype(np.float64)
                norm = np.square(quats).sum(axis=1)
            part |= ~(norm > 0.0)
        return bad

    def require_valid(self) -> Splats:
        """Return self, or raise an error if a row cannot be drawn.

        Raises
        ------
        DataError
            ``invalid-rows``, with the first such row and their number.
        """
        bad = self.invalid_rows()
        count = int(bad.sum())
        if count:
            raise DataError(
                "invalid-rows",
                f"{count} of {len(self)} splats hold NaN, infinite values or a zero quaternion, "
                f"the first is row {int(bad.argmax())}; expected finite rows "
                "(`Splats.drop_invalid` leaves the others out)",
            )
        return self


def _require_array(name: str, value: object) -> None:
    """Raise `TypeError` unless a value is a numpy array."""
    if not isinstance(value, np.ndarray):
        raise TypeError(
            f"{name} is a {type(value).__name__}, expected a numpy array; Splats.from_arrays takes "
            "lists and tensors as well"
        )


def empty(degree: int, n: int = 0, info: SceneInfo | None = None) -> Splats:
    """Return `n` zero-valued splats of an SH degree, with unit quaternions."""
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1.0
    return Splats(
        means=np.zeros((n, 3), np.float32),
        scales=np.zeros((n, 3), np.float32),
        quats=quats,
        opacities=np.zeros(n, np.float32),
        sh0=np.zeros((n, 3), np.float32),
        shN=np.zeros((n, sh_coefficients(degree) - 1, 3), np.float32),
        info=info or SceneInfo(),
    )


def concatenate(parts: list[Splats]) -> Splats:
    """Concatenate splats of one SH degree; the result has the `info` of the first part.

    Raises
    ------
    DataError
        ``extras-mismatch``: names, types or components of the parts' extras differ.
    """
    kinds = [
        {name: (values.dtype, values.shape[1:]) for name, values in part.extras.items()}
        for part in parts
    ]
    for number, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise DataError(
                "extras-mismatch",
                f"part {number} has the extras {_describe_extras(parts[number].extras)}, "
                f"expected {_describe_extras(parts[0].extras)} as the first has",
            )
    return replace(
        parts[0],
        means=np.concatenate([part.means for part in parts]),
        scales=np.concatenate([part.scales for part in parts]),
        quats=np.concatenate([part.quats for part in parts]),
        opacities=np.concatenate([part.opacities for part in parts]),
        sh0=np.concatenate([part.sh0 for part in parts]),
        shN=np.concatenate([part.shN for part in parts]),
        extras={
            name: np.concatenate([part.extras[name] for part in parts]) for name in parts[0].extras
        },
    )


def _validate_extras(extras: Mapping[str, Extra], rows: int) -> dict[str, Extra]:
    """Validate extra attributes and return C-ordered arrays by name."""
    if len(extras) > MAX_EXTRAS:
        raise DataError("bad-extra", f"{len(extras)} extras, expected at most {MAX_EXTRAS}")
    checked: dict[str, Extra] = {}
    for name, values in extras.items():
        if not 1 <= _name_bytes(name) <= MAX_EXTRA_NAME_BYTES:
            raise DataError(
                "bad-extra",
                f"an extra is called {name[:40]!r}, "
                f"expected 1 to {MAX_EXTRA_NAME_BYTES} bytes of UTF-8",
            )
        shape = values.shape
        if not shape or shape[0] != rows or len(shape) > 2:
            raise DataError(
                "bad-shape", f"extra {name!r} has shape {shape}, expected ({rows},) or ({rows}, c)"
            )
        if len(shape) == 2 and not 1 <= shape[1] <= MAX_EXTRA_COMPONENTS:
            raise DataError(
                "bad-shape",
                f"extra {name!r} has {shape[1]} components, expected 1 to {MAX_EXTRA_COMPONENTS}",
            )
        if not values.dtype.isnative or values.dtype.str[1:] not in EXTRA_DTYPES:
            raise DataError(
                "bad-dtype",
                f"extra {name!r} is {values.dtype}, expected one of {', '.join(EXTRA_DTYPES)}",
            )
        checked[name] = np.ascontiguousarray(values)
    return checked


def _name_bytes(name: str) -> int:
    """Return the length of a name in UTF-8, bytes; 0 if it cannot be encoded."""
    try:
        return len(name.encode())
    except UnicodeEncodeError:
        return 0


def _describe_extras(extras: Mapping[str, Extra]) -> str:
    """Return names and types of extra attributes, for error messages."""
    kinds = [
        f"{name!r} {values.dtype.str[1:]}" + (f"x{values.shape[1]}" if values.ndim == 2 else "")
        for name, values in extras.items()
    ]
    return ", ".join(kinds) or "none"
