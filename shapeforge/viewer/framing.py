"""How a camera has to stand so that all that is shown is seen, with room for the words above and below it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from shapeforge.viewer.display import Display, MeshLayer, PointLayer, View
from shapeforge.viewer.look import VIEW_DIRECTION, frame_of

ASTRAY = 0.25
"""Points farther from the box of the shape they lie on than this (of its diagonal) may be out of sight."""


def contents(display: Display) -> list[Float[np.ndarray, "n 3"]]:
    """Finite corners and points (n, 3) that are to be seen in each cell: points astray would make the shape tiny."""
    return [_contents(view) for view in display.views]


def _contents(view: View) -> Float[np.ndarray, "n 3"]:
    corners, points = (
        np.concatenate([np.zeros((0, 3)), *found])
        for found in (
            [layer.vertices for layer in view.layers if isinstance(layer, MeshLayer)],
            [layer.positions for layer in view.layers if isinstance(layer, PointLayer)],
        )
    )
    corners, points = (one[np.isfinite(one).all(axis=1)] for one in (corners, points))
    if not len(corners):
        return points
    low, high = corners.min(axis=0), corners.max(axis=0)
    reach = ASTRAY * float(np.linalg.norm(high - low))
    return np.concatenate([corners, points[((points >= low - reach) & (points <= high + reach)).all(axis=1)]])


def framing(
    display: Display, cell: tuple[int | float, int | float]
) -> tuple[tuple[float, float, float], float, float] | None:
    """Focus, half height and shift upwards of the house's view onto the largest shape in cells of (width, height)
    pixels; lengths in diagonals.  None where nothing is shown."""
    views, (width, height) = [points for points in contents(display) if len(points)], cell
    if not views:
        return None
    # Words are above and below the shape, so that neither covers the other.
    line, margin = (19, 1.1) if len(display.views) > 3 else (22, 1.16)
    above, below = (line * lines_of_words(display, where) for where in ("top", "bottom"))
    free = max(height - above - below, 0.4 * height)
    focus, scale = frame_of(np.concatenate(views), width / free, VIEW_DIRECTION, margin)
    scale *= height / free
    return focus, scale, (above - below) * scale / height


def lines_of_words(display: Display, where: str) -> int:
    """How many lines of words stand at the "top" or "bottom" of the cells."""
    shown = display.views
    words = [len(caption.lines) for view in shown for caption in view.captions if caption.corner.startswith(where)]
    # Cells of a grid keep room for two lines above: the second one comes with the first click.
    usual = 2 if where == "top" and len(shown) > 3 else 0
    return max([usual, *words, *(1 for view in shown if where == "bottom" and view.confidence is not None)])
