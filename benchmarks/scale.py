"""What a million scenes take: the times measured here, and a simulation of clusters.

    python benchmarks/scale.py

Reads the parts `collection` and `collection_long` of `docs/performance.json`, which
`benchmarks/collection.py` measures, prints the tables of `docs/scale.md` and writes them there. The
simulation (SimPy) has workers that read scenes from a shared storage and judge them; scenes have
the measured spread around the line of seconds against Gaussians, and a share of them kills its
process and is tried again.
"""

import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path

import common
import numpy as np
import simpy
from simpy.events import ProcessGenerator

sys.path.append(str(Path(__file__).resolve().parents[1] / "experiments"))
from tables import markdown, write_section

SCENES, PER_WORKER = 20_000, 200
"""Least number of scenes of a simulation, and for each worker, so that the end of a scan, where
workers wait for the slowest scenes, is short; times of a million are scaled."""
MILLION = 1_000_000
WORKERS = (1, 10, 100, 1000)
BYTES_PER_GAUSSIAN = 248
"""A row of an INRIA .ply of degree 3."""
STORAGE = 5e9
"""Bytes per second of the shared storage, for all workers together."""
STREAM = 2e8
"""Bytes per second of one worker's connection to it."""
KILLED = 0.002
"""Share of the attempts that end with a killed process, half-way."""
RESTART = 8.0
"""Seconds until a new process has imported and read its compiled code."""
ROW_BYTES, REPORT_BYTES, REPORTED = 3_000, 6e6, 0.05
"""Bytes of a row and of the folder of a report, and the share of the scenes that have one."""
PRICE = 0.04
"""Dollars per core and hour, about that of large clouds on demand in 2026: an assumption."""
KINDS = {"reports": "every report", "scan": "rows only"}
"""What a measured scan writes, by the beginning of its name."""


