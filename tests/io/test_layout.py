"""Properties are found by name; those that are missing or not numeric are named."""

import numpy as np
import pytest
from ply_files import columns_of, write_columns
from strategies import random_scene

from gsc_jax.io.layout import DC, FLAT_LOG_SCALE, NORMAL, POSITION, ROTATION, SCALE
from gsc_jax.io.ply import load_ply, read_ply, save_ply
from gsc_jax.scene import InputError

SCENE = random_scene(7)
COLUMNS = columns_of(SCENE)


def without(*names: str, **changed: np.ndarray) -> dict[str, np.ndarray]:
    return {name: col for name, col in (COLUMNS | changed).items() if name not in names}


def test_saved_layout_is_that_of_the_inria_code(tmp_path):
    scores = np.linspace(0, 1, 7)
    save_ply(tmp_path / "a.ply", SCENE, tamper=scores)
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    names = [*POSITION, *NORMAL, *DC, *(f"f_rest_{i}" for i in range(9)), "opacity", *SCALE]
    names += [*ROTATION, "tamper"]
    expected = ["ply", "format binary_little_endian 1.0", "element vertex 7"]
    assert header.decode().splitlines() == expected + [f"property float {name}" for name in names]
    columns = COLUMNS | {"tamper": scores}
    assert body == np.stack([columns[name] for name in names], axis=1).astype("<f4").tobytes()


def test_2dgs_discs_get_a_third_scale(tmp_path):
    actual = load_ply(write_columns(tmp_path / "discs.ply", without("scale_2")))
    np.testing.assert_array_equal(actual.log_scales[:, :2], SCENE.log_scales[:, :2])
    assert np.exp(FLAT_LOG_SCALE) == pytest.approx(1e-6)
    np.testing.assert_allclose(actual.log_scales[:, 2], FLAT_LOG_SCALE)
    assert np.exp(FLAT_LOG_SCALE) == pytest.approx(1e-6)


@pytest.mark.parametrize("text", [False, True])
def test_float64_beyond_float32_is_not_finite(tmp_path, text):
    columns = {name: column.astype("f8") for name, column in COLUMNS.items()}
    columns["y"][2] = 1e300
    columns["opacity"][3] = 1e300
    scene = read_ply(write_columns(tmp_path / "huge.ply", columns, text=text))
    assert scene.dropped == {"position not finite": 1}
    assert np.isposinf(scene.gaussians.logit_opacities[2]), "an opacity of 1 is valid"


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        (without("f_dc_1", "rot_3"), "lacks the numeric vertex properties f_dc_1, rot_3"),
        (without("scale_1"), "lacks the numeric vertex properties scale_1"),
        (without("f_rest_8"), "has 8 f_rest properties, expected 0, 9, 24 or 45"),
        (without("f_rest_4", f_rest_9=np.zeros(7, "f4")), "f_rest_4"),
        (without(z=np.full(7, np.nan)), "no Gaussian can be rendered: left out 7 of 7"),
        ({name: col[:0] for name, col in COLUMNS.items()}, r"holds no Gaussians \(no vertices\)"),
    ],
)
def test_incomplete_scenes_are_refused(tmp_path, columns, problem):
    path = write_columns(tmp_path / "bad.ply", columns)
    with pytest.raises(InputError, match=problem) as error:
        read_ply(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)
