"""Mutation testing: would the tests notice a changed operator, number or condition?

    python tests/mutation.py [--samples 20] [--seed 0] [--modules losses loop]

Draws places of each module of `[tool.mutation]` in `pyproject.toml` at random, mutates each once
with an operator of cosmic-ray, runs the tests named there on a copy of the repository, and prints
the mutants that survive and a table. Annotations and decorators are not mutated: the tests do not
see the former, and without `jax.jit` a function is only slower.
"""

import dataclasses
import os
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import cosmic_ray.plugins
import tyro
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import TestOutcome
from parso.tree import NodeOrLeaf

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = ("NoOp", "RemoveDecorator", "VariableInserter", "VariableReplacer")
PATIENCE = 5
"""A mutant is killed if its tests take this many times as long as without mutation."""


@dataclasses.dataclass(frozen=True)
class Options:
    """What to mutate.

    Attributes:
        modules: Keys of `[tool.mutation]`; all by default.
        samples: Places to mutate per module.
        seed: Seed of the random choice.
    """

    modules: tuple[str, ...] = ()
    samples: int = 20
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Mutant:
    """One mutation: `operator` applied at its `occurrence`-th match in the file `path`."""

    path: str
    operator: str
    occurrence: int
    place: tuple[int, int]

    def code(self, source: str) -> str:
        """The mutated source."""
        mutated = mutate_code(
            source, cosmic_ray.plugins.get_operator(self.operator)(), self.occurrence
        )
        assert mutated is not None, "no such occurrence"
        return mutated

    def described(self, source: str) -> str:
        """The place, the line, and what it becomes."""
        line = self.place[0] - 1
        before, after = (text.splitlines()[line].strip() for text in (source, self.code(source)))
        return f"{self.path}:{line + 1}: `{before}` -> `{after}`"


def main(options: Options) -> None:
    """Test samples of all modules and print a table."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutation"]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copy = copied(Path(folder))
        os.environ |= {
            "JAX_COMPILATION_CACHE_DIR": f"{folder}/cache",
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        for name in options.modules or table:
            paths, tests = table[name]["code"], table[name]["tests"]
            chosen = sample(paths, options.samples, random.Random(f"{options.seed} {name}"))
            killed = sum(tested(copy, tests, chosen))
            rows.append(f"| {name} | {len(chosen)} | {killed} | {killed / len(chosen):.0%} |")
    print("\n| module | mutants | killed | rate |\n|---|---|---|---|", *rows, sep="\n")


def copied(folder: Path) -> Path:
    """Copy of the files of the repository, as they are now."""
    listed = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        target = folder / "copy" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    return folder / "copy"


def sample(paths: list[str], count: int, generator: random.Random) -> list[Mutant]:
    """One mutant each of at most `count` random places of these files."""
    at_place: dict[tuple[str, tuple[int, int]], list[Mutant]] = {}
    for path in paths:
        for mutant in mutants(path):
            at_place.setdefault((path, mutant.place), []).append(mutant)
    places = sorted(at_place)
    chosen = sorted(generator.sample(places, min(count, len(places))))
    return [generator.choice(at_place[place]) for place in chosen]


def mutants(path: str) -> Iterator[Mutant]:
    """All mutants of a file."""
    nodes = list(ast_nodes(get_ast((ROOT / path).read_text(encoding="utf-8"))))
    for name in sorted(cosmic_ray.plugins.operator_names()):
        if name.partition("/")[2].startswith(LEFT_OUT):
            continue
        operator = cosmic_ray.plugins.get_operator(name)()
        positions = (
            (node, start) for node in nodes for start, _ in operator.mutation_positions(node)
        )
        for occurrence, (node, start) in enumerate(positions):
            if not unseen(node):
                yield Mutant(path, name, occurrence, start)


def unseen(node: NodeOrLeaf) -> bool:
    """Whether a node belongs to a decorator, or to the annotation of anything."""
    while parent := node.parent:
        if parent.type == "decorator":
            return True
        index = parent.children.index(node)
        before = parent.children[index - 1] if index else None
        if parent.type in ("tfpdef", "annassign", "funcdef") and before in (":", "->"):
            return node.type != "suite"
        node = parent
    return False


def tested(copy: Path, tests: list[str], chosen: list[Mutant]) -> Iterator[bool]:
    """Whether the tests kill each of the mutants; prints those that survive."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    run = shlex.join(["env", "-C", str(copy), *command, *tests])
    start = time.monotonic()
    outcome, output = run_tests(run, None)
    if outcome != TestOutcome.SURVIVED:
        raise SystemExit(f"The tests fail without a mutation:\n{output}")
    limit = 20 + PATIENCE * (time.monotonic() - start)
    print(f"{' '.join(tests)}: {time.monotonic() - start:.0f} s, {len(chosen)} mutants", flush=True)
    for mutant in chosen:
        source = (ROOT / mutant.path).read_text(encoding="utf-8")
        (copy / mutant.path).write_text(mutant.code(source), encoding="utf-8")
        outcome, _ = run_tests(run, limit)
        (copy / mutant.path).write_text(source, encoding="utf-8")
        if outcome == TestOutcome.SURVIVED:
            print("  alive:", mutant.described(source), flush=True)
        yield outcome != TestOutcome.SURVIVED


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
