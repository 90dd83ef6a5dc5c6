"""Words of the command line: options of many verbs; names after one option, in a file, two with a sign between."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ProjectPath = Annotated[Path, typer.Argument(metavar="PROJECT", help="Folder of the project.", show_default=False)]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of everything random (first run: 0).", show_default=False)]
Jobs = Annotated[int | None, typer.Option(min=1, help="Worker threads (default: one per processor).")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on the last line.")]
Restart = Annotated[bool, typer.Option("--restart", help="Redo all, even what is done.")]
Out = Annotated[Path, typer.Option(help="Folder to write to.", show_default=False)]


def named_after_option(first: list[str] | None, more: list[str] | None, option: str) -> list[str] | None:
    """``--option A B C`` as well as ``--option A --option B`` and ``--option A,B``."""
    if more and not first:
        raise typer.BadParameter(f"unexpected {more[0]!r}; names go after {option}")
    words = [word for text in [*(first or ()), *(more or ())] for word in text.split(",") if word]
    return words or None


def two_names(text: str, between: str, option: str) -> list[str]:
    """The two names in ``text``; raises the command line's error for anything else."""
    names = [name.strip() for name in text.split(between)]
    if len(names) != 2 or not all(names):
        raise typer.BadParameter(f"{option}: wanted two names with {between!r} between them, got {text!r}")
    return names


def names_in(given: list[str] | None) -> list[str] | None:
    """Names of shapes, from options that are names (also with commas between) or text files with one name a line."""
    if given is None:
        return None
    found: list[str] = []
    for text in given:
        file = Path(text)
        try:
            found += file.read_text(encoding="utf-8").split("\n") if file.is_file() else text.split(",")
        except UnicodeDecodeError:
            raise typer.BadParameter(f"{file}: wanted a text file with one name of a shape a line") from None
    return [name.strip() for name in found if name.strip()]
