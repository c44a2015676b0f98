"""The standalone page: viser's own client with the scene inside, and a toolbar of ours around it.

viser records scenes, not panels, so the toolbar does in the browser what the server does otherwise,
through what viser's client shows of itself to its own tests (`__viserMutable`: the queue of its
messages). Where another version of the client shows no such thing, the toolbar says so, and the
scene can still be looked at.
"""

import base64
import dataclasses
from importlib.resources import files

import numpy as np

from gsc_jax.cli.viewer.exhibit import Exhibit, legend
from gsc_jax.cli.viewer.panel import FLAT
from gsc_jax.cli.viewer.poses import Pose
from gsc_jax.cli.viewer.splats import MODES, SHADE, heat
from gsc_jax.io.ply import LUMA

LEVELS = 256


def page(client: str, exhibit: Exhibit) -> str:
    """Puts the toolbar into viser's page.

    Args:
        client: HTML of viser's client with the scene inside.
        exhibit: What it shows.

    Returns:
        HTML that asks for nothing from any other place.
    """
    from jinja2 import Environment

    here = files("gsc_jax.cli.viewer")
    template = Environment(autoescape=True).from_string(
        (here / "viewer.html").read_text(encoding="utf-8")
    )
    toolbar = template.render(
        exhibit=exhibit,
        modes=MODES,
        flat=FLAT,
        legend=legend(),
        told=told(exhibit),
        style=(here / "viewer.css").read_text(encoding="utf-8"),
        script=(here / "viewer.js").read_text(encoding="utf-8"),
    )
    head, body = toolbar.split("<!-- body -->")
    client = client.replace("<title>Viser</title>", "", 1)
    # In the client itself are neither of these tags but its own; the scene is base64.
    client = client.replace("<head>", f"<head>{head}", 1)
    end = client.rindex("</body>")
    return client[:end] + body + client[end:]


def told(exhibit: Exhibit) -> dict[str, object]:
    """What the script of the page works with, for JSON.

    Args:
        exhibit: What the page shows.
    """
    colors = np.rint(255 * heat(np.linspace(0, 1, LEVELS)))
    return {
        "scores": base64.b64encode(exhibit.score.astype("<f4").tobytes()).decode(),
        "colors": colors.astype(int).tolist(),
        "shade": SHADE,
        "luma": LUMA.tolist(),
        "poses": [_plain(pose) for pose in exhibit.poses],
    }


def _plain(pose: Pose) -> dict[str, object]:
    fields = dataclasses.asdict(pose)
    return {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in fields.items()
    }
