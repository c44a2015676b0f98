"""What `gsc-jax locate --dry-run` says a run takes, and what it takes then.

Each scene is run cold first, as a dry run promises nothing about compiling, then said and done.
Arguments are cases, each what follows `gsc-jax locate` but for --out, in one string; without, the
scenes beside the repository.
"""

import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import DATA

TAMPERED = DATA.parent / "tampered"
SAID = re.compile(r"time +about ([\d.]+) (s|min|h) \(([\d.]+) (s|min|h) to ([\d.]+) (s|min|h)\)")
MEMORY = re.compile(r"memory +about ([\d.]+) ([MG])iB")
SECONDS = {"s": 1, "min": 60, "h": 3600}
MIB = {"M": 1, "G": 1024}


def cases() -> list[str]:
    """Scenes alone, with masks, and by another method."""
    alone = [f"{path} --cameras {path.with_suffix('')}.cameras.json" for path in DATA.glob("*.ply")]
    masked = [
        f"{folder}/scene.ply --cameras {folder}/cameras.json --masks {folder}/detector"
        for folder in sorted(path for path in TAMPERED.iterdir() if path.is_dir())
    ]
    return [*sorted(alone), *masked, f"{masked[0]} --method paper"]


def run(case: str, out: Path, *more: str) -> tuple[str, float]:
    """What a run prints, and the seconds from its start to its end."""
    command = [
        sys.executable,
        "-m",
        "gsc_jax",
        "locate",
        *shlex.split(case),
        "--out",
        str(out),
        *more,
    ]
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout, time.perf_counter() - begin


def compared(case: str) -> list[str]:
    """A row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        run(case, out)
        said, looked = run(case, out, "--dry-run")
        _, took = run(case, out)
        stages = json.loads((out / "result.json").read_text())["stages"]
    match, memory = SAID.search(said), MEMORY.search(said)
    assert match is not None, said
    assert memory is not None, said
    about, least, most = (float(match[i]) * SECONDS[match[i + 1]] for i in (1, 3, 5))
    peak = max(stage["peak_mib"] for stage in stages.values())
    mib = float(memory[1]) * MIB[memory[2]]
    return [
        " ".join("/".join(part.split("/")[-2:]) for part in case.split()),
        f"{about:.0f} s ({least:.0f} to {most:.0f})",
        f"{took:.0f} s",
        f"{about / took:.2f}",
        f"{looked:.0f} s",
        f"{mib:.0f} / {peak:.0f} MiB = {mib / peak:.2f}",
    ]


def main() -> None:
    """Prints a row per case."""
    print("| case | said | took | said / took | the dry run | memory said / used |")
    print("|---|---|---|---|---|---|")
    for case in sys.argv[1:] or cases():
        print(f"| {' | '.join(compared(case))} |", flush=True)


if __name__ == "__main__":
    main()
