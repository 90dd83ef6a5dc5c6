"""Small plots as inline SVG text.  Colours are the page's CSS variables, so one plot serves light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

Numbers = Sequence[float | int] | np.ndarray
LEFT, RIGHT, TOP, BOTTOM = 76, 16, 14, 42


@dataclass(frozen=True, eq=False)
class Series:
    """One line of a plot: values at the plot's places, NaN where there is none; ``colour`` is any CSS colour."""

    name: str
    values: Numbers
    colour: str = "var(--accent)"


def curve(
    at: Numbers,
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    title: str,
    from_zero: bool = False,
    phases: tuple[float, str, str] | None = None,
    width: int = 560,
    height: int = 240,
) -> str:
    """Lines over ``at`` with ticks, axis labels (units belong into them) and, for more than one line, their names.

    ``phases`` are a place of ``at`` and what comes before and after it: there stands a line that none of the lines
    crosses, as what they tell of is not the same on its two sides.
    """
    x = np.asarray(at, dtype=float)
    lines = [np.asarray(one.values, dtype=float) for one in series]
    if not lines or any(len(line) != len(x) for line in lines):
        raise ValueError(f"series: wanted lines of {len(x)} values, got {[len(line) for line in lines]}")
    known = np.concatenate([line[np.isfinite(line)] for line in lines])
    if not len(known):
        return ""
    ticks = nice_ticks(min(float(known.min()), 0.0) if from_zero else float(known.min()), float(known.max()))
    low, high = ticks[0], ticks[-1]
    x_low, x_high = float(x.min()), float(x.max()) if x.max() > x.min() else float(x.min()) + 1
    top = TOP + 20 * (len(series) > 1) + 16 * (phases is not None)  # room for the names
    inner = (width - LEFT - RIGHT, height - top - BOTTOM)

    def place(a: float, b: float) -> tuple[float, float]:
        across = LEFT + (a - x_low) / (x_high - x_low) * inner[0]
        return round(across, 1), round(top + (high - b) / (high - low) * inner[1], 1)

    parts = [_start(title, width, height)]
    for tick in ticks:
        _, y = place(x_low, tick)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{width - RIGHT}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{y + 4}" text-anchor="end">{number(tick)}</text>')
    for tick in _ticks_within(x_low, x_high):
        across, _ = place(tick, low)
        parts.append(
            f'<text class="tick" x="{across}" y="{height - BOTTOM + 18}" text-anchor="middle">{number(tick)}</text>'
        )
    for one, line in zip(series, lines, strict=True):
        there = np.isfinite(line)
        divider = np.inf if phases is None else phases[0]
        for run in (there & (x < divider), there & (x >= divider)):
            if run.any():
                points = [place(a, b) for a, b in zip(x[run], line[run], strict=True)]
                parts += _line(points, one.colour, dots=bool(there.sum() <= 40))
    if phases is not None:
        parts += _divider(place(phases[0], low)[0], phases[1:], top, top + inner[1])
    parts += _axis_labels(x_label, y_label, LEFT + inner[0] / 2, top + inner[1] / 2, height)
    if len(series) > 1:
        parts += _names(series, width - RIGHT)
    return "".join(parts) + "</svg>"


