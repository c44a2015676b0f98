"""Incorporation: paste an object onto level ground in view of the cameras.

Ground is found from the points themselves: the vertical column over a place must contain points of
one plane on all sides, and hardly any above them up to the height of the object. The scale of the
object follows from the share of the pixels that it should cover. Objects are upright with up = -y.
"""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark import regions
from gsc_jax.render.spherical_harmonics import rotate
from gsc_jax.scene import Array, Gaussians, InputError
from gsc_jax.scene.gaussians import concatenate, with_degree

PLACES = 96
"""Candidate places, of which the one of least cost is taken."""
RESIZES = 2
"""Corrections of the scale by the share of the pixels that the pasted object really covers."""
SECTORS = 8
"""Angular sectors around a place in each of which there must be ground."""
MAX_COST = 1.0
"""Largest cost of a place that counts as level and free; see `placement_cost`."""


def transformed(
    gaussians: Gaussians, rotation: Array, scale: float, translation: Array
) -> Gaussians:
    """Transform Gaussians and harmonics by x -> s R x + t, R (3, 3); ValueError unless s > 0."""
    if not scale > 0:
        raise ValueError(f"scale must be positive, got {scale}")
    R = np.asarray(rotation, np.float64)
    # The product of quaternions from the left as a matrix: it keeps the lengths of the right ones.
    w, x, y, z = Rotation.from_matrix(R).as_quat(scalar_first=True)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    means = scale * np.asarray(gaussians.means, np.float64) @ R.T + np.asarray(translation)
    log_scales = (np.asarray(gaussians.log_scales) + np.log(scale)).astype(np.float32)
    quats = (np.asarray(gaussians.quats, np.float64) @ left.T).astype(np.float32)
    moved = {"means": means.astype(np.float32), "log_scales": log_scales, "quats": quats}
    return dataclasses.replace(gaussians, **moved, sh=np.asarray(rotate(gaussians.sh, R)))


def paste_object(
    gaussians: Gaussians,
    visibility: regions.Visibility,
    size: float,
    rng: np.random.Generator,
    donor: Gaussians,
) -> regions.ProposedEdit:
    """Paste an object so that it covers `size`, a median share of the pixels; its rows are last."""
    low, high = extent(donor)
    foot, (width, height, depth) = foot_of(low, high), high - low
    radius = 0.5 * np.hypot(width, depth)
    places = regions.draw_seeds(visibility, PLACES, rng)
    area = 0.6 * height * np.sqrt(2) * radius  # an object fills about 0.6 of its bounding box
    pixels = size * visibility.cameras[0].width * visibility.cameras[0].height
    scales = _pixel_sizes(visibility, np.asarray(gaussians.means)[places]) * np.sqrt(pixels / area)
    cost, ground, scale = _best_place(gaussians, visibility, places, scales, (radius, height))
    if cost > MAX_COST:
        raise regions.EditRejected("no level and free ground is in view")
    angle = rng.uniform(0, 360)
    turn = Rotation.from_euler("y", angle, degrees=True).as_matrix()
    rotation = rotation_between(np.array([0, -1.0, 0]), visibility.up) @ turn
    donor = _with_quaternion_lengths_of(gaussians, donor)
    labels = np.arange(len(gaussians) + len(donor)) >= len(gaussians)

    def pasted(scale: float) -> Gaussians:
        placed = transformed(donor, rotation, scale, ground - scale * rotation @ foot)
        # The degree changes last, so that bands that the object lacks are exactly 0.
        return concatenate([gaussians, with_degree(placed, gaussians.sh_degree)])

    for _ in range(RESIZES):
        cameras = visibility.cameras[::2]
        shares = regions.visible_shares(pasted(scale), cameras, labels, near=visibility.near)
        scale *= np.clip(np.sqrt(size / max(regions.median_visible_share(shares), 1e-6)), 0.5, 2)
    what = f"an object of {len(donor):,} Gaussians put into it, turned by {angle:.0f} degrees"
    return regions.ProposedEdit(pasted(scale), labels, what)


