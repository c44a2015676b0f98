"""Conversion between the vertices of a .ply and Gaussians.

The property names are those of the INRIA code: log scales, logit opacities, wxyz quaternions of any
length, and spherical harmonics of which `f_rest_*` is channel-major: all coefficients of red, then
of green, then of blue. Properties are found by name, in any order and of any numeric type.
"""

from pathlib import Path

import jax
import numpy as np
from plyfile import PlyData, PlyElement

from gsc_jax.scene import Array, Gaussians, InputError

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
REST = tuple(f"f_rest_{index}" for index in range(45))
REST_COUNTS = (0, 9, 24, 45)
"""Number of `f_rest_*` properties by degree of the spherical harmonics, 0 to 3."""

FLAT_LOG_SCALE = float(np.log(1e-6))
"""Third log scale of a 2DGS disc, whose file has only two; far below the size of a pixel."""


def decode(vertex: PlyElement, path: Path) -> Gaussians:
    """Extract all rows of a vertex element as Gaussians, NumPy float32.

    Normals and other properties are ignored; `scale_2` may be missing (2DGS). Rows that cannot be
    rendered are included; values beyond float32 are infinite. Missing properties, or a number of
    `f_rest_*` that fits no degree 0 to 3, raise InputError of the path.
    """
    scales = SCALE if SCALE[2] in vertex else SCALE[:2]
    count = sum(prop.name.startswith("f_rest_") for prop in vertex.properties)
    if count not in REST_COUNTS:
        raise InputError(
            f"{path}: has {count} f_rest properties, expected 0, 9, 24 or 45 (spherical harmonics "
            "of degree 0 to 3); export the scene again"
        )
    rest = REST[:count]
    names = (*POSITION, *DC, "opacity", *scales, *ROTATION, *rest)
    types = vertex.data.dtype.fields or {}
    missing = [name for name in names if name not in types or types[name][0].kind not in "iuf"]
    if missing:
        raise InputError(
            f"{path}: lacks the numeric vertex properties {', '.join(missing)}, which a 3D "
            "Gaussian splatting model has; is it a point cloud or a mesh?"
        )
    log_scales = _columns(vertex, scales)
    if len(scales) == 2:
        log_scales = np.pad(log_scales, ((0, 0), (0, 1)), constant_values=FLAT_LOG_SCALE)
    bands = [_columns(vertex, DC)[:, None]]
    if rest:
        bands.append(_columns(vertex, rest).reshape(len(vertex), 3, -1).transpose(0, 2, 1))
    means, quats = _columns(vertex, POSITION), _columns(vertex, ROTATION)
    logits, sh = _columns(vertex, ("opacity",)).ravel(), np.concatenate(bands, axis=1)
    return Gaussians(means=means, log_scales=log_scales, quats=quats, logit_opacities=logits, sh=sh)


def encode(gaussians: Gaussians) -> PlyData:
    """Arrange Gaussians in the INRIA layout: normals zero, everything little endian float32."""
    host = jax.tree.map(np.asarray, gaussians)
    normals, first, rest = np.zeros_like(host.means), host.sh[:, 0], host.sh[:, 1:]
    columns = [host.means, normals, first, *np.moveaxis(rest, 2, 0)]
    columns += [host.logit_opacities[:, None], host.log_scales, host.quats]
    table = np.ascontiguousarray(np.concatenate(columns, axis=1, dtype="<f4"))
    names = [*POSITION, *NORMAL, *DC, *REST[: 3 * rest.shape[1]], "opacity", *SCALE, *ROTATION]
    data = table.view([(name, "<f4") for name in names]).reshape(len(table))
    return PlyData([PlyElement.describe(data, "vertex")], byte_order="<")


def checked_scores(path: str | Path, tamper: Array, count: int) -> np.ndarray:
    """Scores as float32, shape (count,); InputError if there are others, or one is not finite."""
    scores = np.asarray(tamper)
    with np.errstate(over="ignore"):
        real = scores.astype(np.float32) if scores.dtype.kind in "biuf" else np.array(np.nan)
    if real.shape != (count,) or not np.isfinite(real).all():
        raise InputError(
            f"{path}: not written: expected {count} finite scores, one per Gaussian, found "
            f"{scores.dtype} of shape {scores.shape}; correct the scores"
        )
    return real


def _columns(vertex: PlyElement, names: tuple[str, ...]) -> np.ndarray:
    # Numbers of float64 beyond float32 become infinite, signalling NaNs quiet ones: invalid rows.
    with np.errstate(over="ignore", invalid="ignore"):
        columns = [vertex.data[name] for name in names]
        return np.stack(columns, axis=1, dtype=np.float32, casting="unsafe")
