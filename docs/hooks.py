"""MkDocs hooks: fill in the placeholders of pages, and keep numbers and their spread together.

`<!-- help -->` becomes the output of `gsc-jax --help` and `gsc-jax COMMAND --help`, and
`<!-- public names -->` a table of `gsc_jax.__all__`. The reference documents each name once, in the
module that defines it.
"""

import os
import subprocess
import sys
from typing import Any

import griffe

import gsc_jax
from gsc_jax.cli.main import COMMANDS

WIDTH = 80
"""Columns of the help texts, which fit into a page of the site."""
HELP, PUBLIC_NAMES = "<!-- help -->", "<!-- public names -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in the placeholders, and put non-breaking spaces around `±`.

    Args:
        markdown: The page.

    Returns:
        The page for the site.
    """
    markdown = markdown.replace(" ± ", "\u00a0±\u00a0")
    if HELP in markdown:
        sections = (f"## {name}\n\n{help_text(name)}" for name in COMMANDS)
        markdown = markdown.replace(HELP, "\n\n".join([help_text(), *sections]))
    if PUBLIC_NAMES in markdown:
        markdown = markdown.replace(PUBLIC_NAMES, public_names())
    return markdown


def public_names() -> str:
    """The public names with the first line of their docstrings, as a table."""
    package = griffe.load("gsc_jax")
    rows = ["| name | content |", "|---|---|"]
    for name in sorted(gsc_jax.__all__, key=str.lower):
        target = package[package.imports[name].removeprefix("gsc_jax.")]
        if target.is_alias:
            target = target.final_target
        summary = target.docstring.value.partition("\n")[0]
        rows.append(f"| [`{name}`][{target.path}] | {summary} |")
    return "\n".join(rows)


class DefinitionsOnly(griffe.Extension):
    """Leave re-exported names out of the documentation of packages."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Remove the export lists of a package and of all packages in it."""
        pkg.exports = None
        for module in pkg.modules.values():
            if not module.is_alias:
                self.on_package(pkg=module)


def help_text(*command: str) -> str:
    """The help of a command or of the program, as a block of code."""
    # tyro draws plain rules instead of frames with this setting.
    plain = {"COLUMNS": str(WIDTH), "PYTHON_TYRO_UTF8_BOXES": "False", "PYTHONIOENCODING": "utf-8"}
    printed = subprocess.run(
        [sys.executable, "-m", "gsc_jax", *command, "--help"],
        env={**os.environ, **plain},
        capture_output=True,
        encoding="utf-8",
        check=True,
    )
    lines = (line.rstrip() for line in printed.stdout.strip().splitlines())
    return "\n".join(["```text", *lines, "```"])