def _best_place(
    gaussians: Gaussians,
    visibility: regions.Visibility,
    places: np.ndarray,
    scales: np.ndarray,
    size: tuple[float, float],
) -> tuple[float, np.ndarray, float]:
    """Cost, ground point and scale at the best place; `size`: radius and height at scale 1."""
    means = np.asarray(gaussians.means, np.float64)
    seen = visibility.pixel_share > 0
    points = means[(np.asarray(gaussians.opacities) > 0.5) & seen.any(axis=0)]
    candidates = []
    for row, scale, visible in zip(places, scales, seen[:, places].mean(axis=0), strict=True):
        cost, ground = placement_cost(points, means[row], visibility.up, *scale * np.array(size))
        candidates.append((cost + 0.5 * (1 - visible), ground, scale))
    return min(candidates, key=lambda candidate: candidate[0])


def placement_cost(
    points: np.ndarray, place: np.ndarray, up: np.ndarray, radius: float, height: float
) -> tuple[float, np.ndarray]:
    """Cost of placing an object of this radius and height at one of the points (M, 3).

    It is 0 for level ground on all sides with nothing above, about 1 and more for walls, edges and
    cluttered places. Also returns the point of the ground at the place, shape (3,).
    """
    offsets = points - place
    levels = offsets @ up
    column = np.linalg.norm(offsets - levels[:, None] * up, axis=1) < radius
    offsets, levels = offsets[column], levels[column]
    step = 0.12 * height
    ground = np.abs(levels) < step
    obstacles = np.count_nonzero((levels >= step) & (levels < 1.2 * height))
    frame = np.linalg.svd(offsets[ground] - offsets[ground].mean(axis=0), full_matrices=False)[2]
    horizontal = offsets[ground] @ np.linalg.svd(up[None])[2][1:].T
    outer = horizontal[np.linalg.norm(horizontal, axis=1) > 0.5 * radius]
    sectors = np.floor(np.arctan2(outer[:, 1], outer[:, 0]) * SECTORS / (2 * np.pi)) % SECTORS
    missing = 1 - len(np.unique(sectors)) / SECTORS
    tilt = 1 - abs(frame[-1] @ up) if len(frame) == 3 else 1.0
    cost = obstacles / np.count_nonzero(ground) + missing + 4 * tilt
    return float(cost), place + np.median(levels[ground]) * up


def extent(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of a box around the centres of the opaque Gaussians, shapes (3,).

    The outermost 0.5 % on each side are left out. InputError if there are fewer than ten opaque
    Gaussians, or the box is flat.
    """
    opaque = np.asarray(gaussians.opacities) > 0.5
    means = np.asarray(gaussians.means, np.float64)
    if np.count_nonzero(opaque) < 10:
        raise InputError(f"the object has {np.count_nonzero(opaque)} opaque Gaussians, not enough")
    low, high = np.quantile(means[opaque], [0.005, 0.995], axis=0)
    if not (high > low).all():
        raise InputError("the object has no extent")
    return low, high


def foot_of(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Centre of the lower face of a box, with y down."""
    return np.array([(low[0] + high[0]) / 2, high[1], (low[2] + high[2]) / 2])


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Shortest rotation that maps one unit vector to another, shape (3, 3)."""
    return Rotation.align_vectors(end, start)[0].as_matrix()


def _with_quaternion_lengths_of(scene: Gaussians, donor: Gaussians) -> Gaussians:
    """Normalise the quaternions of the donor if those of the scene are normalised."""
    # Any length is the same rotation, but would reveal the origin of a row.
    lengths = np.linalg.norm(np.asarray(scene.quats), axis=1)
    if np.quantile(np.abs(lengths - 1), 0.9) > 1e-3:
        return donor
    return dataclasses.replace(donor, quats=np.asarray(donor.rotations, np.float32))


def _pixel_sizes(visibility: regions.Visibility, places: np.ndarray) -> np.ndarray:
    """Size of a pixel at places in world units, (P,): the median of the views in front of them."""
    sizes = []
    for camera in visibility.cameras:
        viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
        depth = places @ viewmat[2, :3] + viewmat[2, 3]
        sizes.append(np.where(depth > 0, depth, np.nan) / np.sqrt(K[0, 0] * K[1, 1]))
    return np.nanmedian(sizes, axis=0)
