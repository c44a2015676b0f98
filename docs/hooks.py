"""What MkDocs asks while it builds the site: help texts as the program prints them, whole numbers.

Where a page says `<!-- help -->` there follows what `gsc-jax --help` and the help of each of its
commands print, so that the page and the program cannot disagree.
"""

import os
import re
import subprocess
import sys
import textwrap
from typing import Any

WIDTH = 80
PLACE = "<!-- help -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts the help texts where a page asks for them, and keeps a value and its spread together.

    Args:
        markdown: The page.

    Returns:
        The page for the site.
    """
    markdown = markdown.replace(" ± ", "\u00a0±\u00a0")
    return markdown.replace(PLACE, all_help()) if PLACE in markdown else markdown


def all_help() -> str:
    """What the program says of itself, and a section for each of its commands."""
    program = help_of()
    # What follows the options repeats what each command says.
    about = re.split(r"\n\W*options\W*\n", program)[0].partition("\n\n")[2].strip()
    sections = (f"## {name}\n\n```text\n{help_of(name)}\n```" for name in commands(program))
    return "\n\n".join([f"```text\n{about}\n```", *sections])


def commands(program: str) -> list[str]:
    """The commands that the help of the program names, in its order."""
    named = re.search(r"\{([\w,-]+)\}", program)
    return named[1].split(",") if named else []


def help_of(*command: str) -> str:
    """The help of a command or of the program, without the frames around its parts."""
    plain = {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb", "PYTHONIOENCODING": "utf-8"}
    said = subprocess.run(
        [sys.executable, "-m", "gsc_jax", *command, "--help"],
        env={**os.environ, **plain},
        capture_output=True,
        encoding="utf-8",
        check=True,
    )
    lines = map(_unframed, said.stdout.strip().splitlines())
    return "\n".join(line for line in lines if line is not None)


def _unframed(line: str) -> str | None:
    """A line as it is without a frame; None of the lower edge of one."""
    if line.startswith("╰"):
        return None
    if title := re.match(r"╭─ (.*?) ─*╮$", line):
        return f"\n{title[1]}:"
    inside = re.match(r"│ ?(.*?) *│$", line)
    line = f"  {inside[1]}" if inside else line.rstrip()
    return line if len(line) <= WIDTH else textwrap.fill(line, WIDTH)
