"""How numbers of things are written, the same in every locale: 6 360 faces, 1 shape."""

from __future__ import annotations

from operator import index
from typing import SupportsIndex

THIN = "\N{NARROW NO-BREAK SPACE}"


def grouped(number: SupportsIndex) -> str:
    """A whole number with a thin space every three digits: 12 640."""
    return f"{index(number):,}".replace(",", THIN)


def counted(number: SupportsIndex, what: str) -> str:
    """A number of things in words: 1 shape, 1 200 shapes."""
    return f"{grouped(number)} {what}{'s' * (index(number) != 1)}"
