"""A collection of scenes: each judged as `gsc-jax locate` judges it, on a cluster, with Ray."""

from gsc_jax.collection.scan import scan
from gsc_jax.collection.settings import ScanSettings

__all__ = ["ScanSettings", "scan"]
