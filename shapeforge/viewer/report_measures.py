"""The report's figures: what ``validate`` found beside the plain baseline, the machine's errors, the new shapes."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from shapeforge.viewer import svg
from shapeforge.viewer.report_html import number, table

WORDS = {
    "faces": "faces with the true part",
    "area": "area with the true part",
    "part_iou": "intersection over union, mean over parts",
    "accuracy": "fine classes by nearest neighbour",
    "missing": "landmarks without an answer",
}
"""What is shown of validation, and what it is called."""


def measures(project: Any, validation: Mapping[str, Any] | None) -> str:
    """Figures: those of ``validate`` when given, of the machine, of the new shapes."""
    blocks = _truth(validation or {})
    rows: list[list[str]] = []
    learnt = (project.stage_record("learn") or {}).get("summary") or {}
    for key, words in (("train_error", "machine: training error, diagonals"),
                       ("held_out_error", "machine: held-out error, diagonals")):  # fmt: skip
        if learnt.get(key) is not None:
            rows.append([words, number(learnt[key])])
    made = _synthesis_measures(project)
    for key, words in (("largest_gap", "new shapes: largest gap between parts, diagonals (median)"),
                       ("symmetry_error", "new shapes: symmetry error, diagonals (median)"),
                       ("distance_from_draw", "new shapes: distance from the draw, diagonals (median)"),
                       ("folded_triangles", "new shapes: folded triangle pairs (median)"),
                       ("open_edges", "new shapes: edges that are open (median)")):  # fmt: skip
        values = [m[key] for m in made if m.get(key) is not None]
        if values:
            rows.append([words, number(float(np.median(values)))])
    return blocks + (table(rows, ("measure", "value")) if rows else "")


def _truth(validation: Mapping[str, Any]) -> str:
    """A table, ours beside affine transfer, and the curve of corr@r; other figures as they are."""
    rows, plot = [], ""
    for name, found in validation.items():
        if not isinstance(found, Mapping):
            continue
        theirs = found.get("affine_transfer") or {}
        if not set(WORDS) & set(found) and "corr" not in found:
            rows += [[f"{escape(name)}: {escape(key)}", value, ""] for key, value in flattened(found)]
        for radius, value in (found.get("corr") or {}).items():
            other = (theirs.get("corr") or {}).get(radius)
            rows.append([f"corr@{escape(str(radius))}", f"{value:.3f}", "" if other is None else f"{other:.3f}"])
        for key, words in WORDS.items():
            if found.get(key) is not None:
                other = theirs.get(key)
                rows.append([words, f"{found[key]:.3f}", "" if other is None else f"{other:.3f}"])
        plot = plot or _corr_plot(found.get("corr"), theirs.get("corr"))
    if not rows:
        return ""
    left_out = validation.get("left_out") or []
    note = f"<p class=note>Left out, as they gave evidence: {escape(', '.join(left_out))}.</p>" if left_out else ""
    figure = f"<figure>{plot}</figure>" if plot else ""
    compared = table(rows, ("compared with the truth", "ours", "affine transfer"))
    return f"<div class=plots>{compared}{figure}</div>{note}<br>"


def _corr_plot(ours: Mapping[str, float] | None, theirs: Mapping[str, float] | None) -> str:
    if not ours or len(ours) < 2:
        return ""
    radii = [float(radius) for radius in ours]
    lines = [svg.Series("ours", [100 * value for value in ours.values()])]
    if theirs and list(theirs) == list(ours):
        lines.append(svg.Series("affine transfer", [100 * value for value in theirs.values()], "var(--warning)"))
    return svg.curve(
        radii, lines, x_label="radius (diagonals)", y_label="landmarks within it (%)", from_zero=True,
        title="Share of landmarks carried from one shape to another that land within a radius of the truth",
    )  # fmt: skip


def _synthesis_measures(project: Any) -> list[dict[str, Any]]:
    from shapeforge.store_arrays import read_record

    folder = project.current_folder("synthesize")
    files = sorted((folder / "shapes").glob("*.zarr.zip")) if folder is not None else []
    return [dict(read_record(file)[0]["measures"]) for file in files]


def flattened(values: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    """Nested mappings of figures as rows (words, ready HTML); lists and long texts are left out."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        words = f"{before}{str(key).replace('_', ' ')}"
        if isinstance(value, Mapping):
            rows += flattened(value, f"{words}: ")
        elif isinstance(value, bool | int | float | np.number) or (isinstance(value, str) and len(value) < 120):
            rows.append((words, number(value)))
    return rows
