"""Estimators: from the evidence of all views and a prior to a score and a label per Gaussian.

To add one, derive a frozen dataclass from `protocol.Estimator` and add its name to `Method` and
`METHODS`; `locate` and the command line then accept it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

from gsc_jax.estimators.gschecker import OFFICIAL, PAPER, GSChecker
from gsc_jax.estimators.protocol import Estimator, Finding, Prior
from gsc_jax.estimators.robust.estimator import RobustEstimator
from gsc_jax.evidence.observation import Observation
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.parallel import ViewThreads, bounded_map

__all__ = ["METHODS", "Estimator", "Finding", "GSChecker", "Method", "Prior", "RobustEstimator"]
__all__ += ["configured", "estimate", "sweep"]

Method = Literal["robust", "official", "paper"]
METHODS: Mapping[str, Estimator] = {one.name: one for one in (RobustEstimator(), OFFICIAL, PAPER)}
"""Every method with its default configuration."""


def configured(method: str | None = None, config: Estimator | None = None) -> Estimator:
    """The estimator of a method or a configuration, as `estimate` and `locate` take them.

    ValueError if there is no such method, or the configuration is no estimator or of another one.
    """
    if method is not None and method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if config is None:
        return METHODS[method or "robust"]
    if isinstance(config, type) or not hasattr(config, "estimate"):
        raise ValueError(f"config must be an estimator, got {type(config).__name__}")
    if method not in (None, config.name):
        raise ValueError(f"config is of the method {config.name!r}, got method {method!r}")
    return config


def estimate(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    observation: Observation,
    *,
    method: Method | None = None,
    config: Estimator | None = None,
    prior: Prior | None = None,
) -> Finding:
    """Estimate the tampered Gaussians of an observed scene.

    Args:
        gaussians: N Gaussians.
        cameras: The cameras of the observation, in its order.
        observation: Evidence and votes, from `observe`.
        method: The estimator; by default that of `config`, or else `robust`.
        config: Replaces the default configuration of the method.
        prior: Probability per Gaussian from another source, such as `forensic_evidence`.

    Returns:
        Scores and labels.

    Raises:
        ValueError: if the method is unknown, or method, configuration or observation do not match.
    """
    estimator = configured(method, config)
    names = [camera.name for camera in observation.cameras]
    if len(gaussians) != len(observation.gaussians) or [c.name for c in cameras] != names:
        raise ValueError(
            f"the observation is of {len(observation.gaussians)} Gaussians and {len(names)} views, "
            f"got {len(gaussians)} Gaussians and {len(cameras)} cameras; pass those of `observe`"
        )
    return estimator.estimate(observation, prior)


def sweep(observation: Observation, estimators: Iterable[Estimator]) -> Iterator[Finding]:
    """Apply many estimators to one observation, in threads.

    Args:
        observation: Evidence and votes, from `observe`.
        estimators: Estimators, e.g. one method under many configurations.

    Returns:
        Iterator over the findings, in the order of the estimators.
    """
    with ViewThreads(observation.evidence.shape[1]) as pool:
        yield from bounded_map(pool, lambda estimator: estimator.estimate(observation), estimators)
