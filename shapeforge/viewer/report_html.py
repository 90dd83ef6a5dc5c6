"""Small pieces of HTML that the report's sections are made of."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from shapeforge.collection.counts import THIN, grouped
from shapeforge.viewer import likeness, svg


def image(picture: np.ndarray | None, alt: str) -> str:
    """A picture as an ``img``, "" for None; ``alt`` says what it shows."""
    if picture is None:
        return ""
    height, width = picture.shape[:2]
    address = likeness.data_address(picture)
    return f'<img src="{address}" width="{width}" height="{height}" alt="{escape(alt, quote=True)}" loading="lazy">'


def table(rows: Sequence[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of ready HTML cells; numbers stand right, and above a column of them so does its heading."""

    def is_number(text: str) -> bool:
        return re.fullmatch(rf"[\d. {THIN}−e+-]+( s| %)?|–", text) is not None

    def cell(text: str, right: bool, kind: str = "td") -> str:
        return f"<{kind}{' class=n' if right else ''}>{text}</{kind}>"

    columns = [[row[i] for row in rows if i < len(row) and row[i]] for i in range(len(head))]
    above = [bool(column) and all(map(is_number, column)) for column in columns]
    top = "".join(cell(text, right, "th") for text, right in zip(head, above, strict=True))
    top = f"<thead><tr>{top}</tr></thead>" if head else ""
    body = "".join(f"<tr>{''.join(cell(text, is_number(text)) for text in row)}</tr>" for row in rows)
    return f"<div class=scroll><table>{top}<tbody>{body}</tbody></table></div>"


def dot(colour: Sequence[int] | np.ndarray | str) -> str:
    """A small square in a colour ("#RRGGBB" or red, green, blue)."""
    text = colour if isinstance(colour, str) else "#{:02X}{:02X}{:02X}".format(*(int(c) for c in colour))
    return f'<span class=dot style="background:{text}"></span>'


def percent(share: float) -> str:
    """A share as a whole percentage."""
    return f"{100 * share:.0f} %"


def number(value: Any) -> str:
    """A figure with three digits that count, or an escaped text."""
    if isinstance(value, bool | str):
        return escape(str(value))
    if not np.isfinite(float(value)):
        return "–"
    return svg.number(float(f"{float(value):.3g}")) if abs(value) < 1000 else grouped(round(value))
