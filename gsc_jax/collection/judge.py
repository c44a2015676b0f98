"""One scene to one row: what `gsc-jax locate` finds in it, without the views unless needed.

Without a 2D detector, views only show the result: they are placed and rendered for a report only.
"""

import contextlib
import hashlib
import warnings
from pathlib import Path

import numpy as np

from gsc_jax.cli.locate import locate_and_write, read_inputs
from gsc_jax.cli.options import Locate
from gsc_jax.collection.record import Row, wants_report
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.validation import brief
from gsc_jax.locate import locate
from gsc_jax.scene import InputError


def judge(options: Locate, report_above: float | None) -> Row:
    """Judge a scene; an error becomes the columns `error_class` and `error` of the row.

    The row has the columns that the content of the scene determines, with seconds and memory. The
    options are those of `gsc-jax locate`; their folder `out` is written from the scene probability
    `report_above` on, and never if that is None.
    """
    with contextlib.suppress(OSError):  # Linux: the peak of this scene and not of earlier ones
        Path("/proc/self/clear_refs").write_text("5", "ascii")
    monitor, row = Monitor(), {}
    try:
        with warnings.catch_warnings(record=True) as raised:
            row = _judged(options, report_above, monitor)
        row["warnings"] += [str(warning.message) for warning in raised]
    except Exception as error:  # a bad scene is a row, not the end of the scan
        text = str(error) if isinstance(error, InputError) else brief(error)
        row = {"error_class": type(error).__name__, "error": " ".join(text.split())}
    stages = [{"name": name, **stage} for name, stage in monitor.summary().items()]
    return {**row, "stages": stages, "seconds": monitor.elapsed()}


def _judged(options: Locate, report_above: float | None, monitor: Monitor) -> Row:
    with monitor.stage("load"):
        inputs = read_inputs(options, monitor=monitor, previews=0)
    settings = {"config": inputs.estimator, "prior": inputs.attributes, "monitor": monitor}
    found = locate(inputs.scene.gaussians, inputs.cameras, inputs.detector, **settings)
    scene, labelled = inputs.scene, int(found.labels.sum())
    row: Row = {
        "gaussians": len(scene.rows),
        "scene_probability": found.verdict,
        "labelled": labelled,
        "labelled_share": labelled / len(scene.rows),
        "traces": [t.name for t in getattr(found.prior, "traces", ()) if t.found],
        "warnings": list(dict.fromkeys([*inputs.warnings, *found.warnings])),
        "result_sha256": result_digest(scene.expand(found.tamper), scene.expand(found.labels)),
    }
    if wants_report(row, report_above):
        with monitor.stage("load"):
            inputs = inputs if inputs.cameras else read_inputs(options, monitor=monitor)
        # The maps of a network come from its cache; the attributes are those already computed.
        given = found.prior or False
        row["warnings"] = locate_and_write(inputs, prior=given, monitor=monitor).result.warnings
        row["report"] = f"{options.out.name}/report.html"
    return row


def result_digest(tamper: np.ndarray, labels: np.ndarray) -> str:
    """SHA-256 of scores and labels by row of the file, as in tamper.npy and labels.npy."""
    content = np.asarray(tamper, np.float32).tobytes() + np.asarray(labels, bool).tobytes()
    return hashlib.sha256(content).hexdigest()
