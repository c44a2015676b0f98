"""Threads for views and for rows."""

import os
import subprocess
import sys
import threading
import time

import jax
import numpy as np
import pytest
from strategies import random_scene

import gsc_jax
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import parallel
from gsc_jax.scene.parallel import LARGE, ViewThreads, bounded_map, in_blocks


def with_cores(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(parallel, "usable_cores", lambda: list(range(count)))


@pytest.mark.parametrize(
    ("cores", "devices", "gaussians", "expected"),
    [
        (1, 1, 0, 1),
        (2, 1, 0, 2),
        (16, 1, 0, 8),
        (16, 1, LARGE, 8),
        (16, 1, LARGE + 1, 2),
        (1, 1, LARGE + 1, 1),
        (16, 3, 0, 16),
        (64, 3, 0, 24),
        (2, 4, 0, 4),
        (64, 4, LARGE + 1, 8),
    ],
)
def test_threads_for_views(monkeypatch, cores, devices, gaussians, expected):
    with_cores(monkeypatch, cores)
    monkeypatch.setattr(jax, "local_devices", lambda: [object()] * devices)
    with ViewThreads(gaussians) as pool:
        assert pool.count == expected


def test_results_are_in_order_and_few_items_are_in_flight(monkeypatch):
    with_cores(monkeypatch, 4)
    running, most, lock = 0, 0, threading.Lock()

    def slow(item: int) -> int:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.001 * (item % 3))
        with lock:
            running -= 1
        return -item

    taken = []
    with ViewThreads() as pool:
        assert list(bounded_map(pool, slow, [])) == []
        items = (taken.append(item) or item for item in range(30))
        for done, result in enumerate(bounded_map(pool, slow, items)):
            assert result == -done
            assert len(taken) <= done + 4
    assert 1 < most <= 4


def test_the_first_error_is_raised(monkeypatch):
    with_cores(monkeypatch, 4)
    with ViewThreads() as pool, pytest.raises(ZeroDivisionError):
        list(bounded_map(pool, lambda item: 1 / (item - 2), range(10)))


def test_blocks_of_rows_are_joined(monkeypatch):
    with_cores(monkeypatch, 16)
    rows = np.arange(3 * parallel.BLOCK + 5)
    np.testing.assert_array_equal(in_blocks(lambda some: 2 * some, rows), 2 * rows)
    assert in_blocks(lambda some: 2 * some, rows[:0]).shape == (0,)


def test_the_number_of_threads_changes_no_result(monkeypatch):
    gaussians = random_scene(500)
    cameras = orbit_cameras(gaussians, 12, size=(48, 40))
    masks = [np.random.default_rng(i).random((40, 48)) > 0.7 for i in range(12)]

    def located(cores: int) -> gsc_jax.Result:
        with_cores(monkeypatch, cores)
        return gsc_jax.locate(gaussians, cameras, masks)

    one, many = located(1), located(16)
    np.testing.assert_array_equal(one.tamper, many.tamper)
    assert one.prior is not None
    assert many.prior is not None
    np.testing.assert_array_equal(one.prior.probability, many.prior.probability)
    assert one.verdict == many.verdict
    assert all(np.array_equal(one.masks[c.name], many.masks[c.name]) for c in cameras)


IN_CALLING_THREAD = """
import os, threading, time
import jax, jax.numpy as jnp
from gsc_jax.scene.parallel import compute_in_calling_thread

cores = os.sched_getaffinity(0)
compute_in_calling_thread()
assert all(os.sched_getaffinity(int(t)) == cores for t in os.listdir("/proc/self/task"))
products = jax.jit(lambda x: jax.lax.fori_loop(0, 200, lambda _, y: jnp.sin(y @ y), x))
products(jnp.ones((300, 300))).block_until_ready()
start, own = time.process_time(), time.thread_time()
products(jnp.ones((300, 300))).block_until_ready()
print((time.thread_time() - own) / (time.process_time() - start))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="affinities are those of Linux")
def test_jax_can_compute_in_the_calling_thread():
    command = [sys.executable, "-c", IN_CALLING_THREAD]
    # Without the cache: a function that another test compiled for several threads would use them.
    own = {**os.environ, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_COMPILATION_CACHE": "0"}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=own)
    assert float(done.stdout) > 0.9
