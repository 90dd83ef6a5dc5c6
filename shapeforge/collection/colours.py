"""The colours of parts: the same in mesh files, views, palettes, plots and the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import UInt8

PARTS: tuple[str, ...] = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#F0E442",
    "#0072B2",
    # Beyond Okabe and Ito's seven: apart from them, and from each other, in lightness more than in hue.
    "#8C6BB1",
    "#B8D96E",
    "#7F4F24",
    "#F4A6A0",
    "#3C6E71",
)


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue (0..255) of a "#RRGGBB" colour."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def colour_table(colours: tuple[str, ...]) -> UInt8[np.ndarray, "n 3"]:
    """Red, green, blue (n, 3) of "#RRGGBB" colours."""
    return np.array([rgb(colour) for colour in colours], dtype=np.uint8)


def cycle(colours: tuple[str, ...], n: int) -> UInt8[np.ndarray, "n 3"]:
    """The first ``n`` colours; each further turn through the list is a quarter darker, so none repeats at once."""
    if n < 0:
        raise ValueError(f"n must be 0 or more, got {n}")
    index = np.arange(n)
    shade = 0.75 ** (index // len(colours))
    return np.round(colour_table(colours)[index % len(colours)] * shade[:, None]).astype(np.uint8)


def part_colours(n: int) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) of parts 0..n-1: the colour-blind-safe set of Okabe and Ito, extended."""
    return cycle(PARTS, n)


def inks_of(names: Sequence[str], chosen: Mapping[str, str]) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) of the parts called ``names``: those ``chosen`` ("#RRGGBB" by name), else by their place."""
    inks = part_colours(len(names))
    for part, name in enumerate(names):
        if chosen.get(name):
            inks[part] = rgb(chosen[name])
    return inks


def as_hex(ink: UInt8[np.ndarray, " 3"]) -> str:
    """A colour (3,) as "#RRGGBB"."""
    return "#{:02X}{:02X}{:02X}".format(*(int(c) for c in ink))
