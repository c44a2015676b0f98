"""Files of the editors of the paper's Table 1, laid out as their own `save_ply` does.

GaussianEditor and DGE (which builds on it) write the columns of INRIA for the degree of their
scene, often 0; Gaussian Grouping adds an identity of 16 numbers to each Gaussian.
"""

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.cli.main import main
from gsc_jax.io.cameras import save_cameras

MADE = tampered_room(count=3_000, views=3, heldout=1, width=64, height=48, seed=5)
EDITORS = {"GaussianEditor": (0, False), "DGE": (3, False), "Gaussian Grouping": (3, True)}
"""Degree of the spherical harmonics, and whether there are identities of objects."""


def written(path, degree, grouped):
    """Columns and rows of the file: float32 throughout, f_rest_* running over red, green, blue."""
    gaussians, rng = MADE.gaussians, np.random.default_rng(0)
    count, rest = len(gaussians), 3 * ((degree + 1) ** 2 - 1)
    blocks = {
        "xyz": (["x", "y", "z"], gaussians.means),
        "normals": (["nx", "ny", "nz"], np.zeros((count, 3))),
        "f_dc": ([f"f_dc_{i}" for i in range(3)], np.asarray(gaussians.sh)[:, 0]),
        "f_rest": ([f"f_rest_{i}" for i in range(rest)], rng.normal(0, 0.1, (count, rest))),
        "opacity": (["opacity"], np.asarray(gaussians.logit_opacities)[:, None]),
        "scale": ([f"scale_{i}" for i in range(3)], gaussians.log_scales),
        "rot": ([f"rot_{i}" for i in range(4)], gaussians.quats),
    }
    if grouped:
        blocks["obj"] = ([f"obj_dc_{i}" for i in range(16)], rng.normal(size=(count, 16)))
    names = [name for columns, _ in blocks.values() for name in columns]
    rows = np.concatenate([np.asarray(values) for _, values in blocks.values()], axis=1)
    elements = np.empty(count, [(name, "f4") for name in names])
    elements[:] = list(map(tuple, rows))
    PlyData([PlyElement.describe(elements, "vertex")]).write(str(path))
    return elements


@pytest.mark.parametrize("editor", EDITORS)
def test_files_of_editors_are_judged_and_keep_every_column(editor, tmp_path):
    original = written(tmp_path / "point_cloud.ply", *EDITORS[editor])
    save_cameras(tmp_path / "cameras.json", MADE.cameras)
    command = ["locate", str(tmp_path / "point_cloud.ply"), "--out", str(tmp_path / "found")]
    assert main([*command, "--cameras", str(tmp_path / "cameras.json")]) == 0
    kept = PlyData.read(str(tmp_path / "found" / "tamper.ply"))["vertex"].data
    names, kept_names = list(original.dtype.names or ()), list(kept.dtype.names)
    assert names == kept_names[: len(names)]
    for name in names:
        np.testing.assert_array_equal(kept[name], original[name])
    assert "tamper" in kept_names
