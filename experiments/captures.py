"""A bank of captures: scenes and objects photographed anew and trained in different ways.

    python experiments/captures.py [--bank .captures] [--share 0.1] [--out docs]
    python experiments/captures.py --standard --sources kitchen room --bank .captures/standard

A capture is a training on images of a scene that exists, which gives it the statistics of another
trainer. Strategy, degree, resets, image size, iterations, budget, points and exposure are drawn for
each. A second run makes only what is missing; an interrupted one loses one capture at most.
"""

import dataclasses
import functools
import itertools
import json
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from cases import DATA
from garden import garden_cameras, make_garden
from runner import DOCS, start
from scipy.spatial.transform import Rotation
from similarity import psnr
from tables import markdown, write_csv, write_section
from tqdm import tqdm
from trainer import CaptureConfig, Strategy, camera_extent, capture

from gsc_jax import load_cameras, load_ply, orbit_cameras
from gsc_jax.benchmark.scenes import make_object, make_room, room_cameras
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.files import atomic
from gsc_jax.io.ply import save_ply
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import render

SCENES = ("kitchen", "playbot", "flowers")
OBJECTS = ("statue", "guitar", "plant", "bust", "wooden_figure", "kneeling_angel")
"""Without `UNSEEN` and `UNSEEN_OBJECTS` of cases.py, on which nothing may be trained."""
MADE = ("room", "garden", "vase")
"""Made scenes: each capture of one is of another seed."""
CAPTURES = {**dict.fromkeys(SCENES, 6), **dict.fromkeys(OBJECTS, 1), "room": 7, "garden": 7}
CAPTURES["vase"] = 3
"""Captures of each source with the strategies `IN_TURN`, 41 in all."""
IN_TURN: tuple[Strategy, ...] = ("adaptive", "mcmc")
BY_ERROR = {**dict.fromkeys(SCENES, 2), "room": 2, "garden": 2}
"""Number of further captures of each source that are trained by growth by error."""
FIRST_BY_ERROR = 10
"""Seed of the first of them for each source."""
VIEWS, HELDOUT_EVERY = 66, 11
"""Views of a capture; every eleventh is held out, so that 60 are trained on."""
WIDTHS, BUDGETS = (200, 240, 320), (15_000, 25_000, 40_000)
STEPS, POINTS = (1000, 3000), (2000, 8000)
EXPOSURES = (0.0, 0.03, 0.08)
"""Standard deviations of the logarithm of the exposure of an image."""
STANDARD = CaptureConfig(iterations=3000, budget=40_000, sh_degree=3)
STANDARD_SEED = 1000
"""Seed of the captures with these options; the bank has other ones."""
DRIFT, TURN = 0.05, 4.0
"""Standard deviations of added views: place in units of the extent, and direction in degrees."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """Arguments of the bank.

    Attributes:
        bank: Folder of the captures, with a folder for each.
        share: Share of the captures of each source, at least one of them; of those by growth by
            error maybe none.
        sources: Sources to capture; all by default.
        standard: Capture each source with adaptive density control and with MCMC, and the same
            `STANDARD` options, instead: 40,000 Gaussians from 60 images of 320x240.
        data: The real scenes and objects; without them only made ones are captured.
        out: Folder of results.md and captures.csv.
    """

    bank: Path = Path(".captures")
    share: float = 1.0
    sources: tuple[str, ...] = ()
    standard: bool = False
    data: Path = DATA
    out: Path = DOCS


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recipe:
    """What distinguishes a capture: see `CaptureConfig` for the options of the training.

    Attributes:
        source: Name of the scene or object that is captured.
        seed: Seed of all random choices of the capture.
        config: Options of the training.
        width: Width of the images in pixels; the height is three quarters of it.
        points: Number of points that the training starts with.
        exposure: Standard deviation of the logarithm of the exposure of an image.
    """

    source: str
    seed: int
    config: CaptureConfig
    width: int
    points: int
    exposure: float

    @property
    def name(self) -> str:
        """Name of the folder of the capture."""
        return f"{self.source}-{self.seed}-{self.config.strategy}"


def make_recipe(source: str, seed: int) -> Recipe:
    """Draw a recipe.

    The strategies `IN_TURN` alternate with the seeds below `FIRST_BY_ERROR`. With seeds from there
    on, captures are trained by growth by error.
    """
    rng = np.random.default_rng([seed, zlib.crc32(source.encode())])
    budget = int(rng.choice(BUDGETS))
    strategy = IN_TURN[(seed + zlib.crc32(source.encode())) % 2]
    config = CaptureConfig(
        iterations=int(rng.integers(*STEPS)),
        budget=budget // 2 if source in (*OBJECTS, "vase") else budget,
        sh_degree=int(rng.integers(4)),
        strategy=strategy if seed < FIRST_BY_ERROR else "error",
        reset_opacities=bool(rng.integers(2)),
    )
    return Recipe(
        source=source,
        seed=seed,
        config=config,
        width=int(rng.choice(WIDTHS)),
        points=int(rng.integers(*POINTS)),
        exposure=float(rng.choice(EXPOSURES)),
    )


def standard_recipe(source: str, index: int) -> Recipe:
    """The recipe of a measurement, with the strategy of this index."""
    config = dataclasses.replace(STANDARD, strategy=IN_TURN[index])
    fixed = {"width": 320, "points": 8000, "exposure": 0.0}
    return Recipe(source=source, seed=STANDARD_SEED, config=config, **fixed)


def recipes(args: Args) -> Iterator[Recipe]:
    """All recipes, first one of each source, so that a part of the bank is varied, too."""
    known = CAPTURES if args.data.is_dir() else {name: CAPTURES[name] for name in MADE}
    if not 0 < args.share <= 1:
        raise InputError(f"--share {args.share}: expected a share above 0, at most 1")
    if unknown := [name for name in args.sources if name not in known]:
        raise InputError(f"--sources {unknown[0]!r}: expected some of {', '.join(known)}")
    if args.standard:
        for source, index in itertools.product(args.sources or known, range(2)):
            yield standard_recipe(source, index)
        return
    for seed in range(max(known.values())):
        for source in args.sources or known:
            if seed < max(1, round(args.share * known[source])):
                yield make_recipe(source, seed)
    for source in args.sources or known:
        for k in range(round(args.share * BY_ERROR.get(source, 0))):
            yield make_recipe(source, FIRST_BY_ERROR + k)


def photographed(recipe: Recipe, data: Path) -> tuple[Gaussians, list[Camera]]:
    """The scene of a recipe, and the cameras that photograph it."""
    size, seed = (recipe.width, recipe.width * 3 // 4), recipe.seed
    view = functools.partial(dict, width=size[0], height=size[1], seed=seed)
    if recipe.source == "room":
        return make_room(seed=seed), room_cameras(VIEWS, **view())
    if recipe.source == "garden":
        return make_garden(seed=seed), garden_cameras(VIEWS, **view())
    if recipe.source in SCENES:
        path = data / "scenes" / recipe.source
        cameras = [c.resized(*size) for c in load_cameras(path.with_suffix(".cameras.json"))]
        return load_ply(path.with_suffix(".ply")), views_around(cameras, seed)
    if recipe.source == "vase":
        thing = make_object(seed=seed, count=20_000)
    else:
        thing = load_ply(data / "objects" / f"{recipe.source}.ply")
    return thing, orbit_cameras(thing, VIEWS, size=size, seed=seed)


def views_around(cameras: Sequence[Camera], seed: int) -> list[Camera]:
    """Cameras near the given ones, which are too few to train on."""
    rng, extent = np.random.default_rng(seed), camera_extent(cameras)
    views = []
    for k in range(VIEWS):
        moved = np.eye(4)
        moved[:3, :3] = Rotation.from_rotvec(TURN * rng.normal(size=3), degrees=True).as_matrix()
        moved[:3, 3] = DRIFT * extent * rng.normal(size=3)
        camera = cameras[k % len(cameras)]
        viewmat = (moved @ np.asarray(camera.viewmat)).astype(np.float32)
        views.append(dataclasses.replace(camera, viewmat=viewmat, name=f"view_{k:03d}"))
    return views


def points_of(scene: Gaussians, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, 6) of the opaque surfaces with their colours, as from structure from motion.

    They lie off the surfaces by a tenth of a percent of the size of the scene.
    """
    opacities = np.asarray(scene.opacities, np.float64)
    rows = rng.choice(len(scene), count, p=opacities / opacities.sum())
    means = np.asarray(scene.means)[rows]
    noise = 1e-3 * np.ptp(np.percentile(means, [5, 95], axis=0), axis=0).max()
    colors = np.clip(0.5 + Y0 * np.asarray(scene.sh)[rows, 0], 0, 1)
    return np.column_stack([means + noise * rng.normal(size=means.shape), colors])


