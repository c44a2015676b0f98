"""Views are spread over the devices of JAX, with the same result to the bit."""

import os
import subprocess
import sys
from pathlib import Path


def located_on(devices: int) -> tuple[int, int, str]:
    """Devices of JAX, devices that were used, and the digest of a run in a process of its own."""
    flags = f"--xla_force_host_platform_device_count={devices}"
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("two_devices.py"))],
        env={**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        check=True,
        capture_output=True,
        text=True,
    )
    known, used, digest = done.stdout.split()
    return int(known), int(used), digest


def test_two_devices_share_the_views_and_give_the_same_result():
    one, two = located_on(1), located_on(2)
    assert (one[:2], two[:2]) == ((1, 1), (2, 2))
    assert one[2] == two[2]
