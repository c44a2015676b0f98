"""Package layout: imports run downwards without circles, sizes stay within bounds."""

import ast
import graphlib
from pathlib import Path

import gsc_jax

ROOT = Path(gsc_jax.__file__).parent
LAYERS = (
    ("scene",),
    ("render",),
    ("splat", "vote"),
    ("evidence",),
    ("losses", "loop"),
    ("estimators",),
    ("forensics",),
    ("locate", "io", "detectors", "benchmark"),
    ("cli", "collection"),
    ("__main__",),
)
"""Parts of the package from the lowest layer: modules import from their own layer or below."""
OUTSIDE_OF_THE_METHOD = {"io", "detectors", "benchmark", "cli", "collection"}
MAX_ENTRIES, MAX_LINES, MAX_FILE_LINES, MAX_BODY_LINES, MAX_PARAMETERS = 17, 17_000, 300, 40, 6
LOCATE = "locate"
"""The one function with more parameters: those of the contract, the prior, monitor and store."""
RANK = {part: rank for rank, parts in enumerate(LAYERS) for part in parts}
FILES = sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def imports_of(path: Path) -> set[str]:
    """Modules of the package that a file imports, as dotted names without `gsc_jax`."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("gsc_jax"):
            base = (node.module or "").removeprefix("gsc_jax").lstrip(".")
            names = {f"{base}.{alias.name}".strip(".") for alias in node.names}
            found |= {name if name in MODULES else base for name in names}
    return found - {""}


MODULES = {module_of(path) for path in FILES}
GRAPH = {module_of(path): imports_of(path) for path in FILES}


def part_of(module: str) -> str:
    return module.partition(".")[0]


def test_imports_run_downwards():
    upwards = {
        (module, target)
        for module, targets in GRAPH.items()
        for target in targets
        if RANK[part_of(target)] > RANK[part_of(module)]
    }
    assert not upwards


def test_imports_have_no_circles():
    graphlib.TopologicalSorter(GRAPH).prepare()


def test_the_method_imports_nothing_of_files_networks_and_commands():
    method = [m for m in GRAPH if RANK[part_of(m)] < RANK["locate"] or m == "locate"]
    assert {"locate", "splat", "forensics.evidence"} <= set(method)
    assert not {(m, t) for m in method for t in GRAPH[m] if part_of(t) in OUTSIDE_OF_THE_METHOD}


def test_the_package_stays_small():
    sources = [p for p in ROOT.rglob("*") if p.suffix in {".py", ".pyi", ".html", ".css", ".js"}]
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in sources}
    assert len({Path(path.relative_to(ROOT).parts[0]).stem for path in sources}) <= MAX_ENTRIES
    assert sum(lines.values()) <= MAX_LINES
    assert max(lines.values()) <= MAX_FILE_LINES


def test_functions_are_short_and_take_few_arguments():
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                doc = ast.get_docstring(node, clean=False) or ""
                body = (node.end_lineno or 0) - node.body[0].lineno + 1 - len(doc.splitlines())
                named = [a for a in [*node.args.args, *node.args.kwonlyargs] if a.arg != "self"]
                assert body <= MAX_BODY_LINES, f"{path}: {node.name} has {body} lines"
                most = MAX_PARAMETERS + 2 * (node.name == LOCATE)
                assert len(named) <= most, f"{path}: {node.name} has {len(named)} parameters"
