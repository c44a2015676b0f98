"""The written page: viser's standalone client in a frame, under a bar that selects the camera.

viser reads the first view from the address of its page (`?initialCameraPosition=...`). The page
therefore loads itself into the frame with such an address, and there replaces itself by the client.
The frame is sandboxed, since browsers refuse the client's workers in pages opened from a file.
"""

from importlib.resources import files
from urllib.parse import urlencode

import numpy as np

from gsc_jax.cli.viewer.contents import Contents, Pose, legend


def viewer_page(client: str, contents: Contents) -> str:
    """Render a page without server and network; `client` is viser's page, with the scene inside."""
    from jinja2 import Environment

    template = files("gsc_jax.cli.viewer").joinpath("viewer.html").read_text(encoding="utf-8")
    return (
        Environment(autoescape=True)
        .from_string(template)
        .render(
            contents=contents,
            views=[(pose.name, _address(pose, contents)) for pose in contents.poses],
            legend=legend(),
            client=client,
        )
    )


def _address(pose: Pose, contents: Contents) -> str:
    """Query string with which viser starts at a camera."""
    vectors = {"Position": pose.position, "LookAt": pose.look_at, "Up": pose.up}
    scalars = {"Fov": pose.fov, "Near": contents.near, "Far": contents.far}
    values = {key: ",".join(map(str, np.asarray(value).tolist())) for key, value in vectors.items()}
    values |= {key: str(float(value)) for key, value in scalars.items()}
    return urlencode({f"initialCamera{key}": value for key, value in values.items()}, safe=",")
