"""Which properties of a .ply hold a Gaussian: vertex elements to Gaussians and back.

The names are those of the INRIA code: log scales, logit opacities, wxyz quaternions of any length,
and spherical harmonics of which `f_rest_*` is channel-major: all coefficients of red, then green,
then blue. Properties are found by name, in any order and of any numeric type.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.scene import Array, Gaussians, InputError

if TYPE_CHECKING:
    from plyfile import PlyData, PlyElement

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
REST_COUNTS = (0, 9, 24, 45)
"""Number of `f_rest_*` properties by degree of the spherical harmonics, 0 to 3."""

FLAT_LOG_SCALE = float(np.log(1e-6))
"""Third log scale of a 2DGS disc, whose file has two."""


def decode(vertex: "PlyElement", path: Path) -> Gaussians:
    """Reads the Gaussians out of a vertex element, whatever else is in it.

    Args:
        vertex: N rows with the properties of the INRIA layout, in any order and numeric type;
            normals are not looked at, and `scale_2` may lack, as 2DGS writes it.
        path: The file, for messages.

    Returns:
        All N Gaussians, NumPy float32, also those that cannot be rendered. Values beyond float32
        are infinite.

    Raises:
        InputError: if properties lack, or the number of `f_rest_*` is that of no degree 0 to 3.
    """
    scales = SCALE if SCALE[2] in vertex else SCALE[:2]
    rest = _rest_names(vertex, path)
    _require(vertex, (*POSITION, *DC, "opacity", *scales, *ROTATION, *rest), path)
    log_scales = _columns(vertex, scales)
    if len(scales) == 2:
        log_scales = np.pad(log_scales, ((0, 0), (0, 1)), constant_values=FLAT_LOG_SCALE)
    bands = [_columns(vertex, DC)[:, None]]
    if rest:
        bands.append(_columns(vertex, rest).reshape(len(vertex), 3, -1).transpose(0, 2, 1))
    return Gaussians(
        means=_columns(vertex, POSITION),
        log_scales=log_scales,
        quats=_columns(vertex, ROTATION),
        logit_opacities=_columns(vertex, ("opacity",))[:, 0],
        sh=np.concatenate(bands, axis=1),
    )


def encode(gaussians: Gaussians, *, tamper: Array | None = None) -> "PlyData":
    """Lays Gaussians out as the INRIA code does: normals zero, everything little endian float32.

    Args:
        gaussians: N Gaussians.
        tamper: Scores, shape (N,), for a last property `tamper`.

    Returns:
        A PLY with one element, `vertex`.

    Raises:
        ValueError: if there are not N scores.
    """
    from plyfile import PlyData, PlyElement

    sh = np.asarray(gaussians.sh)
    means = np.asarray(gaussians.means)
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1)
    names = [*POSITION, *NORMAL, *DC, *(f"f_rest_{i}" for i in range(rest.shape[1]))]
    names += ["opacity", *SCALE, *ROTATION]
    columns = [means, np.zeros_like(means), sh[:, 0], rest]
    columns += [np.asarray(gaussians.logit_opacities)[:, None]]
    columns += [np.asarray(gaussians.log_scales), np.asarray(gaussians.quats)]
    if tamper is not None:
        names.append("tamper")
        columns.append(np.asarray(tamper, np.float32).reshape(-1, 1))
    table = np.concatenate(columns, axis=1, dtype="<f4")
    data = table.view([(name, "<f4") for name in names]).reshape(len(table))
    return PlyData([PlyElement.describe(data, "vertex")], byte_order="<")


def _rest_names(vertex: "PlyElement", path: Path) -> tuple[str, ...]:
    count = sum(prop.name.startswith("f_rest_") for prop in vertex.properties)
    if count not in REST_COUNTS:
        raise InputError(
            f"{path}: has {count} f_rest properties, expected 0, 9, 24 or 45 (spherical harmonics "
            "of degree 0 to 3); export the scene again"
        )
    return tuple(f"f_rest_{i}" for i in range(count))


def _require(vertex: "PlyElement", names: tuple[str, ...], path: Path) -> None:
    numbers = vertex.data.dtype
    usable = [name for name in numbers.names or () if numbers[name].kind in "iuf"]
    missing = [name for name in names if name not in usable]
    if missing:
        raise InputError(
            f"{path}: lacks the numeric vertex properties {', '.join(missing)}, which a 3D "
            "Gaussian splatting model has; is it a point cloud or a mesh?"
        )


def _columns(vertex: "PlyElement", names: tuple[str, ...]) -> np.ndarray:
    with np.errstate(over="ignore"):  # float64 beyond float32: infinite, hence left out
        columns = [vertex.data[name] for name in names]
        return np.stack(columns, axis=1, dtype=np.float32, casting="unsafe")
