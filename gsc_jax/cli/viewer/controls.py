"""The scene of the viewer and the panel of the served one, through viser's public API.

The splats are sent once. Layers differ in colours and opacities only, which are sent again when
they change: with one node per layer the browser would store and sort all of them.
"""

import dataclasses
import threading
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.cli.viewer.contents import Contents, count_sentence, legend
from gsc_jax.cli.viewer.selection import LayerInputs, add_selection
from gsc_jax.cli.viewer.splats import LAYERS, Layer, add_splats

if TYPE_CHECKING:
    import viser

STEPS = {"previous": -1, "here": 0, "next": 1}
AT_THRESHOLD: tuple[Layer, ...] = ("result", "tampered only", "authentic only")
"""Layers that depend on the threshold."""
SCORES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""A written page has a layer for the scores between each two of these, in place of a slider."""
SELECTED = np.array([1.0, 0.95, 0.2], np.float32)


def add_viewer(server: "viser.ViserServer", contents: Contents) -> None:
    """Add the scene and the panel to a server."""
    gui = server.gui
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    gui.add_markdown("\n\n".join(contents.sentences))
    add_selection(server, contents, add_layer_controls(server, contents))
    _add_camera_controls(server, contents)


def add_layer_controls(server: "viser.ViserServer", contents: Contents) -> LayerInputs:
    """Add the splats, and inputs that select their layer and threshold."""
    gui = server.gui
    rgbs, _ = contents.colours(LAYERS[0], contents.threshold)
    node = add_splats(server, "/gaussians", dataclasses.replace(contents.splats, rgbs=rgbs))
    layer = gui.add_dropdown("show", LAYERS, initial_value=LAYERS[0])
    threshold = gui.add_slider("threshold", 0.0, 1.0, step=0.001, initial_value=contents.threshold)
    count = gui.add_markdown("")
    gui.add_html(legend())
    lock, selected = threading.Lock(), np.zeros(len(contents.score), bool)
    sent: object = (LAYERS[0], contents.threshold, selected.tobytes())

    def update(_: object = None) -> None:
        nonlocal sent
        # Callbacks run in several threads. The lock orders them, and each reads the newest values:
        # the first to enter sends the result of several quick changes.
        with lock:
            chosen: Layer = layer.value
            count.content = count_sentence(contents.score, threshold.value)
            at = threshold.value if chosen in AT_THRESHOLD else 0.0
            wanted = chosen, at, selected.tobytes()
            if wanted == sent:
                return
            sent = wanted
            rgbs, opacities = contents.colours(chosen, at)
            rgbs = np.where(selected[:, None], SELECTED, rgbs)
            node.set_gaussians(node.centers, node.covariances, rgbs, opacities)

    layer.on_update(update)
    threshold.on_update(update)
    update()
    return LayerInputs(layer, threshold, selected, update)


def _add_camera_controls(server: "viser.ViserServer", contents: Contents) -> None:
    """Jump to the cameras, by name or one after the other."""
    gui, names = server.gui, [pose.name for pose in contents.poses]
    set_first_view(server, contents)
    with gui.add_folder("cameras"):
        chosen = gui.add_dropdown("camera", names, initial_value=names[0])
        steps = gui.add_button_group("jump", list(STEPS))

    def jump(client: "viser.ClientHandle | None", step: int = 0) -> None:
        if client is None:
            return
        pose = contents.poses[(names.index(chosen.value) + step) % len(names)]
        chosen.value = pose.name
        with client.atomic():
            client.camera.up_direction = pose.up
            client.camera.position = pose.position
            client.camera.look_at = pose.look_at
            client.camera.fov = pose.fov

    chosen.on_update(lambda event: jump(event.client))
    steps.on_click(lambda event: jump(event.client, STEPS[steps.value]))


def set_first_view(server: "viser.ViserServer", contents: Contents) -> None:
    """Start at the first camera."""
    first, start = server.initial_camera, contents.poses[0]
    server.scene.set_up_direction(contents.up)
    server.scene.world_axes.visible = False
    first.position, first.look_at, first.up = start.position, start.look_at, start.up
    first.fov, first.near, first.far = start.fov, contents.near, contents.far


def add_layers(server: "viser.ViserServer", contents: Contents) -> None:
    """Add layers of the tampered and the authentic splats, and a heat map, hidden at first."""
    tampered, splats = contents.score > contents.threshold, contents.splats
    band = np.digitize(contents.score, SCORES[1:-1])
    result, heat_map = (
        dataclasses.replace(splats, rgbs=contents.colours(layer, contents.threshold)[0])
        for layer in ("result", "heat map")
    )
    for name, rows in (("tampered", tampered), ("authentic", ~tampered)):
        for k in np.unique(band[rows]):
            scores = f"score {SCORES[k]:g} to {SCORES[k + 1]:g}"
            add_splats(server, f"/{name}/{scores}", result.take(rows & (band == k)))
    add_splats(server, "/heat map", heat_map).visible = False
