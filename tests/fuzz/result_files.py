"""Folders of results with a damaged file, and the check of results that can be read."""

import functools
import math
import tempfile
from pathlib import Path
from random import Random

from fuzz.camera_inputs import check_camera_numbers
from fuzz.damage import Damage, damaged_header, damaged_json, damaged_npy
from results_folder import write_results

from gsc_jax.cli.report.wording import headline, lead
from gsc_jax.cli.results import read_results


@functools.cache
def _results() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        write_results(Path(name), count=16)
        names = ("tamper.ply", "tamper.npy", "labels.npy", "views.json", "result.json")
        return {file: (Path(name) / file).read_bytes() for file in names}


def make_results(rng: Random | None, folder: Path) -> Path:
    files = _results()
    if rng is not None:
        name = rng.choice(list(files))
        files = files | {name: _DAMAGES[name](rng, files[name])}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def check_results(path: Path) -> None:
    """Read results and state what the viewer says about them."""
    results = read_results(path)
    assert len(results.tamper) == len(results.labels) == len(results.scene.gaussians)
    assert ((results.tamper >= 0) & (results.tamper <= 1)).all()
    assert math.isfinite(results.report["config"]["threshold"])
    check_camera_numbers(results.cameras)
    counts, verdict = results.report["counts"], results.report.get("verdict")
    assert "nan" not in headline(verdict, counts["tampered"]) + lead(results.report)


_DAMAGES: dict[str, Damage] = {
    "tamper.ply": damaged_header,
    "tamper.npy": damaged_npy,
    "labels.npy": damaged_npy,
    "views.json": damaged_json,
    "result.json": damaged_json,
}
