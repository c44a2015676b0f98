"""Estimator and detectors of a run of `locate`, from its options."""

import dataclasses
from pathlib import Path
from typing import Any

from gsc_jax.cli.cache import cache_folder
from gsc_jax.cli.config_file import METHOD_OPTIONS, SHARED_FIELDS, read_config_file, replaced
from gsc_jax.cli.options import Locate
from gsc_jax.detectors.cache import CachedDetector
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.detectors.safire import SafireDetector
from gsc_jax.detectors.specs import PLAIN, PRESETS, read_spec, spec_beside
from gsc_jax.estimators import METHODS
from gsc_jax.estimators.protocol import Estimator
from gsc_jax.evidence.detector import Detector
from gsc_jax.io.files import memory_limit
from gsc_jax.io.validation import naming
from gsc_jax.scene import InputError

NATIVE, NONE = WORDS = Path("native"), Path("none")
"""Values of --detector that are not files."""


def configured_estimator(options: Locate) -> Estimator:
    """The estimator of --method, --config and the options; InputError if one is invalid for it."""
    base: Any = METHODS[options.method]
    if options.config is not None:
        base = read_config_file(options.config).for_method(options.method).estimator
    given = {name: getattr(options, name) for name in (*SHARED_FIELDS, *METHOD_OPTIONS)}
    changes = {name: value for name, value in given.items() if value is not None}
    if hasattr(base, "loop") and "lambda2" in changes:
        changes["loop"] = {"lambda2": changes.pop("lambda2")}
    for name in changes.keys() - {field.name for field in dataclasses.fields(base)}:
        raise InputError(f"--{name}: does not apply to --method {options.method}")
    if base.tolerance > 0 and (options.all_views or options.views):
        changes["tolerance"] = 0.0
    with naming(f"options of --method {options.method}", errors=ValueError):
        return replaced(base, changes)


def network_path(options: Locate) -> Path | None:
    """The 2D network among the values of --detector; InputError if there is more than one."""
    networks = [path for path in options.detector if path not in WORDS]
    combined = NONE in options.detector and len(options.detector) > 1
    if len(networks) > 1 or options.detector.count(NATIVE) > 1 or combined:
        raise InputError(
            f"--detector {' '.join(map(str, options.detector))}: expected none, or native, one 2D "
            "network, or both"
        )
    return networks[0] if networks else None


def uses_attributes(options: Locate, estimator: Estimator) -> bool:
    """Whether the attributes contribute evidence; InputError if the estimator cannot use them."""
    named = NATIVE in options.detector
    if named and not estimator.uses_prior:
        raise InputError(
            f"--method {options.method}: uses masks only (or config.prior_weight is 0), and not "
            "--detector native; use --method robust"
        )
    return estimator.uses_prior and (named or not options.detector)


def open_detector(options: Locate, *, attributes: bool) -> Detector | None:
    """Open the folder of masks or the 2D network; None if the options name neither.

    InputError if options contradict each other, a file is invalid, or there is no evidence.
    """
    network = network_path(options)
    if options.masks is not None and network is not None:
        raise InputError(f"--masks {options.masks} and --detector {network}: give one of the two")
    if network is not None:
        return _open_network(network, options)
    for flag in ("preset", "spec", "provider", "threads"):
        if getattr(options, flag) is not None:
            raise InputError(f"--{flag}: only applies to a 2D network; --detector names none")
    if options.masks is not None:
        if options.cameras is None:
            raise InputError(
                f"--masks {options.masks}: needs the cameras of the masks, --cameras "
                "(`gsc-jax render` writes a cameras.json when it creates an orbit)"
            )
        return FolderDetector(options.masks, max_bytes=memory_limit(options.memory))
    if not attributes:
        raise InputError(
            f"--method {options.method}: there is no evidence; give --masks DIR or --detector "
            "MODEL.onnx, or use the attributes (--method robust --detector native)"
        )
    return None


def _open_network(path: Path, options: Locate) -> Detector:
    """Load a 2D network; its outputs are cached unless --no-cache is given."""
    if not path.exists():
        preset = f"is a preset; give --detector MODEL.onnx --preset {path}"
        absent = "no such file, expected native, none or a model"
        raise InputError(f"--detector {path}: {preset if str(path) in PRESETS else absent}")
    runtime = {"providers": [options.provider or "cpu"], "threads": options.threads or 0}
    if path.is_dir():
        if options.preset or options.spec:
            raise InputError(f"--detector {path}: --preset and --spec do not apply to SAFIRE")
        model = SafireDetector(path, **runtime)
    else:
        if options.preset and options.spec:
            both = f"--preset {options.preset} and --spec {options.spec}"
            raise InputError(f"{both}: give one of them")
        spec = options.preset or (read_spec(options.spec) if options.spec else PLAIN)
        model = OnnxDetector(path, spec, **runtime)
    if options.no_cache:
        return model
    return CachedDetector(model, cache_folder() / "probability-maps", model.fingerprint)


def with_spec(options: Locate) -> Locate:
    """The options with --spec set to the file beside the model, so that the report names it."""
    network = network_path(options)
    if network is None or network.is_dir() or options.preset or options.spec:
        return options
    return dataclasses.replace(options, spec=spec_beside(network))
