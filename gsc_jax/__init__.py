"""gsc_jax finds the tampered Gaussians of a 3D Gaussian Splatting model."""

from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.detectors.specs import OnnxSpec
from gsc_jax.estimators.gschecker import METHODS, MethodConfig
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.masks import rendered_share, view_mask
from gsc_jax.forensics.evidence import find_native, native_evidence
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.ply import load_ply, read_ply, save_ply
from gsc_jax.locate import Result, locate
from gsc_jax.loop import LoopConfig
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import accumulate_maps as accumulate
from gsc_jax.splat import render, render_features

__all__ = [
    "METHODS",
    "Camera",
    "Evidence",
    "FolderDetector",
    "Gaussians",
    "InputError",
    "LoopConfig",
    "MethodConfig",
    "OnnxDetector",
    "OnnxSpec",
    "Result",
    "RobustConfig",
    "accumulate",
    "find_native",
    "load_cameras",
    "load_ply",
    "locate",
    "make_view",
    "native_evidence",
    "orbit_cameras",
    "read_ply",
    "render",
    "render_features",
    "rendered_share",
    "save_cameras",
    "save_ply",
    "view_mask",
]
