"""What a scan does with each scene, and the digest that tells two configurations apart."""

import dataclasses
import hashlib
import importlib.metadata
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsc_jax import forensics
from gsc_jax.cli.outputs import PACKAGES, jsonable
from gsc_jax.detectors.session import external_files
from gsc_jax.io.files import GIB, content_digest, memory_limit
from gsc_jax.scene import InputError

WITHOUT_EFFECT = ("scene", "out", "config", "dry_run", "memory", "no_cache", "cameras", "masks")
"""Options that do not change the result of a scene; cameras and masks count by their content."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ScanSettings:
    """Settings of a scan, named as the options of `gsc-jax scan`, and the folder of compiled code.

    `command` has the options of `gsc-jax locate` for every scene. Nothing is written without `out`.
    The default memory of a worker is an equal share of half of the machine.
    """

    command: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    out: Path | None = None
    workers: int = 1
    cpus: int = 1
    memory: float | None = None
    timeout: float = 3600.0
    retries: int = 1
    report_above: float | None = None
    cache: Path | None = None

    def __post_init__(self) -> None:
        for name, least in {"workers": 1, "cpus": 1, "timeout": 1e-3, "retries": 0}.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise InputError(f"{name} {value:g}: expected a number of at least {least:g}")
        if self.report_above is not None and not 0 <= self.report_above <= 1:
            raise InputError(f"report_above {self.report_above:g}: expected a probability")
        memory_limit(self.memory)

    @property
    def worker_bytes(self) -> int:
        """Memory of a worker in bytes."""
        return int(self.memory * GIB) if self.memory else memory_limit() // self.workers

    def digest(self) -> str:
        """Digest of all that determines the result of a scene, besides its content."""
        options = {k: v for k, v in self.command.items() if k not in WITHOUT_EFFECT}
        used = [*options.get("detector", ()), options.get("spec"), self.command.get("config")]
        used.append(Path(forensics.__file__).with_name("classifier.npz"))
        files = [Path(path) for path in used if path and Path(path).exists()]
        files += [x for p in files if p.is_file() and p.stat().st_size for x in external_files(p)]
        facts = {
            "options": jsonable({k: v for k, v in options.items() if v is not None}),
            "files": [content_digest(path) for path in files],
            "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
        }
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
