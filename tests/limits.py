"""Ranges of the numbers of a configuration."""

import dataclasses
from typing import Any

import numpy as np
import pytest


def assert_limits(config: Any, name: str, least: float, most: float) -> None:
    """Check that the ends of a range are accepted and the next numbers refused; 1 is excluded."""
    below, above = np.nextafter(least, -np.inf), np.nextafter(most, np.inf)
    if isinstance(least, int):
        below, above = least - 1, most + 1
    elif most == 1 and name not in ("prior_weight", "covisibility"):
        most, above = np.nextafter(1, 0), 1.0  # a threshold below 1
    for value in (least, most):
        assert getattr(dataclasses.replace(config, **{name: type(least)(value)}), name) == value
    for value in (below, above):
        with pytest.raises(ValueError, match=name):
            dataclasses.replace(config, **{name: type(least)(value)})
