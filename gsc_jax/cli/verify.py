"""`gsc-jax verify`: are results, and the inputs they came from, as they were?"""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from gsc_jax.cli.options import arg
from gsc_jax.cli.ownership import REPORTS, is_inside, listed_outputs
from gsc_jax.io.files import content_digest
from gsc_jax.io.tables import read_table
from gsc_jax.scene import InputError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verify:
    """Compare results, and their inputs, with the SHA-256 in their report.

    for example:
      gsc-jax verify found

    The report has no seal: pass on its SHA-256, which is printed.

    Attributes:
        folder: Folder with results of `locate`, `render` or `tamper`.
    """

    folder: Annotated[tyro.conf.Positional[Path], arg("DIR")]


def run_verify(options: Verify) -> tuple[list[str], list[str]]:
    """Compare all digests: lines to print, and warnings; changed files raise InputError."""
    out = options.folder
    listed = {name: digests for name in REPORTS if (digests := listed_outputs(out, name))}
    if not listed:
        kind = "holds" if out.is_dir() else "is no folder, and holds"
        raise InputError(f"{out}: {kind} no results with digests ({', '.join(REPORTS)})")
    report, outputs = next(iter(listed.items()))
    del outputs[report]
    gone = [f"{out / x}: is missing, {report} lists it" for x in outputs if not is_inside(out, x)]
    digests = [(out / name, sha256) for name, sha256 in outputs.items() if is_inside(out, name)]
    inputs = read_table(out / report, remedy="").get("inputs")
    inputs = inputs if isinstance(inputs, dict) else {}
    # A report from elsewhere may name a device, which could be read for ever.
    there = [path for path in inputs if Path(path).is_file() or Path(path).is_dir()]
    for path in there:
        facts = inputs[path]
        digests.append((Path(path), facts.get("sha256") if isinstance(facts, dict) else None))
    changed = gone + [
        f"{path}: has changed since the run: its SHA-256 is {found[:16]}..., in {report} "
        f"{str(sha256)[:16]}..."
        for path, sha256 in digests
        if (found := content_digest(path)) != sha256
    ]
    if changed:
        more = f"; and {len(changed) - 10} more" if changed[10:] else ""
        raise InputError(f"{'; '.join(changed[:10])}{more}; use unchanged copies")
    absent = "is not there and was not compared; a relative path starts where the run did"
    return [
        f"outputs  {len(outputs)} files are as they were written",
        f"inputs   {len(there)} are as they were read, {len(inputs) - len(there)} not compared",
        f"report   {out / report}: SHA-256 {content_digest(out / report)}",
    ], [f"{path}: {absent}" for path in inputs if path not in there]
