"""The scene of the viewer: splats, cameras and the first view, through viser's public API."""

import dataclasses
from typing import TYPE_CHECKING

from gsc_jax.cli.viewer.contents import Contents
from gsc_jax.cli.viewer.splats import (
    Splats,
    fit_half_precision,
    half_precision_unit,
    layer_colours,
)

if TYPE_CHECKING:
    import viser

FRUSTUM_COLOUR = (255, 170, 0)
FRUSTUM_PIXELS = 1.5


def add_cameras(
    server: "viser.ViserServer", contents: Contents
) -> "list[viser.CameraFrustumHandle]":
    """Set the first view and draw the cameras."""
    first, start = server.initial_camera, contents.poses[0]
    server.scene.set_up_direction(contents.up)
    server.scene.world_axes.visible = False
    first.position, first.look_at, first.up = start.position, start.look_at, start.up
    first.fov, first.near, first.far = start.fov, contents.near, contents.far
    return [
        server.scene.add_camera_frustum(
            f"/cameras/{index}",
            fov=pose.fov,
            aspect=pose.aspect,
            scale=contents.frustum,
            thickness=FRUSTUM_PIXELS,
            thickness_units="screen",
            color=FRUSTUM_COLOUR,
            wxyz=pose.wxyz,
            position=pose.position,
            cast_shadow=False,
            receive_shadow=False,
        )
        for index, pose in enumerate(contents.poses, start=1)
    ]


def add_splats(
    server: "viser.ViserServer", name: str, splats: Splats
) -> "viser.GaussianSplatHandle":
    """Add splats as a node of the scene."""
    unit = half_precision_unit(splats)
    return server.scene.add_gaussian_splats(
        name,
        centers=splats.centers / unit,
        covariances=fit_half_precision(splats.covariances / unit**2),
        rgbs=splats.rgbs,
        opacities=splats.opacities,
        scale=unit,
    )


def add_layers(server: "viser.ViserServer", contents: Contents) -> None:
    """Add nodes for tampered splats, authentic splats and the heat map, which starts hidden."""
    splats, tampered = contents.splats, contents.score > contents.threshold
    for name, rows in (("tampered", tampered), ("authentic", ~tampered)):
        if rows.any():
            add_splats(server, f"/{name}", splats.take(rows))
    rgbs, _ = layer_colours(splats, contents.score, "heat map", contents.threshold)
    add_splats(server, "/heat map", dataclasses.replace(splats, rgbs=rgbs)).visible = False
