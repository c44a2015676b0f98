"""`make fuzz N=1000000`: damaged inputs of all formats, a table, and exit code 1 for findings."""

import argparse
import functools
import sys
import time
from pathlib import Path

from fuzz.formats import FORMATS
from fuzz.harness import fuzz, table

say = functools.partial(print, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000, help="in total (default: 20000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--findings", type=Path, default=Path("findings"))
    options = parser.parse_args()
    began = time.monotonic()
    formats = [FORMATS[name] for name in options.formats]
    tallies = fuzz(formats, options.seed, options.inputs, options.findings)
    for tally in tallies:
        for finding in tally.findings:
            say(finding)
    say(table(tallies))
    say(f"seed {options.seed}, {time.monotonic() - began:.0f} s")
    return int(any(tally.findings for tally in tallies))


if __name__ == "__main__":
    sys.exit(main())
