"""Colours of the window, the pictures, the plots and the report: one place, so that they agree everywhere."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float, Int, UInt8

from shapeforge.collection.colours import as_hex, colour_table, cycle, rgb
from shapeforge.collection.colours import part_colours as part_colours

Theme = Literal["dark", "light"]

DARK: dict[str, str] = {
    "window": "#1B1C1F",
    "panel": "#232428",
    "view": "#17181B",
    "control": "#2D2F34",
    "control_hover": "#363940",
    "separator": "#34363C",
    "separator_strong": "#45484F",
    "text": "#E8E9EC",
    "text_2": "#A9ADB6",
    "text_off": "#7E828D",
    "accent": "#4F8CFF",
    "accent_ground": "#26375A",
    "accent_text": "#8DB5FF",
    "on_accent": "#FFFFFF",
    "ok": "#57B894",
    "warning": "#E8B54A",
    "error": "#F0787A",
    "tooltip": "#0E0F11",
    "tooltip_text": "#E8E9EC",
    "shape": "#B4B7BD",
    "floor": "#0C0D0F",
}
LIGHT: dict[str, str] = {
    "window": "#F1F2F4",
    "panel": "#FFFFFF",
    "view": "#E9EBEE",
    "control": "#F0F1F4",
    "control_hover": "#E6E8EC",
    "separator": "#DCDEE3",
    "separator_strong": "#C3C7CF",
    "text": "#1D1F24",
    "text_2": "#565B66",
    "text_off": "#7C818C",
    "accent": "#2F6FED",
    "accent_ground": "#DCE8FF",
    "accent_text": "#1F57C9",
    "on_accent": "#FFFFFF",
    "ok": "#1F8A63",
    "warning": "#A86B00",
    "error": "#C23B3E",
    "tooltip": "#24262B",
    "tooltip_text": "#F4F5F7",
    "shape": "#CDD0D6",
    "floor": "#C4C8CF",
}

GROUPS: tuple[str, ...] = ("#9DB4E0", "#D9A8BF", "#D8C08A", "#B3CB95", "#8FC9CB", "#C2AEE0", "#E0AE94", "#A9C4B4")
# The second stop is darker than the first, so that lightness falls all the way and heat reads in grey, too.
HEAT: tuple[str, ...] = ("#D3D6DC", "#EDCB93", "#F0934A", "#CF3B1E", "#7D0A12")
UNPAINTED = "#B4B7BD"
SWITCHED_OFF = "#7A7E88"


def tokens(theme: Theme) -> dict[str, str]:
    """The named colours of a theme, each "#RRGGBB"."""
    return LIGHT if theme == "light" else DARK


def group_colours(n: int) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) of groups 0..n-1: soft, so that they are not mistaken for parts."""
    return cycle(GROUPS, n)


def label_colours(labels: Int[np.ndarray, " n"], inks: UInt8[np.ndarray, "L 3"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) of part indices (n,), the parts' being ``inks``; -1 (and what is no part) is unpainted grey."""
    table = np.vstack([inks, colour_table((UNPAINTED,))])
    known = (labels >= 0) & (labels < len(inks))
    return table[np.where(known, labels, len(inks))]


def heat(values: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) of values in 0..1 (clipped; NaN is 0); lightness falls all the way, so it reads in grey too."""
    stops = colour_table(HEAT).astype(float)
    at = np.clip(np.nan_to_num(np.asarray(values, dtype=float)), 0.0, 1.0) * (len(stops) - 1)
    low = np.minimum(at.astype(int), len(stops) - 2)
    share = (at - low)[:, None]
    return np.round((1 - share) * stops[low] + share * stops[low + 1]).astype(np.uint8)


def pale(
    colours: UInt8[np.ndarray, "n 3"], sure: Float[np.ndarray, " n"], ground: str = UNPAINTED
) -> UInt8[np.ndarray, "n 3"]:
    """Colours (n, 3) faded towards ``ground`` where ``sure`` (n,) in 0..1 is low: pale means unsure."""
    share = np.clip(sure, 0.0, 1.0)[:, None]
    return np.round(share * colours + (1 - share) * np.array(rgb(ground))).astype(np.uint8)


def mix(first: str, second: str, share: float) -> str:
    """The colour "#RRGGBB" that is ``share`` (0..1) of ``first`` and the rest ``second``."""
    blend = [round(share * a + (1 - share) * b) for a, b in zip(rgb(first), rgb(second), strict=True)]
    return as_hex(np.array(blend, np.uint8))
