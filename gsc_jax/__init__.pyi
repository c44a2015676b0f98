"""Public names, and the modules that `__init__.py` imports them from when they are first used."""

from .detectors.folder import FolderDetector
from .detectors.onnx import OnnxDetector
from .detectors.specs import OnnxSpec
from .estimators import METHODS, GSChecker, Prior, RobustEstimator, estimate, sweep
from .evidence.lifting import Evidence
from .evidence.masks import rendered_share, view_mask
from .evidence.monitor import Monitor
from .evidence.observation import Observation, observe
from .forensics.evidence import estimate_from_attributes, forensic_evidence
from .io.cameras import load_cameras, save_cameras
from .io.ply import load_ply, read_ply, save_ply
from .locate import Result, locate
from .loop import LoopConfig
from .render.orbit import orbit_cameras
from .render.reprojection import reprojected
from .render.tiles import make_view
from .scene import Camera, Gaussians, InputError
from .splat import accumulate_maps as accumulate, render, render_depth, render_features, render_view

__all__ = ["Camera", "Evidence", "FolderDetector", "GSChecker", "Gaussians", "InputError"]
__all__ += ["METHODS", "LoopConfig", "Monitor", "Observation", "OnnxDetector", "OnnxSpec", "Prior"]
__all__ += ["Result", "RobustEstimator", "accumulate", "estimate", "estimate_from_attributes"]
__all__ += ["forensic_evidence", "load_cameras", "load_ply", "locate", "make_view", "observe"]
__all__ += ["orbit_cameras", "read_ply", "render", "render_depth", "render_features", "render_view"]
__all__ += ["rendered_share", "reprojected", "save_cameras", "save_ply", "sweep", "view_mask"]
