"""Who is asked, and how: from the options of `locate` to a configuration and a detector."""

import dataclasses
import math
from pathlib import Path

from gsc_jax.cli.cache import default_cache
from gsc_jax.cli.config_file import read_settings
from gsc_jax.cli.interruption import Interruptible
from gsc_jax.cli.options import Locate
from gsc_jax.detectors.cache import CachedDetector
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.detectors.safire import SafireDetector
from gsc_jax.detectors.specs import PLAIN, PRESETS, OnnxSpec, preset, read_spec, spec_beside
from gsc_jax.estimators.gschecker import CONFIGS, Config, MethodConfig
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.evidence.detector import Detector
from gsc_jax.scene import InputError

NATIVE, NOBODY = Path("native"), Path("none")
"""What may be said to --detector instead of a file."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asked:
    """Who is asked.

    Attributes:
        options: The options, with the spec that lies beside the model.
        config: Of the method.
        native: Whether the Gaussians themselves are asked.
        detector: Who judges the views; None where nobody does.
        network: The 2D network behind it; None where there is none.
    """

    options: Locate
    config: Config
    native: bool
    detector: Detector | None
    network: Interruptible | None


def who_is_asked(options: Locate) -> Asked:
    """Opens whoever is asked, and refuses what contradicts itself.

    Args:
        options: The arguments of the command line.

    Raises:
        InputError: if an option means nothing, or there is nothing to go by.
    """
    config, options = method_config(options), _with_spec(options)
    native = _asks_native(options, config)
    detector, network = _detector(options, native)
    return Asked(options=options, config=config, native=native, detector=detector, network=network)


def method_config(options: Locate) -> Config:
    """The method with what was asked for changed; None leaves a value to the method."""
    method = CONFIGS[options.method]
    if options.config is not None:
        method = read_settings(options.config).about(options.method).config
    if options.threshold is not None and not 0 <= options.threshold < 1:
        raise InputError(f"--threshold {options.threshold:g}: expected 0 or more, and less than 1")
    common = {
        "threshold": method.threshold if options.threshold is None else options.threshold,
        "near": options.near,
        "mask_rule": options.mask_rule or method.mask_rule,
        "seed": options.seed,
    }
    if isinstance(method, MethodConfig):
        return dataclasses.replace(_schedule(options, method), **common)
    for flag, value in (("lambda2", options.lambda2), ("epochs", options.epochs)):
        if value is not None:
            raise InputError(
                f"--{flag} {value:g}: only applies to --method official or paper, expected one of "
                f"them, found {options.method}"
            )
    tolerance = 0.0 if options.all_views or options.views else method.tolerance
    return dataclasses.replace(method, tolerance=tolerance, **common)


def _schedule(options: Locate, method: MethodConfig) -> MethodConfig:
    """GS-Checker with the price and the epochs that were asked for."""
    if options.epochs is not None and options.epochs < 1:
        raise InputError(f"--epochs {options.epochs}: expected at least one")
    lambda2 = method.loop.lambda2 if options.lambda2 is None else options.lambda2
    if not (math.isfinite(lambda2) and lambda2 >= 0):
        raise InputError(f"--lambda2 {lambda2:g}: expected 0 or more")
    loop = dataclasses.replace(method.loop, lambda2=lambda2)
    return dataclasses.replace(method, epochs=options.epochs or method.epochs, loop=loop)


def network_path(options: Locate) -> Path | None:
    """The 2D network among those to be asked."""
    asked = [path for path in options.detector if path not in (NATIVE, NOBODY)]
    alone = NOBODY in options.detector and len(options.detector) > 1
    if len(asked) > 1 or options.detector.count(NATIVE) > 1 or alone:
        raise InputError(
            f"--detector {' '.join(map(str, options.detector))}: expected none, or native, one 2D "
            "network, or both"
        )
    return asked[0] if asked else None


def _asks_native(options: Locate, config: Config) -> bool:
    """Whether the Gaussians themselves are asked; by default where the method can listen."""
    named = NATIVE in options.detector
    if not isinstance(config, RobustConfig):
        if named:
            raise InputError(
                f"--method {options.method}: listens to masks only, and not to --detector native; "
                "use --method robust"
            )
        return False
    if named and config.native == 0:
        raise InputError(
            f"{options.config}: config.native: is 0, so that --detector native would have no say; "
            "expected more, or another --detector"
        )
    return config.native > 0 and (named or not options.detector)


def _detector(options: Locate, native: bool) -> tuple[Detector | None, Interruptible | None]:
    """Who judges the views, and the network behind it: the folder of masks, or the network."""
    network = network_path(options)
    if options.masks is not None and network is not None:
        raise InputError(
            f"--masks {options.masks} and --detector {network}: give one of the two; the masks of "
            "several detectors cannot be told apart by the names of the cameras"
        )
    if network is not None:
        return _opened(network, options)
    for flag in ("preset", "spec", "provider", "threads"):
        if getattr(options, flag) is not None:
            raise InputError(f"--{flag} says how to run a 2D network; --detector names none")
    if options.masks is not None:
        return _masks(options, options.masks), None
    if not native:
        nobody = " --detector none" if NOBODY in options.detector else ""
        raise InputError(
            f"--method {options.method}{nobody}: nothing to go by; give the masks of a 2D detector "
            "(--masks DIR), the detector itself (--detector MODEL.onnx), or ask the Gaussians "
            "(--method robust --detector native, and no config.native = 0 in --config)"
        )
    return None, None


def _masks(options: Locate, folder: Path) -> FolderDetector:
    if options.cameras is None:
        raise InputError(
            f"--masks {folder}: masks belong to cameras, give those with --cameras "
            "(`gsc-jax render` writes a cameras.json when it makes an orbit)"
        )
    return FolderDetector(folder)


def _opened(path: Path, options: Locate) -> tuple[Detector, Interruptible]:
    """A 2D network, which remembers what it said unless told not to."""
    if str(path) in PRESETS and not path.exists():
        raise InputError(
            f"--detector {path}: is the name of a preset, expected an ONNX model; export the "
            f"network and give --detector MODEL.onnx --preset {path}"
        )
    run = {"providers": [options.provider or "cpu"], "threads": options.threads or 0}
    if path.is_dir():
        if options.preset or options.spec:
            raise InputError(
                f"--detector {path}: a folder is taken for SAFIRE's two networks, which need no "
                "--preset and no --spec"
            )
        model = SafireDetector(path, **run)
    else:
        model = OnnxDetector(path, _spec(options), **run)
    network = Interruptible(model)
    if options.no_cache:
        return network, network
    return CachedDetector(network, default_cache() / "detections", model.fingerprint), network


def _spec(options: Locate) -> OnnxSpec:
    if options.preset and options.spec:
        raise InputError(f"--preset {options.preset} and --spec {options.spec}: give one of them")
    if options.preset:
        return preset(options.preset)
    return read_spec(options.spec) if options.spec else PLAIN


def _with_spec(options: Locate) -> Locate:
    """The options with the spec that lies beside the model, so that the report names it."""
    network = network_path(options)
    if network is None or network.is_dir() or options.preset or options.spec:
        return options
    return dataclasses.replace(options, spec=spec_beside(network))
