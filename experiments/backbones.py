"""The methods with several 2D detectors.

    python experiments/backbones.py [--quick] [--out docs] [--onnx FILE ...] [--preset NAME]

The detectors are the four profiles of `detector_strengths.py`, uncalibrated, which fail at known
rates; the `DifferenceDetector`, which compares pixels with the original scene; and any networks
given as ONNX files, which are shown the renders. The first row is the detector itself on the views
that it was shown; the methods are scored on held-out views.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import charts
from cases import Case, detector_masks, masks_of
from detector_strengths import PROFILES
from difference import DifferenceDetector
from methods import ALL_METHODS
from observations import Method, observe_regimes
from runner import ChosenArgs, judge, measured, start
from tables import Frame, Row, pivot, write_section

from gsc_jax.detectors.onnx import OnnxDetector, OnnxSpec
from gsc_jax.detectors.specs import preset
from gsc_jax.evidence.detector import Detector
from gsc_jax.scene import InputError


@dataclasses.dataclass(frozen=True, kw_only=True)
class BackboneArgs(ChosenArgs):
    """Arguments of the experiment, with networks as further detectors.

    Attributes:
        onnx: Detectors exported to ONNX, named in tables after their files.
        preset: Input and output format of these: iml-vit, trufor, mvss-net or pscc-net; by default
            RGB in [0, 1] and probabilities.
    """

    onnx: tuple[Path, ...] = ()
    preset: str | None = None

    def networks(self) -> dict[str, OnnxDetector]:
        """Load the networks, by name."""
        if len({path.stem for path in self.onnx}) < len(self.onnx):
            raise InputError(
                "--onnx: two files have the same name, which tables would not tell apart"
            )
        spec = preset(self.preset) if self.preset else OnnxSpec()
        return {path.stem: OnnxDetector(path, spec) for path in self.onnx}


def rows_of(
    case: Case, networks: Mapping[str, Detector], methods: Mapping[str, Method]
) -> list[Row]:
    """Measure every detector and method on one edit."""
    detectors = {"difference": DifferenceDetector(case.scene.gaussians), **networks}
    masks = detector_masks(case, PROFILES) | {
        name: masks_of(detector, case.gaussians, case.scene.cameras)
        for name, detector in detectors.items()
    }
    return list(judge(observe_regimes(case, masks), methods))


def report(rows: Frame) -> str:
    """All tables."""
    return "\n\n".join(
        [
            "**F1 by 2D detector.** The first row is the detector itself on the views that it was "
            "shown, the others are scored on held-out views; a network that was given with "
            "`--onnx` has a column of its name. `difference` has the original scene, which no "
            "forensic detector has; it shows the effect of lifting on good masks.",
            pivot(rows, "method", "regime"),
            "**F1 by kind of edit, all detectors**",
            pivot(rows, "method", "edit"),
        ]
    )


def main(args: BackboneArgs) -> None:
    """Measure every case with every detector; print and write the tables and the chart."""
    networks = args.networks()
    methods = args.among(ALL_METHODS)
    per_case = (rows_of(case, networks, methods) for case in args.cases())
    rows = measured(args, "backbones", per_case)
    warnings = [f"Warning: {text}" for network in networks.values() for text in network.warnings]
    text = "\n\n".join([report(rows), *warnings])
    print(text)
    write_section(args.out / "results.md", "backbones", text)
    charts.grid(rows, args.out / "backbones.png")


if __name__ == "__main__":
    start(main, __doc__)
