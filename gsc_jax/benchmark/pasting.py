"""Incorporation: an object from elsewhere, stood on level ground that the cameras look at.

Ground is looked for in the points themselves: in the column over a place there must be points at
its level on all sides, in a plane, and next to none above as far as the object reaches. How large
the object becomes follows from how large it then appears. Objects are upright with up = -y.
"""

import dataclasses

import numpy as np

from gsc_jax.benchmark.draft import Draft, Unsuitable, visible_shares
from gsc_jax.benchmark.regions import Sight, pick, typical_share
from gsc_jax.benchmark.scenes import concatenate
from gsc_jax.render.spherical_harmonics import rotate
from gsc_jax.scene import Array, Gaussians

PLACES = 96
"""Places that an attempt chooses from."""
RESIZES = 2
"""How often the scale is corrected after a look at the object in place."""
SECTORS = 8
"""Sides on which there must be ground."""
MAX_COST = 1.0
"""Of a place that is still level and free enough; see `standing_cost`."""


def transformed(
    gaussians: Gaussians, rotation: Array, scale: float, translation: Array
) -> Gaussians:
    """Move Gaussians by a similarity x -> scale R x + t, their harmonics with them.

    Args:
        gaussians: N Gaussians.
        rotation: R, shape (3, 3).
        scale: Positive factor.
        translation: t in world units, shape (3,).

    Returns:
        The moved Gaussians, float32.

    Raises:
        ValueError: if the scale is not positive.
    """
    from scipy.spatial.transform import Rotation

    if not scale > 0:
        raise ValueError(f"scale must be positive, got {scale}")
    R = np.asarray(rotation, np.float64)
    turn = Rotation.from_matrix(R).as_quat(scalar_first=True)
    means = scale * np.asarray(gaussians.means, np.float64) @ R.T + np.asarray(translation)
    return dataclasses.replace(
        gaussians,
        means=means.astype(np.float32),
        log_scales=(np.asarray(gaussians.log_scales) + np.log(scale)).astype(np.float32),
        quats=_times(turn, np.asarray(gaussians.quats, np.float64)).astype(np.float32),
        sh=np.asarray(rotate(gaussians.sh, R)),
    )


def set_upright(thing: Gaussians, up: np.ndarray) -> Gaussians:
    """A thing of a scene with this vertical, with up = -y and the middle of its foot at 0."""
    upright = transformed(thing, turn_between(up, np.array([0, -1.0, 0])), 1.0, np.zeros(3))
    return transformed(upright, np.eye(3), 1.0, -foot_of(*extent(upright)))


def incorporated(
    gaussians: Gaussians, sight: Sight, donor: Gaussians, size: float, rng: np.random.Generator
) -> Draft:
    """Stand an object into a scene.

    Args:
        gaussians: N Gaussians of the scene.
        sight: What the cameras see of them.
        donor: M Gaussians of the object.
        size: Median share of the pixels that it is to cover.
        rng: Source of randomness.

    Returns:
        The N + M Gaussians, the object last.

    Raises:
        ValueError: if the object is next to empty.
        Unsuitable: if none of the places tried is level and free.
    """
    low, high = extent(donor)
    foot, (width, height, depth) = foot_of(low, high), high - low
    radius = 0.5 * np.hypot(width, depth)
    places = pick(sight, PLACES, rng)
    # An object fills about 0.6 of its frame.
    area = 0.6 * height * np.sqrt(2) * radius
    pixels = size * sight.cameras[0].width * sight.cameras[0].height
    scales = _pixel_sizes(sight, np.asarray(gaussians.means)[places]) * np.sqrt(pixels / area)
    cost, ground, scale = _best_stand(gaussians, sight, places, scales, radius, height)
    if cost > MAX_COST:
        raise Unsuitable("no level and free ground is in view")
    angle = rng.uniform(0, 360)
    turn = turn_between(np.array([0, -1.0, 0]), sight.up) @ _about_y(np.radians(angle))
    donor = _in_the_manner_of(gaussians, donor)
    labels = np.arange(len(gaussians) + len(donor)) >= len(gaussians)

    def stood(scale: float) -> Gaussians:
        pasted = transformed(donor, turn, scale, ground - scale * turn @ foot)
        # After the turn, so that bands that the object does not have are exactly 0.
        return concatenate([gaussians, of_degree(pasted, gaussians.sh_degree)])

    for _ in range(RESIZES):
        appears = typical_share(
            visible_shares(stood(scale), sight.cameras[::2], labels, near=sight.near)
        )
        scale *= np.clip(np.sqrt(size / max(appears, 1e-6)), 0.5, 2)
    what = f"an object of {len(donor):,} Gaussians stood into it, turned by {angle:.0f} degrees"
    return Draft(stood(scale), labels, what)


