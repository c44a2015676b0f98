"""Selection in the served viewer: a click describes a Gaussian, boxes collect some for a file."""

import html
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gsc_jax.cli.results import read_by_row, result_file
from gsc_jax.cli.viewer.contents import Contents, version
from gsc_jax.cli.viewer.splats import Layer, Splats
from gsc_jax.io.ply import read_ply, save_tampered
from gsc_jax.render.projection import MIN_ALPHA
from gsc_jax.scene import InputError

if TYPE_CHECKING:
    import viser

HINT = "Click a Gaussian to see its values. Press Shift and drag a box to select what is in it."
PARTS = ("all but labelled", "only labelled", "all but selected", "only selected")


class LayerInputs(NamedTuple):
    """The inputs that select a layer, marked Gaussians (N,) bool, and a function to draw both."""

    layer: "viser.GuiDropdownHandle[Layer]"
    threshold: "viser.GuiInputHandle[float]"
    selected: np.ndarray
    update: Callable[[], None]


def add_selection(server: "viser.ViserServer", contents: Contents, inputs: LayerInputs) -> None:
    """Add clicks, boxes, and exports of parts of the scene to a server."""
    gui, selected, lock = server.gui, inputs.selected, threading.Lock()
    with gui.add_folder("selection"):
        text = gui.add_markdown(HINT)
        clear = gui.add_button("clear selection")
        part = gui.add_dropdown("part", PARTS)
        export = gui.add_button("export .ply")

    def visible() -> np.ndarray:
        return contents.colours(inputs.layer.value, inputs.threshold.value)[1][:, 0]

    def select(rows: np.ndarray | None) -> None:
        with lock:
            selected[:] = False if rows is None else selected | rows
            text.content = f"{int(selected.sum()):,} Gaussians are selected. {HINT}"
        inputs.update()

    @server.scene.on_click()
    def _(event: "viser.SceneClickEvent") -> None:
        index = hit(contents.splats, visible(), event.ray_origin, event.ray_direction)
        text.content = HINT if index is None else describe(contents, index)

    @server.scene.on_rect_select(modifier="shift")
    def _(event: "viser.SceneRectSelectEvent") -> None:
        places = on_screen(contents.splats.centers, event.client.camera)
        inside = ((places >= event.screen_min) & (places <= event.screen_max)).all(axis=1)
        select(inside & (visible() > 0))

    clear.on_click(lambda _: select(None))

    @export.on_click
    def _(event: "viser.GuiEvent") -> None:
        try:
            with lock:  # one at a time: each takes the memory of the whole scene
                content = exported(contents, part.value, selected, inputs.threshold.value)
        except (InputError, OSError) as error:
            text.content = html.escape(str(error))
            return
        if event.client is not None:
            name = f"{contents.title} {part.value}.ply".replace(" ", "_")
            event.client.send_file_download(name, content)


def hit(
    splats: Splats, opacities: np.ndarray, origin: ArrayLike, direction: ArrayLike
) -> int | None:
    """The splat of largest blending weight along a ray; None if it hits none.

    `opacities`, (N,), are those that are drawn.
    """
    offset = splats.centers - np.asarray(origin)
    basis = np.linalg.svd(np.asarray(direction)[None])[2]  # along the ray, and across it
    depth, across = offset @ basis[0] * np.sign(basis[0] @ direction), offset @ basis[1:].T
    plane = basis[1:] @ splats.covariances @ basis[1:].T
    spread = np.trace(plane, axis1=1, axis2=2)[:, None, None]
    plane += np.eye(2) * (1e-6 * spread + 1e-30)
    squared = (across * np.linalg.solve(plane, across[:, :, None])[..., 0]).sum(axis=1)
    alpha = opacities * np.exp(-0.5 * squared)
    ahead = np.flatnonzero((depth > 0) & (alpha > MIN_ALPHA))
    order = ahead[np.argsort(depth[ahead])]
    weights = alpha[order] * np.cumprod(np.append(1, 1 - alpha[order]))[:-1]
    return int(order[np.argmax(weights)]) if len(order) else None


def on_screen(points: np.ndarray, camera: "viser.CameraHandle") -> np.ndarray:
    """Places on the screen, (0, 0) to (1, 1), of points (N, 3); NaN behind the camera."""
    rotation = Rotation.from_quat(camera.wxyz, scalar_first=True)
    x, y, z = ((points - camera.position) @ rotation.as_matrix()).T
    z = np.where(z > 0, z, np.nan)
    half = np.tan(camera.fov / 2)
    return 0.5 + np.stack([x / (half * camera.aspect), y / half], axis=1) / (2 * z[:, None])


def describe(contents: Contents, index: int) -> str:
    """Values of a Gaussian as a table in Markdown."""
    splats = contents.splats
    facts = {
        "row": f"{contents.rows[index]:,}",
        "score": f"{contents.score[index]:.3f}",
        "position": _numbers(splats.centers[index]),
        "scales": _numbers(splats.scales[index]),
        "opacity": f"{splats.opacities[index, 0]:.3f}",
        "colour": _numbers(splats.rgbs[index]),
    }
    lines = [f"| {name} | {value} |" for name, value in facts.items()]
    return "\n".join(["| Gaussian | |", "|---|---|", *lines])


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def exported(contents: Contents, part: str, selected: np.ndarray, threshold: float) -> bytes:
    """The .ply of the results with one of its `PARTS`.

    Labelled are Gaussians with a score above the threshold; `selected`, (N,) bool, are splats.
    InputError if the part is empty, or the results have changed.
    """
    if contents.version != version(contents.folder):
        raise InputError(f"{contents.folder}: has new results; start gsc-jax view again")
    scene = read_ply(result_file(contents.folder, "tamper.ply"), max_bytes=contents.max_bytes)
    scores = read_by_row(result_file(contents.folder, "tamper.npy"), scene.total)
    chosen = scores > threshold
    if part.endswith("selected"):
        chosen = np.isin(np.arange(scene.total), contents.rows[selected])
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "part.ply"
        save_tampered(path, scene, scores[scene.rows], keep=chosen == part.startswith("only"))
        return path.read_bytes()
