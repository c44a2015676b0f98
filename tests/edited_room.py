"""A small made room, an object, and edits of the room, made once per process."""

import functools

import jax
import numpy as np

from gsc_jax.benchmark import regions, scenes
from gsc_jax.benchmark.tamper import Edit, Tampered, tamper
from gsc_jax.scene import Gaussians

SIZE = 0.06
UP = np.array([0, -1.0, 0])


@functools.cache
def room():
    return scenes.make_room(count=6000), scenes.room_cameras(8, width=96, height=72)


@functools.cache
def vase() -> Gaussians:
    return scenes.make_object(count=600)


@functools.cache
def edited(edit: Edit, seed: int = 0) -> Tampered:
    return tamper(*room(), vase() if edit == "incorporation" else edit, size=SIZE, seed=seed)


@functools.cache
def visibility() -> regions.Visibility:
    return regions.measure_visibility(*room())


@functools.cache
def grown(size: float = 0.04) -> regions.Region:
    seed = regions.draw_seeds(visibility(), 1, np.random.default_rng(0))[0]
    return regions.grow_region(room()[0], visibility(), seed, size)


def rows_of(gaussians: Gaussians) -> set[bytes]:
    """Bytes of every row, all its fields together."""
    leaves = [np.asarray(leaf).reshape(len(gaussians), -1) for leaf in jax.tree.leaves(gaussians)]
    return {row.tobytes() for row in np.hstack(leaves)}
