"""Mutation testing: would the tests notice a changed operator, number or condition?

    python tests/mutation.py [--samples 20] [--seed 0] [--modules losses loop]

Draws places of each module of `[tool.mutation]` in `pyproject.toml` at random, mutates each once
with an operator of cosmic-ray, runs the tests named there on a copy of the repository, and prints
the mutants that survive and a table. Not mutated are annotations and their imports, which the tests
do not see, and decorators: without `jax.jit` a function is only slower. Code that Python cannot
compile is no mutant.
"""

import dataclasses
import importlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path

import cosmic_ray.plugins
import pytest
import tyro
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from parso.tree import NodeOrLeaf

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = ("NoOp", "RemoveDecorator", "VariableInserter", "VariableReplacer")
PATIENCE = 5
"""A mutant is killed if its tests take this many times as long as without mutation."""
LIBRARIES = (
    "hypothesis.extra.numpy",
    "jax.numpy",
    "optax",
    "plyfile",
    "scipy.spatial",
    "skimage.util",
)
"""Libraries of the package and its tests, imported before the forks."""
HANGS = 1800
"""Seconds after which tests that wait for something are stopped."""


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
    for library in LIBRARIES:
        importlib.import_module(library)
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
    source = (ROOT / path).read_text(encoding="utf-8")
    nodes = list(ast_nodes(get_ast(source)))
    for name in sorted(cosmic_ray.plugins.operator_names()):
        if name.partition("/")[2].startswith(LEFT_OUT):
            continue
        operator = cosmic_ray.plugins.get_operator(name)()
        positions = (
            (node, start) for node in nodes for start, _ in operator.mutation_positions(node)
        )
        for occurrence, (node, start) in enumerate(positions):
            mutant = Mutant(path, name, occurrence, start)
            if not unseen(node) and compiles(mutant.code(source)):
                yield mutant


def compiles(code: str) -> bool:
    """Whether Python accepts the code, as the tests run it: a warning is an error."""
    try:
        with warnings.catch_warnings(action="error"):
            compile(code, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def unseen(node: NodeOrLeaf) -> bool:
    """Whether a node belongs to a decorator, to an annotation, or to the imports for them."""
    while parent := node.parent:
        if parent.type == "decorator" or parent.get_code(False).startswith("if TYPE_CHECKING:"):
            return True
        index = parent.children.index(node)
        before = parent.children[index - 1] if index else None
        if parent.type in ("tfpdef", "annassign", "funcdef") and before in (":", "->"):
            return node.type != "suite"
        node = parent
    return False


def tested(copy: Path, tests: list[str], chosen: list[Mutant]) -> Iterator[bool]:
    """Whether the tests kill each of the mutants; prints those that survive."""
    passed, seconds = outcome(copy, tests, resource.RLIM_INFINITY)
    if not passed:
        raise SystemExit(f"Without a mutation, the tests fail: {' '.join(tests)}")
    print(f"{' '.join(tests)}: {seconds:.0f} s, {len(chosen)} mutants", flush=True)
    for mutant in chosen:
        source = (ROOT / mutant.path).read_text(encoding="utf-8")
        (copy / mutant.path).write_text(mutant.code(source), encoding="utf-8")
        alive, _ = outcome(copy, tests, 20 + round(PATIENCE * seconds))
        (copy / mutant.path).write_text(source, encoding="utf-8")
        if alive:
            print("  alive:", mutant.described(source), flush=True)
        yield not alive


def outcome(copy: Path, tests: list[str], limit: int) -> tuple[bool, float]:
    """Whether the tests pass in the copy within the limit, and their time, in seconds of CPU.

    They run in a fork, which spares the import of the libraries; nothing of the package is
    imported before.
    """
    sys.stdout.flush()
    child = os.fork()
    if not child:
        try:
            os._exit(pytest_in(copy, tests, limit))
        finally:
            os._exit(1)
    _, status, usage = os.wait4(child, 0)
    return status == 0, usage.ru_utime + usage.ru_stime


def pytest_in(copy: Path, tests: list[str], limit: int) -> int:
    """Exit code of the tests in the copy, without output."""
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    signal.alarm(HANGS)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    # Libraries that are imported here and bring plugins of pytest cannot be rewritten any more.
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    return pytest.main([*options, "-W", "ignore::pytest.PytestAssertRewriteWarning", *tests])


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
