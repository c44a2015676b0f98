"""The page of the 3D view: viser's client with the splats inside, and our panel (viewer.js)."""

import base64
import warnings
from importlib.resources import files

import numpy as np

from gsc_jax.cli.pictures import CANDIDATE, TINT, TINT_STRENGTH
from gsc_jax.cli.viewer.contents import Contents
from gsc_jax.cli.viewer.splats import add_splats, half_precision_unit
from gsc_jax.io.ply import LUMA

IN_MOTION = 10_000
"""Gaussians that a browser without a graphics card draws while the camera moves."""


def viewer_page(contents: Contents) -> str:
    """A page that needs neither server nor network. It needs the extra `viewer`."""
    from jinja2 import Environment

    names = ("viewer.html", "ply.js", "picking.js", "motion.js", "viewer.js")
    sources = [files("gsc_jax.cli.viewer").joinpath(name).read_text("utf-8") for name in names]
    unit = half_precision_unit(contents.splats)
    page = Environment(autoescape=True).from_string(sources[0])
    return page.render(
        contents=contents,
        few=IN_MOTION,
        tint=f"rgb{tuple(_tint(contents))}",
        gradient=", ".join(f"rgb{tuple(colour)}" for colour in _heat(9)),
        data={"facts": _facts(contents, unit), "client": _client(contents, unit)},
        script="\n".join(sources[1:]),
    )


def _facts(contents: Contents, unit: float) -> dict:
    """What viewer.js knows of the scene beside what viser's client holds."""
    arrays = contents.score, contents.rows.astype("<u4"), contents.splats.scales
    return {
        "title": contents.title,
        "total": contents.total,
        "few": IN_MOTION,
        "traces": {name: np.flatnonzero(has).tolist() for name, has in contents.traces.items()},
        "unit": unit,
        "poses": [[np.ravel(part).tolist() for part in pose[1:]] for pose in contents.poses],
        "tint": _tint(contents),
        "tint_strength": TINT_STRENGTH,
        "luma": np.asarray(LUMA, float).tolist(),
        "heat": _heat(256),
        "arrays": [base64.b64encode(x.tobytes()).decode() for x in arrays],
    }


def _tint(contents: Contents) -> list[int]:
    """Colour of the labelled Gaussians, 0 to 255."""
    return np.rint(255 * (CANDIDATE if contents.candidates else TINT)).astype(int).tolist()


def _heat(count: int) -> list[list[int]]:
    """RGB colours of the heat map, 0 to 255, from score 0 to score 1, which is lighter."""
    from matplotlib import colormaps

    # Viridis has even steps for the eye, also for colour-blind readers.
    return np.rint(255 * colormaps["viridis"](np.linspace(0, 1, count))[:, :3]).astype(int).tolist()


def _client(contents: Contents, unit: float) -> str:
    """The page of viser's client, with the splats inside, at the first camera."""
    import rich
    import viser

    rich.reconfigure(quiet=True)  # viser prints with rich
    server = viser.ViserServer(host="127.0.0.1", port=0, label="gsc-jax", verbose=False)
    server.stop()  # before it has content: other programs could read it
    first, start = server.initial_camera, contents.poses[0]
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # that nobody listens
        add_splats(server, "/gaussians", contents.splats, unit)
        server.scene.set_up_direction(contents.up)
        server.scene.world_axes.visible = False
        first.position, first.look_at, first.up = start.position, start.look_at, start.up
        first.fov, first.near, first.far = start.fov, contents.near, contents.far
        return server.scene.as_html(dark_mode=True)