def make_capture(recipe: Recipe, args: Args) -> None:
    """Photograph, train and store a capture, with what it took and its PSNR on held-out views."""
    rng = np.random.default_rng([recipe.seed, 1])
    scene, cameras = photographed(recipe, args.data)
    scene = jax.tree.map(jnp.asarray, scene)
    images = np.stack([np.asarray(render(scene, camera)[0]) for camera in cameras])
    heldout = np.arange(VIEWS) % HELDOUT_EVERY == HELDOUT_EVERY // 2
    begin = time.perf_counter()
    with tqdm(total=recipe.config.iterations, desc=recipe.name, disable=None, leave=False) as bar:
        made = capture(
            [cameras[k] for k in np.flatnonzero(~heldout)],
            exposed(images[~heldout], recipe.exposure, rng),
            points_of(scene, recipe.points, rng),
            config=recipe.config,
            seed=recipe.seed,
            progress=lambda *stage_done_total: _advance(bar, stage_done_total[1]),
        )
    seconds = time.perf_counter() - begin
    quality = [psnr(render(made, cameras[k])[0], images[k]) for k in np.flatnonzero(heldout)]
    folder = args.bank / recipe.name
    save_ply(folder / "scene.ply", made)
    save_cameras(folder / "cameras.json", cameras)
    facts = {"psnr": round(float(np.mean(quality)), 2), "seconds": round(seconds)}
    facts |= {"gaussians": len(made), **dataclasses.asdict(recipe)}
    with atomic(_facts(recipe, args.bank)) as temporary:  # last: what has one is complete
        temporary.write_text(json.dumps(facts, indent=1))


