"""Names on the command line: several after one option, in a file, two with a sign between."""

from __future__ import annotations

from pathlib import Path

import typer


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
        found += file.read_text(encoding="utf-8").split("\n") if file.is_file() else text.split(",")
    return [name.strip() for name in found if name.strip()]
