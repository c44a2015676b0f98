"""gsc_jax finds the tampered Gaussians of a 3D Gaussian Splatting model.

Names are imported when they are first used, so that `import gsc_jax` is fast.
"""

import importlib
import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gsc_jax.detectors.folder import FolderDetector
    from gsc_jax.detectors.onnx import OnnxDetector
    from gsc_jax.detectors.specs import OnnxSpec
    from gsc_jax.estimators import METHODS, GSChecker, Prior, RobustEstimator, estimate, sweep
    from gsc_jax.evidence.lifting import Evidence
    from gsc_jax.evidence.masks import rendered_share, view_mask
    from gsc_jax.evidence.monitor import Monitor
    from gsc_jax.evidence.observation import Observation, observe
    from gsc_jax.forensics.evidence import estimate_from_attributes, forensic_evidence
    from gsc_jax.io.cameras import load_cameras, save_cameras
    from gsc_jax.io.ply import load_ply, read_ply, save_ply
    from gsc_jax.locate import Result, locate
    from gsc_jax.loop import LoopConfig
    from gsc_jax.render.orbit import orbit_cameras
    from gsc_jax.render.reprojection import reprojected
    from gsc_jax.render.tiles import make_view
    from gsc_jax.scene import Camera, Gaussians, InputError
    from gsc_jax.splat import accumulate_maps as accumulate
    from gsc_jax.splat import render, render_features, render_view

__all__ = [
    "METHODS",
    "Camera",
    "Evidence",
    "FolderDetector",
    "GSChecker",
    "Gaussians",
    "InputError",
    "LoopConfig",
    "Monitor",
    "Observation",
    "OnnxDetector",
    "OnnxSpec",
    "Prior",
    "Result",
    "RobustEstimator",
    "accumulate",
    "estimate",
    "estimate_from_attributes",
    "forensic_evidence",
    "load_cameras",
    "load_ply",
    "locate",
    "make_view",
    "observe",
    "orbit_cameras",
    "read_ply",
    "render",
    "render_features",
    "render_view",
    "rendered_share",
    "reprojected",
    "save_cameras",
    "save_ply",
    "sweep",
    "view_mask",
]

_MODULES = {
    "detectors.folder": ("FolderDetector",),
    "detectors.onnx": ("OnnxDetector",),
    "detectors.specs": ("OnnxSpec",),
    "estimators": ("METHODS", "GSChecker", "Prior", "RobustEstimator", "estimate", "sweep"),
    "evidence.lifting": ("Evidence",),
    "evidence.masks": ("rendered_share", "view_mask"),
    "evidence.monitor": ("Monitor",),
    "evidence.observation": ("Observation", "observe"),
    "forensics.evidence": ("estimate_from_attributes", "forensic_evidence"),
    "io.cameras": ("load_cameras", "save_cameras"),
    "io.ply": ("load_ply", "read_ply", "save_ply"),
    "locate": ("Result", "locate"),
    "loop": ("LoopConfig",),
    "render.orbit": ("orbit_cameras",),
    "render.reprojection": ("reprojected",),
    "render.tiles": ("make_view",),
    "scene": ("Camera", "Gaussians", "InputError"),
    "splat": ("render", "render_features", "render_view"),
}


def __getattr__(name: str) -> Any:
    """Import a public name (PEP 562)."""
    if name == "accumulate":
        return importlib.import_module("gsc_jax.splat").accumulate_maps
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"gsc_jax.{module}"), name)
    raise AttributeError(f"module 'gsc_jax' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names for completion in interactive sessions."""
    return sorted({*globals(), *__all__})


class _Package(types.ModuleType):
    """Keep `gsc_jax.locate` and `gsc_jax.render` functions.

    Importing the modules of the same names would replace them by these modules.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in __all__ or not isinstance(value, types.ModuleType):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
