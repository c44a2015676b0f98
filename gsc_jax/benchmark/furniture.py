"""Textured surfaces of the made room and of its foreign object.

Metres, y down; the room is centred on the origin with its floor at y = 0, walls on all sides and no
ceiling. A finely sampled surface in front of a coarse one (pictures, rug) is separated from it by a
gap or a hole, since the wide Gaussians of the coarse one would show through.
"""

import numpy as np

from gsc_jax.benchmark.surfaces import (
    FRONT,
    RIGHT,
    Part,
    Surface,
    Texture,
    box,
    cylinder,
    ellipsoid,
    flat,
    panel,
    revolve,
)

WIDTH, DEPTH, HEIGHT = 4.4, 4.0, 2.7
TABLE = 0.74

PLASTER = Texture("gravel.png", (1.5, 1.42, 1.25), (3, 2), contrast=0.12)
BRICK = Texture("brick.png", (1.6, 1.0, 0.78), (1, 0.6))
PARQUET = Texture("brick.png", (1.6, 1.15, 0.75), contrast=0.8)
OAK = Texture("gravel.png", (1.35, 0.85, 0.5), (0.3, 3), contrast=0.35)
WALNUT = Texture("gravel.png", (0.75, 0.45, 0.3), (0.3, 3), contrast=0.4)
STEEL = Texture("gravel.png", (0.5, 0.5, 0.55), contrast=0.2)
PAPER = Texture("page.png", (1.5, 1.4, 1.1), (3, 1))
CLOTH = Texture("grass.png", (0.55, 0.9, 0.95), (1.5, 1.5), contrast=0.6)


def room_parts(rng: np.random.Generator) -> list[Part]:
    """Floor, walls and furniture of the room, with random books."""
    parts = [*_shell(), *_table(), *_chair(0.15, 0.6, 1), *_chair(-0.3, -0.6, -1), *_sofa()]
    return [*parts, *_cabinet_and_lamp(), *_shelf(rng), *_pictures()]


def vase_parts() -> list[Part]:
    """Vase with two handles and a finial, 0.6 m high, standing on the origin."""
    height = np.array([0, 0.03, 0.07, 0.16, 0.26, 0.34, 0.39, 0.45, 0.47])
    radius = np.array([0.09, 0.09, 0.06, 0.135, 0.175, 0.15, 0.08, 0.075, 0.11])
    fine = np.linspace(0, height[-1], 97)
    body = np.stack([np.interp(fine, height, radius), fine], axis=-1)
    ring = np.linspace(0, 2 * np.pi, 33)
    tube = np.stack([0.075 + 0.019 * np.cos(ring), 0.019 * np.sin(ring)], axis=-1)
    gold = Texture("gravel.png", (1.7, 1.25, 0.35), contrast=0.5)
    return [
        Part(revolve(body, (0, 0, 0)), Texture("ihc.png", repeat=(3, 1))),
        Part(revolve(tube, (-0.16, -0.34, 0), axis=2), gold),
        Part(revolve(tube, (0.16, -0.34, 0), axis=2), gold),
        Part(ellipsoid((0, -0.52, 0), 0.08, 0.16), gold),
    ]


def _parts(surfaces: list[Surface], texture: Texture, detail: float = 3.0) -> list[Part]:
    return [Part(surface, texture, detail) for surface in surfaces]


def _shell() -> list[Part]:
    wall = -HEIGHT / 2
    return [
        *_floor(2.4, 1.8),
        Part(panel((0, wall, DEPTH / 2), FRONT, WIDTH, HEIGHT), BRICK, 0.6),
        Part(panel((0, wall, -DEPTH / 2), -FRONT, WIDTH, HEIGHT), PLASTER, 0.3),
        Part(panel((WIDTH / 2, wall, 0), -RIGHT, DEPTH, HEIGHT), PLASTER, 0.3),
        Part(panel((-WIDTH / 2, wall, 0), RIGHT, DEPTH, HEIGHT), PLASTER, 0.3),
    ]


def _floor(width: float, depth: float) -> list[Part]:
    """Rug of this size in the middle, and boards around it but not under it."""
    beside, before = (WIDTH - width) / 2, (DEPTH - depth) / 2
    strips = [(side * (width + beside) / 2, 0, beside, DEPTH) for side in (-1, 1)]
    strips += [(0, side * (depth + before) / 2, width, before) for side in (-1, 1)]
    boards = [
        Part(flat((x, 0, z), w, d), PARQUET._replace(repeat=(w / 1.5, d / 1.5)))
        for x, z, w, d in strips
    ]
    rug = Texture("ihc.png", (0.9, 0.5, 0.45), (2, 1.5))
    return [*boards, Part(flat((0, -0.01, 0), width, depth), rug, 1.5)]


