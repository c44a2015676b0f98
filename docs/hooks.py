"""MkDocs hooks: insert the help texts of the program, and keep numbers and their spread together.

The placeholder `<!-- help -->` in a page becomes what `gsc-jax --help` and `gsc-jax COMMAND --help`
print.
"""

import os
import subprocess
import sys
from typing import Any

from gsc_jax.cli.main import COMMANDS

WIDTH = 80
"""Columns of the help texts, which fit into a page of the site."""
PLACEHOLDER = "<!-- help -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Insert help texts, and put non-breaking spaces around `±`.

    Args:
        markdown: The page.

    Returns:
        The page for the site.
    """
    markdown = markdown.replace(" ± ", "\u00a0±\u00a0")
    if PLACEHOLDER not in markdown:
        return markdown
    sections = (f"## {name}\n\n{help_text(name)}" for name in COMMANDS)
    return markdown.replace(PLACEHOLDER, "\n\n".join([help_text(), *sections]))


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
