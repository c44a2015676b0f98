"""What viser shows of an exhibit: its scene, and the panel that decides what is seen of it.

One cloud of splats is sent once; what is seen of it is a matter of its colours and opacities, which
are sent again when they change (32 bytes per Gaussian). Of several clouds, one of them visible, the
browser would keep and sort all.
"""

import dataclasses
import threading
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.cli.viewer.exhibit import Exhibit, counted, legend
from gsc_jax.cli.viewer.poses import Pose
from gsc_jax.cli.viewer.splats import MODES, Mode, fitting_half, half_unit, shown

if TYPE_CHECKING:
    import viser

SPLATS, CAMERAS = "/gaussians", "/cameras"
"""Names of nodes in the viewer's scene."""
FRUSTUM_COLOR = (255, 170, 0)
FRUSTUM_PIXELS = 1.5
STEP = 0.001
"""Of the slider for the threshold."""
FLAT = "Colours do not change with the direction that they are seen from, as they do in the scene."


@dataclasses.dataclass(frozen=True, kw_only=True)
class Nodes:
    """What can be changed of a viewer's scene: the splats, the cameras together, and each."""

    splats: "viser.GaussianSplatHandle"
    cameras: "viser.FrameHandle"
    frustums: "list[viser.CameraFrustumHandle]"


def add_scene(server: "viser.ViserServer", exhibit: Exhibit) -> Nodes:
    """Puts splats, cameras and the first view into a viewer.

    Args:
        server: The viewer.
        exhibit: What it shows.

    Returns:
        What the panel changes.
    """
    scene, first, start = server.scene, server.initial_camera, exhibit.poses[0]
    unit = half_unit(exhibit.splats)
    scene.set_up_direction(exhibit.up)
    scene.world_axes.visible = False
    splats = scene.add_gaussian_splats(
        SPLATS,
        centers=exhibit.splats.centers / unit,
        covariances=fitting_half(exhibit.splats.covariances / unit**2),
        rgbs=exhibit.splats.rgbs,
        opacities=exhibit.splats.opacities,
        scale=unit,
    )
    first.position, first.look_at, first.up = start.position, start.look_at, start.up
    first.fov, first.near, first.far = start.fov, exhibit.near, exhibit.far
    return Nodes(
        splats=splats,
        cameras=scene.add_frame(CAMERAS, show_axes=False),
        frustums=[_frustum(server, exhibit, index) for index in range(len(exhibit.poses))],
    )


def _frustum(
    server: "viser.ViserServer", exhibit: Exhibit, index: int
) -> "viser.CameraFrustumHandle":
    pose = exhibit.poses[index]
    return server.scene.add_camera_frustum(
        f"{CAMERAS}/{index}",
        fov=pose.fov,
        aspect=pose.aspect,
        scale=exhibit.frustum,
        thickness=FRUSTUM_PIXELS,
        thickness_units="screen",
        color=FRUSTUM_COLOR,
        wxyz=pose.wxyz,
        position=pose.position,
        cast_shadow=False,
        receive_shadow=False,
    )


def add_controls(server: "viser.ViserServer", exhibit: Exhibit, nodes: Nodes) -> None:
    """Puts the panel into a viewer: what is shown, the threshold, the cameras, the background.

    Args:
        server: The viewer.
        exhibit: What it shows.
        nodes: What `add_scene` put into it.
    """
    gui, splats = server.gui, nodes.splats
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    gui.add_markdown("\n\n".join(exhibit.said))
    mode = gui.add_dropdown("show", MODES, initial_value=MODES[0], hint=FLAT)
    threshold = gui.add_slider("threshold", 0.0, 1.0, STEP, exhibit.threshold)
    count = gui.add_markdown("")
    gui.add_html(legend())
    background = gui.add_rgb("background", (0, 0, 0))
    _add_cameras(server, exhibit, nodes)
    sent: tuple[Mode, float | None] = MODES[0], None
    lock = threading.Lock()

    def paint(_: object = None) -> None:
        nonlocal sent
        # Each of several changes at once finds the newest values here: the first sends them.
        with lock:
            asked, level = mode.value, threshold.value
            count.content = f"{counted(exhibit.score, level)}."
            wanted = (asked, level if asked.endswith("only") else None)
            if wanted == sent:
                return
            sent = wanted
            rgbs, opacities = shown(exhibit.splats, exhibit.score, asked, level)
            splats.set_gaussians(splats.centers, splats.covariances, rgbs, opacities)

    def fill(_: object = None) -> None:
        server.scene.set_background_image(np.full((1, 1, 3), background.value, np.uint8))

    mode.on_update(paint)
    threshold.on_update(paint)
    background.on_update(fill)
    paint()
    fill()


def _add_cameras(server: "viser.ViserServer", exhibit: Exhibit, nodes: Nodes) -> None:
    """Cameras to jump to: by name, one after the other, or by clicking on them."""
    gui, names = server.gui, [pose.name for pose in exhibit.poses]
    with gui.add_folder("cameras"):
        visible = gui.add_checkbox("visible", True)
        chosen = gui.add_dropdown("camera", names, initial_value=names[0])
        steps = gui.add_button_group("jump", ("previous", "here", "next"))

    def jump(client: "viser.ClientHandle | None", index: int) -> None:
        if client is not None:
            chosen.value = names[index % len(names)]
            look_from(client, exhibit.poses[index % len(names)])

    @visible.on_update
    def _(_: object) -> None:
        nodes.cameras.visible = visible.value

    @chosen.on_update
    def _(event: "viser.GuiEvent") -> None:
        jump(event.client, names.index(chosen.value))

    @steps.on_click
    def _(event: "viser.GuiEvent") -> None:
        step = {"previous": -1, "here": 0, "next": 1}[steps.value]
        jump(event.client, names.index(chosen.value) + step)

    for index, frustum in enumerate(nodes.frustums):
        frustum.on_click(lambda event, index=index: jump(event.client, index))


def look_from(client: "viser.ClientHandle", pose: Pose) -> None:
    """Moves the view of one browser to a camera.

    Args:
        client: The browser.
        pose: The camera.
    """
    with client.atomic():
        client.camera.up_direction = pose.up
        client.camera.position = pose.position
        client.camera.look_at = pose.look_at
        client.camera.fov = pose.fov
