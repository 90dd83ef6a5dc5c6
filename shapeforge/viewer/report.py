"""The report: one self-contained HTML page about a project, for people who don't have the program.

Pictures are embedded, plots are inline SVG, nothing is loaded from anywhere.  Light and dark follow the reader's
system.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from ctypes.util import find_library
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.viewer import report_measures
from shapeforge.viewer import report_sections as sections
from shapeforge.viewer.palette import DARK, LIGHT

MOST_SHAPES = 400
"""Shapes shown at most: the page stays below some 12 MB.  Beyond, an even selection that has all exemplars."""


def write_report(
    project: Any, path: str | Path, *, measures: Mapping[str, Any] | None = None, most: int = MOST_SHAPES
) -> Path:
    """Write the report of a project to ``path``; returns the path.

    ``measures`` is what ``validate`` found (shown as a table); ``most`` the number of shapes shown at most.
    Pictures are taken off screen: RuntimeError where there is no OpenGL, OSError where ``path`` cannot be written.
    """
    absent = [name for name in ("EGL", "GL") if find_library(name) is None]
    if sys.platform.startswith("linux") and absent:  # VTK would end the process
        raise RuntimeError(f"lib{absent[0]} is missing, pictures need it. Install it: sudo apt install libegl1 libgl1")
    path = Path(path)
    text = report_text(project, measures=measures, most=most)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".tmp")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
    return path


def report_text(project: Any, *, measures: Mapping[str, Any] | None = None, most: int = MOST_SHAPES) -> str:
    """The page as text.  Sections for which the project has nothing yet are left out."""
    shown = chosen_shapes(project, most)
    found = [
        ("overview", "Overview", sections.overview(project)),
        ("groups", "Groups", sections.groups(project)),
        ("shapes", "Shapes", sections.shapes(project, shown)),
        ("parts", "Parts", sections.parts(project, shown)),
        ("fit", "Fit", sections.fit(project)),
        ("family", "What varies", sections.directions(project)),
        ("new", "New shapes", sections.new_shapes(project)),
        ("measures", "Measures", report_measures.measures(project, measures)),
        ("problems", "Files", sections.problems(project)),
    ]
    there = [(anchor, title, body) for anchor, title, body in found if body]
    links = "".join(f'<a href="#{anchor}">{title}</a>' for anchor, title, _ in there)
    bodies = "".join(f'<section id="{anchor}"><h2>{title}</h2>{body}</section>' for anchor, title, body in there)
    name = escape(project.name)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{name} · shapeforge</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_css()}</style></head><body>'
        f"<header><h1>{name}</h1><p>{sections.sentence(project)}</p><nav>{links}</nav></header><main>{bodies}</main>"
        "<footer>Made with shapeforge. Lengths are in diagonals: 1 is the diagonal of a shape's bounding box.</footer>"
        "</body></html>\n"
    )


def chosen_shapes(project: Any, most: int) -> list[str]:
    """Names to show: all, or ``most`` of them evenly spread with every exemplar; by group, exemplars first."""
    names, groups = list(project.names), project.groups
    exemplars = set() if groups is None else {names[t] for t in groups.exemplars}
    if len(names) > most:
        rest = [name for name in names if name not in exemplars]
        room = max(most - len(exemplars), 0)
        picked = {rest[k] for k in np.linspace(0, len(rest) - 1, min(room, len(rest))).round().astype(int)}
        names = [name for name in names if name in picked or name in exemplars]
    if groups is None:
        return names
    index = {name: t for t, name in enumerate(project.names)}

    def order(name: str) -> tuple[int, bool, str]:
        group = int(groups.group[index[name]])
        return (group if group >= 0 else len(groups), name not in exemplars, name)

    return sorted(names, key=order)


def _css() -> str:
    def variables(tokens: Mapping[str, str], bar: str) -> str:
        names = (
            "window",
            "panel",
            "separator",
            "text",
            "text_2",
            "text_off",
            "accent",
            "accent_text",
            "ok",
            "warning",
            "error",
        )
        return "".join(f"--{name}:{tokens[name]};" for name in names) + f"--bar:{bar};"

    rules = files("shapeforge.viewer").joinpath("report.css").read_text(encoding="utf-8")
    light, dark = variables(LIGHT, "#B9C4D8"), variables(DARK, "#4A5568")
    return f":root{{color-scheme:light dark;{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}" + rules
