"""`make demo-scan`: a small collection of made scenes, some edited or broken, scanned and ranked.

    python experiments/demo_scan.py OUT

OUT/collection holds twelve rooms, four of them with a pasted object, a copy of a file and two
broken files; OUT/scanned the results. Prints the table of `gsc-jax scan`.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

import gsc_jax
from gsc_jax.benchmark.scenes import make_room, tampered_room
from gsc_jax.cli.main import main

ROOMS, EDITED, COUNT = 8, 4, 12_000


def make_collection(folder: Path) -> None:
    """Write the files of the collection; existing ones are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(ROOMS):
        count = COUNT + int(np.random.default_rng(seed).integers(0, COUNT))
        gsc_jax.save_ply(folder / f"room_{seed}.ply", make_room(seed=seed, count=count))
    for seed in range(EDITED):
        made = tampered_room(seed=seed, count=COUNT)
        gsc_jax.save_ply(folder / f"edited_{seed}.ply", made.gaussians)
    shutil.copy(folder / "edited_0.ply", folder / "same_as_edited_0.ply")
    content = (folder / "room_0.ply").read_bytes()
    (folder / "broken_half.ply").write_bytes(content[: len(content) // 2])
    (folder / "broken_text.ply").write_text("no model\n", "ascii")


if __name__ == "__main__":
    out = Path(sys.argv[1])
    make_collection(out / "collection")
    scanned = str(out / "scanned")
    code = main(["scan", str(out / "collection"), "--out", scanned, "--report-above", "0.35"])
    print(
        "note     edited_* are edited. By the attributes alone a pasted object of this size is no "
        "evidence;\n         a scan ranks, and the first scenes are those to look at, with masks."
    )
    sys.exit(code)