def _best_stand(
    gaussians: Gaussians,
    sight: Sight,
    places: np.ndarray,
    scales: np.ndarray,
    radius: float,
    height: float,
) -> tuple[float, np.ndarray, float]:
    """Cost, point of the ground and scale at the fittest of the places, which are rows."""
    means = np.asarray(gaussians.means, np.float64)
    seen = sight.shares > 0
    points = means[(np.asarray(gaussians.opacities) > 0.5) & seen.any(axis=0)]
    stands = []
    for row, scale, often in zip(places, scales, seen[:, places].mean(axis=0), strict=True):
        sizes = radius * scale, height * scale
        cost, ground = standing_cost(points, means[row], sight.up, *sizes)
        stands.append((cost + 0.5 * (1 - often), ground, scale))
    return min(stands, key=lambda stand: stand[0])


def standing_cost(
    points: np.ndarray, place: np.ndarray, up: np.ndarray, radius: float, height: float
) -> tuple[float, np.ndarray]:
    """How unfit a place is for an object to stand on.

    Args:
        points: What is opaque and seen, shape (M, 3).
        place: One of them, shape (3,).
        up: The vertical, unit vector, shape (3,).
        radius: Of the foot of the object.
        height: Of the object.

    Returns:
        The cost: 0 for level ground on all sides with nothing above, about 1 and more for walls,
        edges and cluttered places. And the point of the ground under the place.
    """
    offsets = points - place
    levels = offsets @ up
    column = np.linalg.norm(offsets - levels[:, None] * up, axis=1) < radius
    offsets, levels = offsets[column], levels[column]
    step = 0.12 * height
    ground = np.abs(levels) < step
    obstacles = np.count_nonzero((levels >= step) & (levels < 1.2 * height))
    frame = np.linalg.svd(offsets[ground] - offsets[ground].mean(axis=0), full_matrices=False)[2]
    side = np.linalg.svd(up[None])[2][1:]
    flat = offsets[ground] @ side.T
    outer = flat[np.linalg.norm(flat, axis=1) > 0.5 * radius]
    angles = np.arctan2(outer[:, 1], outer[:, 0])
    sectors = np.floor(angles * SECTORS / (2 * np.pi)) % SECTORS
    missing = 1 - len(np.unique(sectors)) / SECTORS
    tilt = 1 - abs(frame[-1] @ up) if len(frame) == 3 else 1.0
    cost = obstacles / np.count_nonzero(ground) + missing + 4 * tilt
    return float(cost), place + np.median(levels[ground]) * up


def extent(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that holds what is opaque, but for the last percent at every side."""
    opaque = np.asarray(gaussians.opacities) > 0.5
    means = np.asarray(gaussians.means, np.float64)
    if np.count_nonzero(opaque) < 10:
        raise ValueError(f"the object has {np.count_nonzero(opaque)} opaque Gaussians, not enough")
    low, high = np.quantile(means[opaque], [0.005, 0.995], axis=0)
    if not (high > low).all():
        raise ValueError("the object has no extent")
    return low, high


def foot_of(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The middle of the lower face of a box, y down."""
    return np.array([(low[0] + high[0]) / 2, high[1], (low[2] + high[2]) / 2])


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotation that takes one unit vector to another, shape (3, 3)."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis), start @ end
    if sine < 1e-9:
        # Opposite directions: any half turn about an axis across them will do.
        across = np.linalg.svd(start[None])[2][1]
        return Rotation.from_rotvec(np.pi * across * (cosine < 0)).as_matrix()
    return Rotation.from_rotvec(np.arctan2(sine, cosine) * axis / sine).as_matrix()


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def of_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """The Gaussians with harmonics of this degree: cut off, or zeros appended."""
    wanted, sh = (degree + 1) ** 2, np.asarray(gaussians.sh)[:, : (degree + 1) ** 2]
    padded = np.pad(sh, ((0, 0), (0, wanted - sh.shape[1]), (0, 0)))
    return dataclasses.replace(gaussians, sh=padded)


def _in_the_manner_of(scene: Gaussians, thing: Gaussians) -> Gaussians:
    """The thing with quaternions of unit length where those of the scene are.

    Any length is the same rotation, but would tell where a row comes from.
    """
    lengths = np.linalg.norm(np.asarray(scene.quats), axis=1)
    if np.quantile(np.abs(lengths - 1), 0.9) > 1e-3:
        return thing
    return dataclasses.replace(thing, quats=np.asarray(thing.rotations, np.float32))


def _pixel_sizes(sight: Sight, places: np.ndarray) -> np.ndarray:
    """How large a pixel is at places, in world units, (P,): the median of the views before them."""
    sizes = []
    for camera in sight.cameras:
        viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
        depth = places @ viewmat[2, :3] + viewmat[2, 3]
        sizes.append(np.where(depth > 0, depth, np.nan) / np.sqrt(K[0, 0] * K[1, 1]))
    return np.nanmedian(sizes, axis=0)


def _times(turn: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """The product of a quaternion with each of many, wxyz; lengths stay."""
    w, x, y, z = turn
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return quats @ left.T
