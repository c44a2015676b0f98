"""A straightforward rasteriser in JAX, as a baseline of `benchmarks/splat.py`.

It has the layout of the CUDA rasterisers: textbook projection and 16 x 16 tiles one at a time. It
is jitted, binned with vectorised NumPy, stops early, and gives the same pixels as the library.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene import Array, Camera, Gaussians

TILE = 16
CHUNK = 32
MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE = 1 / 255, 0.99, 1e-4


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["splats", "ids", "starts", "counts"],
    meta_fields=["width", "height"],
)
@dataclasses.dataclass(frozen=True)
class PlainView:
    """Splats (N + 1, 6) as mean, conic, opacity; and the list of every tile, in row-major order."""

    splats: Array
    ids: Array
    starts: Array
    counts: Array
    width: int
    height: int

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return -(-self.height // TILE), -(-self.width // TILE)


def project(gaussians: Gaussians, camera: Camera, *, near: float = 0.2):
    """Means, conics, extents (half the box around alpha = 1/255), opacities, depths, visible."""
    size = camera.width, camera.height
    return _project(gaussians, camera.viewmat, camera.K, near, size)


@functools.partial(jax.jit, static_argnames="size")
def _project(gaussians, viewmat, K, near, size):
    width, height = size
    points = gaussians.means @ viewmat[:3, :3].T + viewmat[None, :3, 3]
    visible = points[:, 2] > near
    x, y, z = points[:, 0], points[:, 1], jnp.where(visible, points[:, 2], 1.0)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    u = jnp.clip(x / z, -cx / fx - 0.15 * width / fx, (width - cx) / fx + 0.15 * width / fx)
    v = jnp.clip(y / z, -cy / fy - 0.15 * height / fy, (height - cy) / fy + 0.15 * height / fy)
    zero = jnp.zeros_like(z)
    jacobian = jnp.stack([fx / z, zero, -fx * u / z, zero, fy / z, -fy * v / z], -1)
    to_image = jacobian.reshape(-1, 2, 3) @ viewmat[:3, :3]
    axes = _rotations(gaussians.rotations) * gaussians.scales[:, None, :]
    world = jnp.einsum("nij,nkj->nik", axes, axes)
    cov = jnp.einsum("nij,njk,nlk->nil", to_image, world, to_image) + 0.3 * jnp.eye(2)[None]
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    conics = jnp.stack([c, -b, a], -1) / (a * c - b * b)[:, None]
    means = jnp.stack([fx * x / z + cx, fy * y / z + cy], -1)
    opacities = gaussians.opacities
    reach = 2 * jnp.log(jnp.maximum(opacities / MIN_ALPHA, 1.0))
    extents = jnp.sqrt(reach[:, None] * jnp.stack([a, c], -1))
    return means, conics, extents, opacities, points[:, 2], visible & (reach > 0)


def _rotations(quats):
    w, x, y, z = quats.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def bin_splats(projected, camera: Camera) -> PlainView:
    """Give every splat to all tiles of its bounding box, then sort by tile and depth."""
    means, conics, extents, opacities, depths, visible = projected
    rows, columns = -(-camera.height // TILE), -(-camera.width // TILE)
    center, extent = np.asarray(means), np.asarray(extents)
    limit = np.array([columns, rows])
    low = np.clip(np.floor((center - extent) / TILE), 0, limit).astype(int)
    high = np.clip(np.ceil((center + extent) / TILE), 0, limit).astype(int)
    wide, high = (np.where(np.asarray(visible)[:, None], high - low, 0)).T
    owner = np.repeat(np.arange(len(center)), wide * high)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    tile = (low[owner, 1] + place // wide[owner]) * columns + low[owner, 0] + place % wide[owner]
    order = np.lexsort([np.asarray(depths)[owner], tile])
    counts = np.bincount(tile, minlength=rows * columns)
    ids = owner[order].astype(np.int32)
    size = 1 << max(12, int(np.ceil(np.log2(max(1, len(ids))))))
    splats = jnp.concatenate([means, conics, opacities[:, None]], axis=1)
    return PlainView(
        splats=jnp.pad(splats, ((0, 1), (0, 0))),
        ids=jnp.asarray(np.pad(ids, (0, size - len(ids)))),
        starts=jnp.asarray((np.cumsum(counts) - counts).astype(np.int32)),
        counts=jnp.asarray(counts.astype(np.int32)),
        width=camera.width,
        height=camera.height,
    )


def _walk(view: PlainView, tile, visit, carry):
    """Walk the list of one tile; `visit(carry, ids, weights)` sees (C,) and (C, pixels)."""
    y, x = jnp.divmod(jnp.arange(TILE * TILE), TILE)
    x, y = (x + tile % view.grid[1] * TILE + 0.5, y + tile // view.grid[1] * TILE + 0.5)
    empty = view.splats.shape[0] - 1

    def advance(state):
        step, light, carry = state
        place = step * CHUNK + jnp.arange(CHUNK)
        ids = jnp.where(place < view.counts[tile], view.ids[view.starts[tile] + place], empty)
        mx, my, a, b, c, opacity = view.splats[ids].T
        dx, dy = x[None] - mx[:, None], y[None] - my[:, None]
        sigma = 0.5 * (a[:, None] * dx**2 + c[:, None] * dy**2) + b[:, None] * dx * dy
        alpha = jnp.minimum(MAX_ALPHA, opacity[:, None] * jnp.exp(-sigma))
        alpha = jnp.where((alpha >= MIN_ALPHA) & (sigma >= 0), alpha, 0.0)
        behind = light[None] * jnp.cumprod(1 - alpha, axis=0)
        before = jnp.concatenate([light[None], behind[:-1]])
        weights = jnp.where(behind >= MIN_TRANSMITTANCE, alpha * before, 0.0)
        return step + 1, behind[-1], visit(carry, ids, weights)

    def unfinished(state):
        step, light, _ = state
        return (step * CHUNK < view.counts[tile]) & jnp.any(light >= MIN_TRANSMITTANCE)

    start = (jnp.int32(0), jnp.ones(TILE * TILE), carry)
    return jax.lax.while_loop(unfinished, advance, start)[2]


@jax.jit
def composite(view: PlainView, features: jax.Array) -> jax.Array:
    """W c, as `gsc_jax.splat.composite`."""
    padded = jnp.pad(features, ((0, 1), (0, 0)))
    rows, columns = view.grid

    def blend(tile):
        blank = jnp.zeros((TILE * TILE, features.shape[1]))
        return _walk(view, tile, lambda image, ids, weights: image + weights.T @ padded[ids], blank)

    tiles = jax.lax.map(blend, jnp.arange(rows * columns))
    cells = tiles.reshape(rows, columns, TILE, TILE, -1).transpose(0, 2, 1, 3, 4)
    return cells.reshape(rows * TILE, columns * TILE, -1)[: view.height, : view.width]


@jax.jit
def accumulate(view: PlainView, maps: jax.Array) -> jax.Array:
    """W^t m, as `gsc_jax.splat.accumulate`."""
    rows, columns = view.grid
    margin = ((0, rows * TILE - view.height), (0, columns * TILE - view.width), (0, 0))
    cells = jnp.pad(maps, margin).reshape(rows, TILE, columns, TILE, -1)
    tiles = cells.transpose(0, 2, 1, 3, 4).reshape(rows * columns, TILE * TILE, -1)

    def gather(sums, tile):
        def visit(sums, ids, weights):
            return sums.at[ids].add(weights @ tiles[tile])

        return _walk(view, tile, visit, sums), None

    sums = jnp.zeros((view.splats.shape[0], maps.shape[2]))
    return jax.lax.scan(gather, sums, jnp.arange(rows * columns))[0][:-1]
