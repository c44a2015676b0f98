"""The walk: its exponential function, and parts of the tiles in threads."""

import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from strategies import camera, random_scene

from gsc_jax.render import walk
from gsc_jax.render.derivatives import derivatives
from gsc_jax.render.tiles import View, make_view
from gsc_jax.render.walk import LOG_MIN_ALPHA, exp_of_visible, in_parts
from gsc_jax.splat import accumulate, composite

SCENE, CAMERA = random_scene(300), camera(200, 120)
FEATURES = jnp.asarray(np.random.default_rng(0).random((300, 3)), jnp.float32)
MAPS = jnp.asarray(np.random.default_rng(1).random((120, 200, 3)), jnp.float32)


ON_CPU = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="an accelerator walks a view in one part"
)


def test_the_exponential_of_visible_splats():
    x = np.linspace(LOG_MIN_ALPHA, 0, 100_001, dtype=np.float32)
    np.testing.assert_allclose(exp_of_visible(jnp.asarray(x)), np.exp(x.astype(float)), rtol=3e-6)
    assert exp_of_visible(jnp.float32(0)) <= 1


@ON_CPU
@pytest.mark.parametrize("cores", [1, 2, 4, 8, 13])
def test_parts_cover_each_tile_once(monkeypatch, cores):
    monkeypatch.setattr(walk, "usable_cores", lambda: list(range(cores)))
    view = make_view(SCENE, CAMERA)
    groups = len(view.tiles) // view.lockstep
    parts = in_parts(lambda part, _: part, view, FEATURES)
    assert len(parts) == math.gcd(groups, 2 ** int(math.log2(cores)))
    for name in ("tiles", "starts", "counts"):
        found = np.concatenate([np.asarray(getattr(part, name)) for part in parts])
        assert sorted(found) == sorted(np.asarray(getattr(view, name)))
    assert all(part.counts[0] == np.max(part.counts) for part in parts)


@ON_CPU
def test_parts_give_what_the_whole_gives(monkeypatch):
    monkeypatch.setattr(walk, "usable_cores", lambda: list(range(4)))
    view = make_view(SCENE, CAMERA)
    counts = []

    def computed() -> tuple[jax.Array, ...]:
        image = composite(view, FEATURES)
        counts.append(len(in_parts(lambda part, _: part, view, FEATURES)))
        return image, accumulate(view, MAPS), *derivatives(view, FEATURES, image, MAPS)

    parts = computed()
    with ThreadPoolExecutor(1) as pool:  # views in threads share the cores already
        whole = pool.submit(computed).result()
    assert counts[0] > 1 == counts[1]
    np.testing.assert_array_equal(parts[0], whole[0])
    for found, expected in zip(parts[1:], whole[1:], strict=True):
        scale = float(jnp.max(jnp.abs(expected)))
        np.testing.assert_allclose(found, expected, atol=1e-5 * scale)


def test_under_jit_there_is_one_part(monkeypatch):
    monkeypatch.setattr(walk, "usable_cores", lambda: list(range(4)))
    counts = []

    def part_of(part: View, features: jax.Array) -> jax.Array:
        counts.append(len(part.tiles))
        return features

    view = make_view(SCENE, CAMERA)
    jax.jit(lambda features: in_parts(part_of, view, features)[0])(FEATURES)
    jax.jit(lambda seen: in_parts(part_of, seen, FEATURES)[0])(view)
    assert counts == [len(view.tiles)] * 2


X64 = """
import jax
import numpy as np
import gsc_jax
from gsc_jax.benchmark.scenes import tampered_room
assert jax.config.jax_enable_x64
made = tampered_room(count=300, views=2, heldout=0, width=32, height=24)
found = gsc_jax.locate(made.gaussians, made.cameras, [np.eye(24, 32)] * 2)
assert found.tamper.dtype == np.float32
loss = lambda scene: gsc_jax.render(scene, made.cameras[0])[0].sum()
assert float(jax.numpy.abs(jax.grad(loss)(jax.device_put(made.gaussians)).means).max()) > 0
"""


@pytest.mark.slow
def test_locate_and_gradients_work_in_a_program_that_uses_64_bits():
    environment = {**os.environ, "JAX_ENABLE_X64": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", X64], env=environment, check=True, timeout=300)


@ON_CPU
def test_device_jit_and_x64_of_one_thread_hold_for_a_view(monkeypatch):
    monkeypatch.setattr(walk, "usable_cores", lambda: list(range(4)))
    view = make_view(SCENE, CAMERA)

    def parts() -> int:
        return len(in_parts(lambda part, _: part, view, FEATURES))

    assert parts() > 1
    with jax.default_device(jax.devices()[0]):
        assert parts() == 1
    with jax.disable_jit():
        assert parts() == 1
    with jax.enable_x64(True):
        assert parts() == 1
