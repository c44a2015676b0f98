"""The formats that this package reads: how an input is damaged, and what a valid result is."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from fuzz.camera_inputs import cameras_tree, check_cameras, make_colmap, transforms_tree
from fuzz.damage import Damage, damaged_header, damaged_json
from fuzz.harness import Format
from fuzz.mask_files import check_mask, make_mask
from fuzz.mutate import damaged_bytes
from fuzz.result_files import check_results, make_results
from fuzz.scene_files import (
    check_scene,
    check_sog,
    compressed_seeds,
    damaged_ksplat,
    ksplat_seeds,
    make_glb,
    make_sog,
    make_spz,
    make_streamed,
    ply_seeds,
    splat_seeds,
)
from fuzz.settings_files import check_config, check_spec, damaged_spec, make_config, spec_seeds


def _make_file(
    rng: Random | None, folder: Path, *, name: str, seeds: Callable[[], list[bytes]], damage: Damage
) -> Path:
    data = seeds()[0] if rng is None else damage(rng, rng.choice(seeds()))
    (folder / name).write_bytes(data)
    return folder / name


def _file(
    kind: str, name: str, seeds: Callable[[], list[bytes]], damage: Damage, read: Callable
) -> Format:
    make = functools.partial(_make_file, name=name, seeds=seeds, damage=damage)
    return Format(name=kind, make=make, read=read)


def _json_seeds(tree: Callable[[], Any]) -> list[bytes]:
    return [json.dumps(tree()).encode()]


_FORMATS = (
    _file("ply-binary", "s.ply", functools.partial(ply_seeds, False), damaged_header, check_scene),
    _file("ply-ascii", "s.ply", functools.partial(ply_seeds, True), damaged_header, check_scene),
    _file("ply-compressed", "s.ply", compressed_seeds, damaged_header, check_scene),
    Format(name="spz", make=make_spz, read=check_scene),
    Format(name="sog", make=make_sog, read=check_sog),
    Format(name="streamed", make=make_streamed, read=check_sog),
    _file("splat", "s.splat", splat_seeds, damaged_bytes, check_scene),
    _file("ksplat", "s.ksplat", ksplat_seeds, damaged_ksplat, check_scene),
    Format(name="glb", make=make_glb, read=check_scene),
    _file(
        "cameras",
        "cameras.json",
        functools.partial(_json_seeds, cameras_tree),
        damaged_json,
        check_cameras,
    ),
    _file(
        "transforms",
        "transforms.json",
        functools.partial(_json_seeds, transforms_tree),
        damaged_json,
        check_cameras,
    ),
    *(
        Format(
            name=f"colmap-{'text' if text else 'binary'}",
            make=functools.partial(make_colmap, text=text),
            read=check_cameras,
        )
        for text in (False, True)
    ),
    Format(name="mask", make=make_mask, read=check_mask),
    _file("spec", "net.toml", spec_seeds, damaged_spec, check_spec),
    Format(name="config", make=make_config, read=check_config),
    Format(name="results", make=make_results, read=check_results),
)
FORMATS = {kind.name: kind for kind in _FORMATS}
"""All formats, by name."""
