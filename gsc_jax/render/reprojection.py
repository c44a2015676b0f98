"""Views whose splats follow changed parameters, as an optimiser needs them under `jax.jit`."""

import dataclasses

from gsc_jax.render.projection import NEAR, project
from gsc_jax.render.tiles import View, splat_table
from gsc_jax.scene import Camera, Gaussians


def reprojected(view: View, gaussians: Gaussians, camera: Camera, *, near: float = NEAR) -> View:
    """The view with new parameters of its Gaussians in unchanged lists, also under `jax.jit`.

    The lists stay right as long as the parameters change little, as in a step of an optimiser.

    Args:
        view: View of N Gaussians, from `make_view`.
        gaussians: The same Gaussians with new parameters.
        camera: The camera of the view; its pose may have changed a little.
        near: Near plane in world units.

    Returns:
        The view, whose `splats` can be differentiated by the Gaussians and the camera.

    Raises:
        ValueError: if the view is one of another number of Gaussians or of another image size.
    """
    require_view_of(view, gaussians, camera)
    return dataclasses.replace(view, splats=splat_table(project(gaussians, camera, near=near)))


def require_view_of(view: View, gaussians: Gaussians, camera: Camera) -> None:
    """Raise ValueError if a view is not one of these Gaussians, or of another image size."""
    found = view.splats.shape[0] - 1, view.width, view.height
    expected = len(gaussians), camera.width, camera.height
    if found != expected:
        raise ValueError(
            "expected a view of {} Gaussians with {} x {} pixels".format(*expected)
            + ", got one of {} with {} x {}".format(*found)
        )
