"""Scenes and cameras for tests: seeded ones, and hypothesis strategies with fixed shapes."""

import dataclasses

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics

COUNT = 12
"""Gaussians of a drawn scene: a fixed number, so that nothing recompiles."""


def camera(width: int = 17, height: int = 15, *, viewmat=None, focal: float = 20.0) -> Camera:
    """A camera with this viewmat, by default at the origin and looking along z."""
    viewmat = np.asarray(np.eye(4) if viewmat is None else viewmat, np.float32)
    K = intrinsics(focal, width, height)
    return Camera(viewmat=viewmat, K=K, width=width, height=height)


def cameras_in_a_row(count: int, width: int, height: int, *, step: float) -> list[Camera]:
    """Cameras beside each other, looking along z, named view_0 and so on."""
    found = []
    for index in range(count):
        view = camera(width, height)
        viewmat = np.array(view.viewmat)
        viewmat[0, 3] = step * (index - count / 2)
        found.append(dataclasses.replace(view, viewmat=viewmat, name=f"view_{index}"))
    return found


def random_scene(count: int, *, seed: int = 0, degree: int = 1) -> Gaussians:
    """Gaussians of all sizes in front of the camera, some of them outside of the image."""
    rng = np.random.default_rng([seed, count])
    return Gaussians(
        means=(rng.normal(size=(count, 3)) * [0.7, 0.7, 0.8] + [0, 0, 3]).astype(np.float32),
        log_scales=rng.uniform(-4, -0.5, (count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        logit_opacities=rng.normal(0, 2, count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def blobs(means, *, opacity: float = 0.5, scale: float = 0.2) -> Gaussians:
    """Equal round grey Gaussians at these places."""
    means = np.asarray(means, np.float32).reshape(-1, 3)
    count = len(means)
    return Gaussians(
        means=means,
        log_scales=np.full((count, 3), np.log(scale), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        logit_opacities=np.full(count, np.log(opacity / (1 - opacity)), np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def ball(count: int = 2000, *, center=(1.0, -2.0, 5.0), radius: float = 2.0) -> Gaussians:
    """An opaque ball in which every tenth Gaussian is a faint floater far away."""
    rng = np.random.default_rng(0)
    means = rng.standard_normal((count, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    means *= radius * rng.uniform(0, 1, (count, 1)) ** (1 / 3)
    means[::10] *= 1e4
    scene = blobs(means + center, opacity=0.95, scale=0.02)
    scene.logit_opacities[::10] = -3
    return scene


def needles(count: int, *, length: float, width: float = 1e-3) -> Gaussians:
    """Random Gaussians with one axis of another length."""
    log_scales = np.log(np.tile([length, width, width], (count, 1))).astype(np.float32)
    return dataclasses.replace(random_scene(count), log_scales=log_scales)


def with_row(gaussians: Gaussians, field: str, value, *, row: int = 0) -> Gaussians:
    """The scene with one row of a field replaced."""
    values = np.array(getattr(gaussians, field))
    values[row] = value
    return dataclasses.replace(gaussians, **{field: values})


def floats(shape, low: float, high: float):
    """Arrays of float32 within bounds."""
    elements = st.floats(low, high, width=32, allow_subnormal=False)
    return hnp.arrays(np.float32, shape, elements=elements)


@st.composite
def quaternions(draw, count: int = COUNT):
    """Quaternions that are not zero, shape (count, 4)."""
    quats = draw(floats((count, 4), -1, 1))
    quats[np.abs(quats).max(axis=1) < 0.1] = [1, 0, 0, 0]
    return quats


@st.composite
def scenes(draw, count: int = COUNT) -> Gaussians:
    """Scenes of degree 0 in depth order, whose depths differ by at least 0.06."""
    sideways = draw(floats((count, 2), -1, 1))
    depths = 1 + 0.1875 * np.arange(count) + draw(floats(count, 0, 0.125))
    return Gaussians(
        means=np.column_stack([sideways, depths]).astype(np.float32),
        log_scales=draw(floats((count, 3), -4, 0)),
        quats=draw(quaternions(count)),
        logit_opacities=draw(floats(count, -4, 6)),
        sh=draw(floats((count, 1, 3), -1.5, 1.5)),
    )


@st.composite
def motions(draw) -> tuple[np.ndarray, np.ndarray]:
    """A rotation as a unit quaternion wxyz and a translation, float64."""
    quat = draw(quaternions(1))[0].astype(np.float64)
    return quat / np.linalg.norm(quat), draw(floats(3, -3, 3)).astype(np.float64)