def _table() -> list[Part]:
    legs = [(x, 0, z) for x in (-0.6, 0.6) for z in (-0.35, 0.35)]
    bowl = np.array([[0.05, 0], [0.11, 0.04], [0.14, 0.09], [0.13, 0.09], [0.1, 0.045], [0, 0.01]])
    fine = np.linspace(0, 5, 41)
    bowl = np.stack([np.interp(fine, np.arange(6), column) for column in bowl.T], axis=-1)
    return [
        *_parts(box((0, -TABLE + 0.04, 0), 1.35, 0.04, 0.85), OAK, 4.0),
        *(part for leg in legs for part in _parts(box(leg, 0.06, TABLE - 0.04, 0.06), OAK)),
        Part(revolve(bowl, (-0.35, -TABLE, 0.1)), Texture("moon.png", (0.9, 1.3, 1.9)), 8.0),
        *_parts(box((-0.25, -TABLE, -0.25), 0.3, 0.035, 0.21), Texture("page.png"), 8.0),
        Part(cylinder((0.45, -TABLE, -0.2), 0.04, 0.045, 0.1), Texture("coins.png"), 8.0),
    ]


def _chair(x: float, z: float, back: int) -> list[Part]:
    legs = [(x + i, 0, z + j) for i in (-0.19, 0.19) for j in (-0.19, 0.19)]
    return [
        *(part for leg in legs for part in _parts(box(leg, 0.04, 0.44, 0.04), WALNUT)),
        *_parts(box((x, -0.44, z), 0.44, 0.04, 0.44), CLOTH),
        *_parts(box((x, -0.55, z + 0.2 * back), 0.44, 0.4, 0.04), WALNUT),
    ]


def _sofa() -> list[Part]:
    return [
        *_parts(box((-1.72, -0.1, 0), 0.9, 0.32, 2.0), CLOTH, 2.0),
        *_parts(box((-2.06, -0.4, 0), 0.22, 0.45, 2.0), CLOTH, 2.0),
        *_parts(box((-1.72, -0.1, 1.0), 0.9, 0.5, 0.2), CLOTH, 2.0),
        *_parts(box((-1.72, -0.1, -1.0), 0.9, 0.5, 0.2), CLOTH, 2.0),
        Part(ellipsoid((-1.8, -0.58, 0.6), 0.2, 0.34), Texture("coffee.png"), 4.0),
        Part(ellipsoid((-1.8, -0.58, -0.55), 0.2, 0.34), Texture("chelsea.png"), 4.0),
    ]


def _cabinet_and_lamp() -> list[Part]:
    shade = np.stack([np.linspace(0.24, 0.14, 17), np.linspace(0, 0.3, 17)], axis=-1)
    return [
        *_parts(box((1.95, -0.08, 0.3), 0.42, 0.7, 1.4), WALNUT),
        Part(ellipsoid((1.95, -0.98, 0.7), 0.18, 0.36), Texture("moon.png", (1.3, 1.2, 0.9)), 4.0),
        *_parts(box((1.95, -0.78, 0.0), 0.16, 0.3, 0.4), Texture("text.png", (1.2, 1, 0.8)), 5.0),
        Part(cylinder((1.75, 0, -1.55), 0.15, 0.14, 0.03), STEEL, 3.0),
        Part(cylinder((1.75, 0, -1.55), 0.018, 0.018, 1.5), STEEL, 6.0),
        Part(revolve(shade, (1.75, -1.45, -1.55)), PAPER, 4.0),
    ]


def _shelf(rng: np.random.Generator) -> list[Part]:
    sides = [box((x, 0, 1.83), 0.03, 1.9, 0.3) for x in (-0.75, 0.75)]
    boards = [box((0, -y, 1.83), 1.5, 0.03, 0.3) for y in (0.05, 0.5, 0.95, 1.4, 1.87)]
    parts = [part for plank in sides + boards for part in _parts(plank, OAK, 2.0)]
    for board in (0.08, 0.53, 0.98, 1.43):
        x = -0.72
        while (x := x + (width := rng.uniform(0.03, 0.08)) + rng.exponential(0.01)) < 0.72:
            height = rng.uniform(0.2, 0.34)
            tint = tuple(rng.uniform(0.25, 1.2) * rng.uniform(0.6, 1.2, 3))
            book = box((x - width / 2, -board, 1.8), width, height, 0.2)
            parts += _parts(book, Texture("text.png", tint, (0.3, 1)), 3.0)
    return parts


def _pictures() -> list[Part]:
    """Canvases 0.1 m deep, which the coarse Gaussians of the walls do not reach through."""
    back, side = DEPTH / 2, WIDTH / 2
    hung = [
        ("astronaut.png", (-0.9, -1.1, -back), -FRONT, (0.8, 0.8, 0.1)),
        ("rocket.jpg", (0.5, -1.15, -back), -FRONT, (1.0, 0.67, 0.1)),
        ("chelsea.png", (side, -1.3, 0.2), -RIGHT, (0.1, 0.6, 0.9)),
        ("coffee.png", (-side, -1.15, 0.0), RIGHT, (0.1, 0.8, 1.2)),
        ("camera.png", (1.5, -1.1, back), FRONT, (0.7, 0.7, 0.1)),
    ]
    return [
        part
        for image, foot, normal, size in hung
        for part in _parts(box(foot + 0.05 * normal, *size), Texture(image), 8.0)
    ]
