"""gsc_jax finds the tampered Gaussians of a 3D Gaussian Splatting model."""

from gsc_jax.projection import project
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import accumulate_maps as accumulate
from gsc_jax.splat import make_view, render, render_features

__all__ = ["Camera", "Gaussians", "accumulate", "make_view", "project", "render", "render_features"]