@dataclasses.dataclass(frozen=True)
class Costs:
    """Seconds of a scene: a line in the number of Gaussians, and the measured ratios to it."""

    fixed: float
    per_gaussian: float
    ratios: np.ndarray

    def draw(self, gaussians: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Seconds of scenes, with a measured ratio each."""
        line = self.fixed + self.per_gaussian * gaussians
        return line * rng.choice(self.ratios, len(gaussians))


SIZES: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "as measured: 20,000 to 250,000": lambda rng, n: np.exp(
        rng.uniform(np.log(20e3), np.log(250e3), n)
    ),
    "a sharing site: median 400,000, a tenth above 1.5 M": lambda rng, n: np.minimum(
        np.exp(rng.normal(np.log(4e5), 1.03, n)), 10e6
    ),
}
"""Distributions of the number of Gaussians; the second one is an assumption."""


def measured_costs(values: dict) -> Costs:
    """Costs of the scenes of a scan with one worker."""
    gaussians, seconds = np.array(values["scan1"]["each"]).T
    slope, fixed = np.polyfit(gaussians, seconds, 1)
    fixed = max(float(fixed), 0.0)
    return Costs(fixed, float(slope), seconds / (fixed + slope * gaussians))


def simulated(
    costs: Costs, gaussians: np.ndarray, workers: int, *, start: float, seed: int = 0
) -> tuple[float, float]:
    """Seconds of a scan, and the share of the time that its workers compute."""
    rng = np.random.default_rng(seed)
    seconds, killed = costs.draw(gaussians, rng), rng.random((len(gaussians), 2)) < KILLED
    environment = simpy.Environment(initial_time=start)
    lanes = simpy.Resource(environment, max(1, int(STORAGE / STREAM)))
    jobs, busy = iter(range(len(gaussians))), [0.0]

    def compute(duration: float) -> ProcessGenerator:
        busy[0] += duration
        yield environment.timeout(duration)

    def reader(read: simpy.Store) -> ProcessGenerator:
        for job in jobs:  # the next scene is read while one is judged
            with lanes.request() as lane:
                yield lane
                yield environment.timeout(gaussians[job] * BYTES_PER_GAUSSIAN / STREAM)
            yield read.put(job)
        yield read.put(None)

    def worker() -> ProcessGenerator:
        read = simpy.Store(environment, capacity=1)
        environment.process(reader(read))
        while (job := (yield read.get())) is not None:
            for attempt in killed[job]:
                if not attempt:
                    break
                yield from compute(float(seconds[job]) / 2)
                yield environment.timeout(RESTART)
            yield from compute(float(seconds[job]))

    for _ in range(workers):
        environment.process(worker())
    environment.run()
    return float(environment.now), busy[0] / (workers * environment.now)


def against_ray(costs: Costs, values: dict) -> str:
    """Table: scans of Ray here beside the simulation of the same scenes."""
    lines, cores = [], values["cores"]
    gaussians = np.array(values["gaussians"], float)
    start = values["scan1"]["seconds"] - values["scan1"]["work"]
    for name, scan in values.items():
        if not name.startswith("scan"):
            continue
        workers = int(name.removeprefix("scan"))
        runs = [
            simulated(costs, gaussians, min(workers, cores), start=start, seed=seed)[0]
            for seed in range(20)
        ]
        lines.append(
            [
                workers,
                f"{scan['seconds']:.0f} s",
                f"{np.mean(runs):.0f} ± {np.std(runs):.0f} s",
                f"{values['scan1']['seconds'] / scan['seconds']:.2f}",
            ]
        )
    heads = [f"{values['scenes']} scenes, workers", "Ray here", "simulated", "times as fast as 1"]
    return markdown(heads, lines)


def million(costs: Costs, start: float) -> str:
    """Table: what a million scenes take, by distribution and number of workers."""
    lines = []
    for name, sizes in SIZES.items():
        count = max(SCENES, PER_WORKER * max(WORKERS))
        everything = sizes(np.random.default_rng(0), count)
        mean = float(costs.draw(everything, np.random.default_rng(1)).mean())
        core_hours = mean * MILLION / 3600
        for workers in WORKERS:
            gaussians = everything[: max(SCENES, PER_WORKER * workers)]
            seconds, busy = simulated(costs, gaussians, workers, start=start)
            hours = (seconds - start) * MILLION / len(gaussians) / 3600
            lines.append(
                [
                    name,
                    workers,
                    f"{hours:,.1f} h" if hours < 1000 else f"{hours / 24:,.0f} days",
                    f"{busy:.2f}",
                    f"{core_hours:,.0f}",
                    f"{core_hours * PRICE:,.0f} $",
                    f"{everything.mean() * BYTES_PER_GAUSSIAN * MILLION / 1e12:.1f} TB",
                    f"{(ROW_BYTES + REPORTED * REPORT_BYTES) * MILLION / 1e12:.2f} TB",
                ]
            )
    heads = ["scenes", "workers", "time", "busy", "core-hours", "price", "read", "written"]
    return markdown(heads, lines)


def compared(values: dict) -> str:
    """Table: a loop over `gsc-jax locate`, scans that write the same folders, and rows alone."""
    rows = [["loop over `gsc-jax locate`", values["loop"], None]]
    for name, scan in values.items():
        kind = name.rstrip("0123456789")
        workers = name.removeprefix(kind)
        if kind in KINDS:
            plural = "s" * (workers != "1")
            rows.append([f"scan, {KINDS[kind]}, {workers} worker{plural}", scan["seconds"], scan])
    lines = [
        [
            text,
            f"{seconds:.0f} s",
            f"{values['loop'] / seconds:.2f}",
            f"{scan['peak_mib'] / 1024:.2f} GiB" if scan else "",
            f"{scan['growth_mib_per_100']:.0f} MiB" if scan else "",
        ]
        for text, seconds, scan in rows
    ]
    heads = ["time", "times as fast", "peak of a worker", "growth per 100 scenes"]
    return markdown([f"{values['scenes']} scenes", *heads], lines)


def main() -> None:
    """Print and write the tables."""
    parts = json.loads((common.DOCS / "performance.json").read_text())
    part = parts["collection"]
    values = {**part["values"], "cores": part["machine"]["cores"]}
    costs = measured_costs(values)
    start = values["scan1"]["seconds"] - values["scan1"]["work"]
    stages = values["scan1"]["stages"]
    total = sum(stages.values())
    shares = ", ".join(f"{name} {seconds / total:.0%}" for name, seconds in stages.items())
    text = "\n\n".join(
        [
            f"{part['machine']['device']}, {values['cores']} cores. A scene takes "
            f"{costs.fixed:.2f} s and {costs.per_gaussian * 1e5:.2f} s for every 100,000 Gaussians "
            "on one core, "
            f"within a factor of {costs.ratios.min():.2f} to {costs.ratios.max():.2f}; of that, "
            f"{shares}. A scan starts in {start:.0f} s.",
            compared(parts["collection_long"]["values"]),
            against_ray(costs, values),
            million(costs, start),
        ]
    )
    print(text)
    write_section(common.DOCS / "scale.md", "scale", text)


if __name__ == "__main__":
    main()
