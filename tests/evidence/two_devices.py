"""Program of `test_devices.py`: locate on all devices of JAX; prints the devices and a digest."""

import hashlib

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax import locate
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.evidence import observation

if __name__ == "__main__":
    made = tampered_room(count=3_000, views=8, heldout=1, width=64, height=48, seed=2)
    used, lift = set(), observation.view_evidence

    def spy(view, mask):
        """Note where the evidence of a view is computed."""
        evidence = lift(view, mask)
        used.update(device.id for device in jnp.asarray(evidence.total).devices())
        return evidence

    observation.view_evidence = spy
    flagged = np.arange(48 * 64).reshape(48, 64) % 7 == 0
    result = locate(made.gaussians, made.cameras, {c.name: flagged for c in made.cameras})
    arrays = [result.tamper, *result.masks.values()]
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
    print(jax.local_device_count(), len(used), digest.hexdigest())  # noqa: T201
