"""The columns of a .ply, written independently of the package."""

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

from gsc_jax.io.layout import DC, NORMAL, POSITION, ROTATION, SCALE
from gsc_jax.scene import Gaussians


def columns_of(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Columns by property name, from the definition: f_rest_* runs over red, green, blue."""
    sh = np.asarray(gaussians.sh)
    columns = dict(zip(POSITION, np.asarray(gaussians.means).T, strict=True))
    columns |= dict.fromkeys(NORMAL, np.zeros(len(sh), np.float32))
    columns |= dict(zip(DC, sh[:, 0].T, strict=True))
    rest = [sh[:, k, channel] for channel in range(3) for k in range(1, sh.shape[1])]
    columns |= {f"f_rest_{i}": column for i, column in enumerate(rest)}
    columns |= {"opacity": np.asarray(gaussians.logit_opacities)}
    columns |= dict(zip(SCALE, np.asarray(gaussians.log_scales).T, strict=True))
    return columns | dict(zip(ROTATION, np.asarray(gaussians.quats).T, strict=True))


def write_columns(path: Path, columns: dict[str, np.ndarray], **layout) -> Path:
    data = np.empty(len(columns["x"]), [(name, col.dtype) for name, col in columns.items()])
    for name, column in columns.items():
        data[name] = column
    PlyData([PlyElement.describe(data, "vertex")], **layout).write(str(path))
    return path


def assert_same(actual: Gaussians, expected: Gaussians) -> None:
    for field in ("means", "log_scales", "quats", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(actual, field), getattr(expected, field))
