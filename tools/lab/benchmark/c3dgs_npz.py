"""The npz format of Niedermayr et al. 2024, implemented from the paper for comparison.

One archive in Morton order: means in half precision; opacity, scale factor and codebook rows in
8 bits with one range per scene. Vectors of high sensitivity are stored without clustering. The
fine-tuning on photos in the paper's results is left out.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import kmeans
from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles import outliers
from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry import covariance, morton, rotations
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.codec.trained_arrays import opacities_from_logits
from cogsplat.formats.storage.atomic import atomic_write

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I8 = NDArray[np.int8]
I32 = NDArray[np.int32]

CODEBOOK_ROWS: Final = 4096  # section 3.2, both codebooks

# Colours above this sensitivity × N are not clustered. The published threshold is 0.6e-6 for scenes
# of 3.36 million splats on average; sensitivity is a share of the picture, so it scales with 1 / N.
_MIN_KEPT_SENSITIVITY: Final = 0.6e-6 * 3.36e6

_HALF_MAX: Final = 65504.0
_TRAINING: Final = TrainingConfig(iterations=8)


def write(splats: Splats, scores: Scores, path: Path, *, threads: int = 0) -> None:
    """Write a scene as an npz archive, replacing an existing file.

    Parameters
    ----------
    splats : Splats
        Valid rows, at least one.
    scores : Scores
        Scores of the splats, whose sensitivities weight the codebook training. Splats without
        contribution to any view are dropped. Shapes use `Scores.sensitivities` with respect to
        the log scales. Colours of high sensitivity, and an equal number of shapes, are stored
        without clustering.
    path : Path
    threads : int
        0 for all cores; the bytes do not depend on it.

    Raises
    ------
    DataError
        ``value-range``: a mean exceeds half precision; ``no-scores``: no splat contributes to a
        view.
    """
    seen = scores.colour_sensitivity > 0
    if not seen.any():
        raise DataError("no-scores", f"{path}: none of {len(splats)} splats adds to a view")
    far = float(np.abs(splats.means[seen]).max())
    if far > _HALF_MAX:
        raise DataError(
            "value-range", f"{path}: a mean of {far:g}, expected at most {_HALF_MAX:g} (fp16)"
        )
    order = np.flatnonzero(seen)[_morton_order(splats.means[seen])]
    splats, scores = outliers.clip_outliers(splats.take(order)), scores.take(order)
    colours = np.concatenate([splats.sh0, splats.shN.reshape(len(splats), -1)], axis=1)
    weights = scores.colour_sensitivity
    kept = weights * len(weights) > _MIN_KEPT_SENSITIVITY
    colour_rows, colour_indices = _cluster(colours, weights, kept, threads)
    scales, quats, shape_indices, factors = _cluster_shapes(
        splats, scores, int(kept.sum()), threads
    )
    opacities_unit = opacities_from_logits(splats.opacities.astype(np.float64))
    arrays: dict[str, NDArray[np.generic]] = {
        "xyz": splats.means.astype(np.float16),
        "feature_indices": colour_indices,
        "gaussian_indices": shape_indices,
    }
    rows = colour_rows.reshape(len(colour_rows), -1, 3)
    for name, values in (
        ("features_dc", rows[:, :1]),
        ("features_rest", rows[:, 1:]),
        ("opacity", opacities_unit[:, None]),
        ("scaling", np.exp(scales)),
        ("scaling_factor", factors[:, None]),
        ("rotation", quats),
    ):
        codes, scale, zero_point = _to_int8(values.astype(np.float64))
        arrays[name] = codes
        arrays[f"{name}_scale"] = np.array(scale, np.float32)
        arrays[f"{name}_zero_point"] = np.array(zero_point, np.int32)
    page = io.BytesIO()
    np.savez_compressed(page, **arrays)  # type: ignore[arg-type]
    with atomic_write(path, force=True) as file:
        file.write(page.getbuffer())


def read(path: Path, info: SceneInfo | None = None) -> Splats:
    """Read an npz archive made by `write`; the content is not validated.

    Parameters
    ----------
    path : Path
    info : SceneInfo, optional
        Scene information, which the archive does not store.

    Returns
    -------
    Splats
    """
    with np.load(path, allow_pickle=False) as stored:
        colour, at = stored["feature_indices"], stored["gaussian_indices"]
        linear = np.maximum(_from_int8(stored, "scaling"), 0)
        norm = np.maximum(np.linalg.norm(linear, axis=1, keepdims=True), 1e-12)
        relative = np.log(np.maximum(linear / norm, covariance.MIN_RELATIVE_SCALE))
        opacities_unit = np.clip(_from_int8(stored, "opacity")[:, 0], 0, 1)
        with np.errstate(divide="ignore"):
            opacities = np.log(opacities_unit) - np.log1p(-opacities_unit)
        quats = _from_int8(stored, "rotation")
        quats[np.square(quats).sum(axis=1) == 0, 0] = 1
        return Splats(
            means=stored["xyz"].astype(np.float32),
            scales=(relative[at] + _from_int8(stored, "scaling_factor")).astype(np.float32),
            quats=rotations.unit(quats[at].astype(np.float32)),
            opacities=opacities.astype(np.float32),
            sh0=_from_int8(stored, "features_dc")[colour, 0].astype(np.float32),
            shN=_from_int8(stored, "features_rest")[colour].astype(np.float32),
            info=info or SceneInfo(),
        )


def _morton_order(means: F32) -> NDArray[np.int64]:
    """Return the Morton order of positions within their bounding box."""
    low = means.min(axis=0).astype(np.float64)
    span = np.maximum(means.max(axis=0) - low, 1e-30)
    codes = (means - low) / span * (morton.MAX_LEVELS - 1)
    keys = morton.interleave(np.rint(codes).astype(np.uint32))
    return np.argsort(keys, kind="stable").astype(np.int64)


def _cluster(vectors: F32, weights: F64, kept: NDArray[np.bool_], threads: int) -> tuple[F32, I32]:
    """Cluster the vectors that are not in `kept`.

    Returns
    -------
    rows : (r, d) float32
        Codebook rows, then the kept vectors.
    indices : (n,) int32
        Row of each vector.
    """
    rows = np.zeros((0, vectors.shape[1]), np.float32)
    indices = np.zeros(len(vectors), np.int32)
    if not kept.all():
        rows = kmeans.train(vectors[~kept], weights[~kept], CODEBOOK_ROWS, _TRAINING)
        indices[~kept] = kmeans.nearest(vectors[~kept], rows, threads)[0]
    indices[kept] = len(rows) + np.arange(int(kept.sum()))
    return np.concatenate([rows, vectors[kept]]), indices


def _cluster_shapes(
    splats: Splats, scores: Scores, keep: int, threads: int
) -> tuple[F32, F32, I32, F32]:
    """Cluster the shapes of splats: rotations, and scales divided by a scale factor.

    Parameters
    ----------
    splats : Splats
    scores : Scores
        Scores of the splats, which weight the shapes.
    keep : int
        Number of shapes of the highest weights, which are stored without clustering.
    threads : int
        0 for all cores.

    Returns
    -------
    scales, quats : (r, 3) float32, (r, 4) float32
        Log scales and quaternions of the clustered rows, then of the kept shapes.
    indices : (N,) int32
        Row of each splat.
    factors : (N,) float32
        Log scale factor of each splat.
    """
    quats = rotations.unit(splats.quats)
    factors = covariance.scale_factor(splats.scales)
    found = scores.sensitivities
    squared = scores.energy if found is None else found.scales.max(axis=1)
    weights = np.sqrt(squared)
    kept = np.zeros(len(splats), np.bool_)
    kept[np.argsort(-weights, kind="stable")[:keep]] = True
    rows, indices = _cluster(covariance.shape_vectors(quats, splats.scales), weights, kept, threads)
    clustered = len(rows) - keep
    row_quats, row_scales = covariance.quats_and_scales(rows[:clustered])
    own_scales = splats.scales[kept] - factors[kept, None]
    scales = np.concatenate([row_scales, own_scales.astype(np.float32)])
    return scales, np.concatenate([row_quats, quats[kept]]), indices, factors


def _to_int8(values: F64) -> tuple[I8, float, int]:
    """Quantise to int8 over one range of all values and 0, as PyTorch's observers do."""
    low, high = min(float(values.min(initial=0)), 0.0), max(float(values.max(initial=0)), 0.0)
    scale = float(np.float32(max((high - low) / 255, 1e-12)))
    zero_point = round(-128 - low / scale)
    codes = np.clip(np.rint(values / scale) + zero_point, -128, 127)
    return codes.astype(np.int8), scale, zero_point


def _from_int8(stored: np.lib.npyio.NpzFile, name: str) -> F64:
    """Dequantise an array of the archive."""
    offset = stored[name].astype(np.float64) - float(stored[f"{name}_zero_point"])
    values: F64 = offset * float(stored[f"{name}_scale"])
    return values
