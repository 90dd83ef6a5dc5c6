"""Small pieces of HTML that the report's sections are made of."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from shapeforge.viewer import likeness, svg


def image(picture: np.ndarray | None, alt: str) -> str:
    """A picture as an ``img``, "" for None; ``alt`` says what it shows."""
    if picture is None:
        return ""
    height, width = picture.shape[:2]
    address = likeness.data_address(picture)
    return f'<img src="{address}" width="{width}" height="{height}" alt="{escape(alt, quote=True)}" loading="lazy">'


def table(rows: Sequence[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of ready HTML cells; numbers stand right."""

    def cell(text: str, kind: str = "td") -> str:
        numeric = (
            re.fullmatch(
                r"[\d.\N{NARROW NO-BREAK SPACE}\N{MINUS SIGN}e+-]+( s| %)?|–|took|value|ours|affine transfer", text
            )
            is not None
        )
        return f"<{kind}{' class=n' if numeric else ''}>{text}</{kind}>"

    top = f"<thead><tr>{''.join(cell(text, 'th') for text in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{''.join(cell(text) for text in row)}</tr>" for row in rows)
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
    return (
        svg.number(float(f"{float(value):.3g}"))
        if abs(value) < 1000
        else f"{float(value):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
    )
