"""Print the tables of `docs/performance.md`, and write them there, from `docs/performance.json`.

python benchmarks/page.py
"""

import json
import sys
from pathlib import Path

import common

sys.path.append(str(Path(__file__).resolve().parents[1] / "experiments"))
from tables import write_section


def main() -> None:
    """Update both sections."""
    parts = json.loads((common.DOCS / "performance.json").read_text())
    page = common.DOCS / "performance.md"
    table = splat_table(parts["splat"])
    lines = pipeline_list({name: part["values"] for name, part in parts.items()})
    write_section(page, "splat", table)
    write_section(page, "pipeline", lines)
    print(f"{table}\n\n{lines}")


def splat_table(part: dict) -> str:
    """Table with one row per scene and image size."""
    lines = [
        described(part["machine"]) + "\n",
        "| scene | size | project | bin | composite | accumulate | whole view | plain | ratio | "
        "C, 1 core | C, all cores | listed | contribute | compile |",
        "|" + "---|" * 14,
    ]
    for row in part["values"]:
        stages = ("project", "bin", "composite", "accumulate", "whole view", "plain whole view")
        cells = [f"{1e3 * row[stage]:.0f} ms" for stage in stages]
        ratio = row["plain whole view"] / row["whole view"]
        limits = [row.get(f"C composite, {cores}") for cores in ("1 core", "all cores")]
        cells += [f"**{ratio:.1f}**"]
        cells += [f"{1e3 * t:.0f} ms ({row['composite'] / t:.1f}x)" if t else "-" for t in limits]
        cells += [f"{row[key] / 1e6:.0f} M" for key in ("listed", "needed") if key in row]
        cells += [f"{row['first view with compilation']:.1f} s"]
        size = f"{row['width']}x{row['height']}"
        lines.append(f"| {row['scene']} | {size} | {' | '.join(cells)} |")
    return "\n".join(lines)


def described(machine: dict) -> str:
    """One line that names the machine."""
    return (
        f"{machine['device']}, {machine['cores']} cores, Python {machine['python']}, JAX "
        f"{machine['jax']}, NumPy {machine['numpy']}."
    )


def pipeline_list(values: dict) -> str:
    """List with one line per part of `benchmarks/pipeline.py`."""
    rendered, memory, cold = (values[part] for part in ("rendered", "memory", "cold"))
    sweep, robust, slopes = values["sweep"], values["robust"], values["scaling"]["slopes"]
    attributes, sizes = values["attributes"], values["sizes"]
    return "\n".join(
        [
            f"- `locate`, 300,000 Gaussians, 100 views of 640x420, given masks: "
            f"{values['locate']['seconds']:.1f} s, compilation included.",
            f"- {sizes['views']} of the views, of one size {sizes['one']:.1f} s, of as many sizes "
            f"{sizes['many']:.1f} s, compilation included.",
            f"- `robust` after that evidence: {robust['first']:.1f} s with compilation, "
            f"{robust['again']:.1f} s without; `official`: {robust['official']:.1f} s without.",
            f"- Evidence in the attributes: {attributes['again']:.1f} s once compiled, of which "
            f"{attributes['without_traces']:.1f} s without traces.",
            f"- `paper` with rendering in every iteration ({rendered['views']} views, "
            f"{rendered['epochs']} epochs): {rendered['rendered']:.1f} s, on the evidence "
            f"{rendered['evidence']:.1f} s; the ratio is {rendered['ratio']:.1f}.",
            f"- 3 million Gaussians with the prior from their attributes, 100 views: "
            f"{memory['seconds']:.0f} s, peak {memory['peak_gib']:.1f} GiB, of which at most "
            f"{memory['anonymous_gib']:.1f} GiB is not the file of the evidence.",
            f"- Import {cold['import']:.2f} s; first view {cold['first view']:.1f} s, in the next "
            f"process {cold['first view, cached']:.1f} s from the compilation cache.",
            *_command_line(**cold),
            f"- {sweep['configurations']} configurations on the evidence of 24 views: "
            f"{sweep['many']:.1f} s after {sweep['observe']:.1f} s for the evidence, in total "
            f"{sweep['ratio']:.1f} times as long as one configuration with its evidence.",
            f"- Slope in log-log over the upper decade: {slopes['Gaussians']:.2f} against "
            f"Gaussians, {slopes['pixels']:.2f} against pixels.",
        ]
    )


def _command_line(command: float = 0.0, **cold: float) -> list[str]:
    """The line of the whole command, if it was measured."""
    again = cold.get("command, cached", 0.0)
    return [
        f"- `gsc-jax locate` of 200,000 Gaussians, without cameras and masks, from the start of "
        f"the process to the report: {command:.1f} s, the second time {again:.1f} s.",
    ][: bool(command)]


if __name__ == "__main__":
    main()
