"""Gaussians, cameras, and the types and helpers that every other package needs."""

from gsc_jax.scene.camera import Camera
from gsc_jax.scene.errors import InputError
from gsc_jax.scene.gaussians import Array, Gaussians, invalid_rows
from gsc_jax.scene.pytree import pytree

__all__ = ["Array", "Camera", "Gaussians", "InputError", "invalid_rows", "pytree"]
