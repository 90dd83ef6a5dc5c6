"""What the command line says: progress on standard error, one-line errors, JSON on the last line."""

from __future__ import annotations

import codecs
import json
import math
import sys
from collections.abc import Iterator
from typing import Any

import typer

from shapeforge.collection.counts import THIN, counted

QUIET = ("stale", "partial", "start", "learn", "faces")
"""Phases whose steps are no lines of their own where there is no terminal for the bar: rounds are, epochs are not."""

TOGETHER = (("import", "read"), ("import", "orient"))
"""Stages and phases whose warnings are printed at the end, all of a file in one line."""

ODD_FILES = 20
"""Files whose warnings are printed at most: where z is up in all of a large collection, all of them are turned."""

PLAIN = {
    THIN: " ",
    "×": "x",
    "…": "...",
    "·": "-",
    "–": "-",
    "→": "->",
    "±": "+-",
    "°": " degrees",
}
"""What is written for a character that a terminal does not know; a question mark for others."""


def speak_plainly() -> None:
    """Let standard output and error write plain characters for those that their encoding does not have."""
    codecs.register_error("plain", _plain_characters)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="plain")


def _plain_characters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(PLAIN.get(one, "?") for one in error.object[error.start : error.end]), error.end


def follow(project: Any, steps: Iterator[Any], what: str) -> Any:
    """Iterate with a progress bar on standard error; the last progress.

    Problems are printed as they come, but warnings of files that are read at the end: what reading and comparing them
    found is one line for each.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, highlight=False, soft_wrap=True)
    columns = (
        TextColumn("{task.fields[stage]}"), TextColumn("[dim]{task.fields[phase]}"), BarColumn(24),
        MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("[dim]{task.description}", markup=True),
    )  # fmt: skip
    latest, odd = None, {}
    try:
        with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
            line = bar.add_task("", total=None, stage=what, phase="")
            for latest in steps:
                problem = latest.problem
                if problem is not None and problem.kind == "warning" and (latest.stage, latest.phase) in TOGETHER:
                    odd.setdefault(problem.file, []).append(problem)
                elif problem is not None:
                    mark = "not read" if problem.kind == "error" else "warning"
                    bar.console.print(f"  {mark}: {problem}", markup=False)
                elif latest.phase in ("stale", "partial"):
                    bar.console.print(f"  {latest.message}", markup=False)
                left = f", {spoken(latest.seconds_left)} left" if (latest.seconds_left or 0) >= 2 else ""
                bar.update(
                    line, completed=latest.step + latest.within, total=max(latest.of, 1), stage=latest.stage,
                    phase=latest.phase, description=escaped(latest.message + left),
                )  # fmt: skip
                if latest.phase in QUIET or latest.within or latest.stage not in ("fit", "refine"):
                    continue
                if not console.is_terminal:
                    console.print(f"  {latest.message}", markup=False)
    except KeyboardInterrupt:
        project.log(f"{what}: stopped from the keyboard")
        print("Stopped. Run the same command again and it goes on.", file=sys.stderr)
        raise typer.Exit(130) from None
    except Exception as error:
        project.log(f"{what}: {type(error).__name__}: {error}", error)
        raise
    finally:
        for problems in list(odd.values())[:ODD_FILES]:
            console.print(f"  warning: {type(problems[0]).together(problems)}", markup=False)
        if len(odd) > ODD_FILES:
            more = counted(len(odd) - ODD_FILES, "more file")
            console.print(f"  warning: {more} with something odd: shapeforge info {project.path}", markup=False)
    return latest


class PartlyDone(ValueError):
    """A verb that did some of what it was asked for; ``summary`` is what ``--json`` shows beside the error."""

    def __init__(self, reason: str, summary: dict[str, Any]) -> None:
        super().__init__(reason)
        self.summary = summary


def escaped(text: str) -> str:
    """Text without rich's markup, cut to what a terminal line holds."""
    from rich.markup import escape

    return escape(text if len(text) <= 80 else text[:79] + "…")


def spoken(seconds: float) -> str:
    """A duration for people: 40 s, 5 min, 2.5 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def one_line(error: BaseException) -> str:
    """An error as one sentence: ours carry their remedy, others are named."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "not enough memory. Close other programs, use fewer --points or fewer --jobs."
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}. Check the path, its permissions and the free space."
    if "cannot cache function" in text:  # numba: neither the package's folder nor the user's cache can be written
        return "there is no folder to keep compiled code in. Set NUMBA_CACHE_DIR to a folder that can be written."
    if isinstance(error, ValueError | RuntimeError) and text:
        return text
    return f"{type(error).__name__}: {text or 'no message'}. The traceback is in the project's shapeforge.log."


def print_json(value: dict[str, Any]) -> None:
    """One JSON object on one line, the last of the output."""
    typer.echo(json.dumps(_plain(value), allow_nan=False))


def _plain(value: Any) -> Any:
    """A value in JSON's types: None for what is no finite number, text for what JSON does not know."""
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