def _advance(bar: tqdm, done: int) -> None:
    bar.update(done - bar.n)


def exposed(images: np.ndarray, exposure: float, rng: np.random.Generator) -> np.ndarray:
    """The images (V, H, W, 3), each with a random exposure, in 8 bits."""
    factors = np.exp(exposure * rng.normal(size=(len(images), 1, 1, 1)))
    return np.round(255 * np.clip(images * factors, 0, 1)).astype(np.float32) / 255


def _facts(recipe: Recipe, bank: Path) -> Path:
    return bank / recipe.name / "recipe.json"


def is_stored(recipe: Recipe, bank: Path) -> bool:
    """Whether the bank has the capture of a recipe, and not one of other options."""
    path = _facts(recipe, bank)
    return (
        path.exists() and dataclasses.asdict(recipe).items() <= json.loads(path.read_text()).items()
    )


def extent(values: pd.Series, form: str) -> str:
    """The least and the largest value, or the only one."""
    return " to ".join(dict.fromkeys(format(float(x), form) for x in (values.min(), values.max())))


def report(rows: pd.DataFrame) -> str:
    """The captures by source: how many, how large, how good."""
    lines = []
    for source, own in rows.groupby("source", sort=False):
        sizes, ratios = extent(own.gaussians, ",.0f"), extent(own.psnr, ".1f")
        lines.append([source, len(own), sizes, f"{own.psnr.mean():.1f}", ratios])
    table = markdown(["source", "captures", "Gaussians", "PSNR (dB)", "from, to"], lines)
    strategies = rows.groupby("strategy").psnr.agg(["count", "mean"])
    summary = ", ".join(
        f"{name}: {int(row['count'])} with {row['mean']:.1f} dB"
        for name, row in strategies.iterrows()
    )
    return (
        f"{table}\n\n{len(rows)} captures, PSNR on held-out views without their exposure; by "
        f"strategy: {summary}. Median time {rows.seconds.median():.0f} s."
    )


def main(args: Args) -> None:
    """Make what the bank lacks; write the table of all that it has."""
    wanted = list(recipes(args))
    for recipe in tqdm(wanted, desc="captures", disable=None):
        if not is_stored(recipe, args.bank):
            make_capture(recipe, args)
    stored = (json.loads(_facts(recipe, args.bank).read_text()) for recipe in wanted)
    name = "standard_captures" if args.standard else "captures"
    rows = pd.DataFrame([{**facts.pop("config"), **facts} for facts in stored])
    write_csv(args.out / f"{name}.csv", rows)
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", name, text)


if __name__ == "__main__":
    start(main, __doc__)