def _line(points: Sequence[tuple[float, float]], colour: str, *, dots: bool) -> list[str]:
    """A line through ``points`` (pixels), each marked by a dot if asked."""
    path = " ".join(f"{a},{b}" for a, b in points)
    found = [f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>']
    if dots:
        found += [f'<circle cx="{a}" cy="{b}" r="2.6" fill="{colour}"/>' for a, b in points]
    return found


def _divider(across: float, names: tuple[str, str], top: int, bottom: int) -> list[str]:
    """An upright line at ``across`` (pixels), and the names of what lies before and behind it."""
    found = [f'<line class="divider" x1="{across}" x2="{across}" y1="{top - 16}" y2="{bottom}"/>']
    for words, at, anchor in zip(names, (across - 8, across + 8), ("end", "start"), strict=True):
        found.append(f'<text class="tick" x="{at}" y="{top - 6}" text-anchor="{anchor}">{escape(words)}</text>')
    return found


def _axis_labels(x_label: str, y_label: str, across: float, middle: float, height: int) -> list[str]:
    """The words below and, upright, beside a plot whose middle is at (``across``, ``middle``)."""
    return [
        f'<text class="label" x="{across}" y="{height - 6}" text-anchor="middle">{escape(x_label)}</text>',
        f'<text class="label" x="14" y="{middle}" text-anchor="middle" transform="rotate(-90 14 {middle})">'
        f"{escape(y_label)}</text>",
    ]


def _names(series: Sequence[Series], right: int) -> list[str]:
    """The names of the lines, the last one ending at ``right``."""
    found, across = [], right
    for one in reversed(series):
        across -= 7 * len(one.name) + 24
        found.append(f'<circle cx="{across}" cy="{TOP}" r="4" fill="{one.colour}"/>')
        found.append(f'<text class="tick" x="{across + 8}" y="{TOP + 4}">{escape(one.name)}</text>')
    return found


def histogram(
    counts: Numbers, edges: Numbers, *, title: str, width: int = 200,
    height: int = 44,
) -> str:  # fmt: skip
    """Bars between ``edges`` without axes, for under a slider; zero is marked when it is in the range."""
    counts, edges = np.asarray(counts, dtype=float), np.asarray(edges, dtype=float)
    if len(edges) != len(counts) + 1:
        raise ValueError(f"edges: wanted {len(counts) + 1} edges for {len(counts)} bars, got {len(edges)}")
    parts = [_start(title, width, height, stretch=True)]
    span = max(float(edges[-1] - edges[0]), 1e-12)
    top = max(float(counts.max(initial=0)), 1e-12)
    for count, a, b in zip(counts, edges[:-1], edges[1:], strict=True):
        x0, x1 = (a - edges[0]) / span * width, (b - edges[0]) / span * width
        tall = count / top * (height - 4)
        parts.append(
            f'<rect x="{x0 + 0.5:.1f}" y="{height - tall:.1f}" width="{max(x1 - x0 - 1, 0.5):.1f}" height="{tall:.1f}" '
            'fill="var(--bar)"/>'
        )
    if edges[0] < 0 < edges[-1]:
        zero = -edges[0] / span * width
        parts.append(f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="0" y2="{height}" stroke="var(--accent)"/>')
    return "".join(parts) + "</svg>"


def shares(values: Numbers, names: Sequence[str], colours: Sequence[str], *, title: str, width: int = 200) -> str:
    """One bar cut into coloured shares (they are scaled to fill it)."""
    total = max(float(np.sum(values)), 1e-12)
    parts, x = [_start(title, width, 8, stretch=True)], 0.0
    for value, name, colour in zip(values, names, colours, strict=True):
        wide = float(value) / total * width
        parts.append(f'<rect x="{x:.1f}" y="0" width="{wide:.1f}" height="8" fill="{colour}"><title>')
        parts.append(f"{escape(name)} {100 * float(value) / total:.0f} %</title></rect>")
        x += wide
    return "".join(parts) + "</svg>"


def nice_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers around [low, high], at most ``most`` + 1 of them, the first and last outside or on the ends."""
    if high <= low:
        room = max(abs(low), 1.0) * 0.5
        low, high = low - room, high + room
    rough = (high - low) / most
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(power * m for m in (1, 2, 2.5, 5, 10) if power * m >= rough * (1 - 1e-9))
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return [float(round(k * step, 12)) for k in range(int(first), int(last) + 1)]


def _ticks_within(low: float, high: float) -> list[float]:
    """Round numbers inside [low, high]; whole ones when there is room for several."""
    if high - low >= 3:
        step = max(1, int(np.ceil((high - low) / 10)))
        return [float(k) for k in range(int(np.ceil(low)), int(high) + 1, step)]
    inside = 1e-9 * max(high - low, 1e-12)
    ticks = [tick for tick in nice_ticks(low, high) if low - inside <= tick <= high + inside]
    whole = [tick for tick in ticks if tick == round(tick)]
    return whole if high - low >= 1 and len(whole) > 1 else ticks


def number(value: float) -> str:
    """A number as people write it: no trailing zeros, a true minus sign."""
    text = f"{value:.4g}"
    return text.replace("-", "\N{MINUS SIGN}") if "e" not in text else text


def _start(title: str, width: int, height: int, *, stretch: bool = False) -> str:
    ratio = ' preserveAspectRatio="none"' if stretch else ""
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}"{ratio} role="img" '
        f'aria-label="{escape(title, quote=True)}"><title>{escape(title)}</title>'
    )
