"""The sections of the report, each as HTML text; "" when the project has nothing for it yet."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.colours import as_hex
from shapeforge.collection.counts import counted
from shapeforge.viewer import likeness, svg
from shapeforge.viewer.palette import group_colours
from shapeforge.viewer.report_html import dot, image, number, percent, table

CARD, FACE, WIDE = (112, 112), (168, 168), (150, 150)
BUNDLES = 3  # of the second layer, shown below the directions
ANOTHER_SUM = (
    "Right of the line the family's own templates are fitted: their energy is another sum over other points, "
    "not to be compared with that of the exemplars' templates, and their spread begins anew."
)


def _part_names(project: Any) -> tuple[str, ...]:
    hierarchy = project.hierarchy()
    if hierarchy is not None:
        return tuple(hierarchy.top.part_names)
    return project.part_names.names if project.part_names is not None else ()


def _legend(project: Any) -> str:
    names = _part_names(project)
    colours = project.part_inks(names)
    return "".join(f"<span>{dot(c)}{escape(name)}</span>" for name, c in zip(names, colours, strict=True))


# -- sections --------------------------------------------------------------------------------------------------------


def sentence(project: Any) -> str:
    """What the project has, in one line."""
    parts = _part_names(project)
    words = [counted(len(project.names), "shape")]
    if project.groups is not None:
        words.append(counted(len(project.groups), "group"))
    if parts:
        words.append(counted(len(parts), "part"))
    if project.part_of_point is not None:
        words.append(counted(len(project.part_of_point), "corresponding point"))
    draws = project.draws()
    if draws is not None:
        words.append(counted(len(draws["names"]), "new shape"))
    return " · ".join(words)


def overview(project: Any) -> str:
    """Every stage: its state, what came of it, how long it took; and the next step."""
    from shapeforge.stages import next_step, status

    marks = {"done": ("✓", "ok"), "stale": ("!", "warning"), "partial": ("…", "warning"), "missing": ("–", "off"),
             "locked": ("–", "off")}  # fmt: skip
    rows = []
    for stage, found in status(project).items():
        mark, tone = marks[found.state]
        record = project.stage_record(stage) or {}
        said = (record.get("summary") or {}).get("text") or found.reason
        said = said.split(" in /")[0]  # where it lies on the maker's machine is nobody else's business
        if found.state == "stale":
            said = f"{said} (stale: {found.reason})"
        took = f"{record['seconds']:.0f} s" if record.get("seconds") is not None else ""
        rows.append([f'<span class=n><b class="{tone}">{mark}</b> {stage}</span>', found.state, escape(said), took])
    ahead = next_step(project).replace(str(project.path), project.name)
    return table(rows, ("stage", "state", "", "took")) + f"<p class=note>Next: {escape(ahead)}</p>"


def groups(project: Any) -> str:
    """Every group with its exemplar and some of its members."""
    groups = project.groups
    if groups is None:
        return ""
    colours = group_colours(len(groups))
    blocks = []
    for g, name in enumerate(groups.names):
        exemplar = project.names[groups.exemplars[g]]
        members = [project.names[t] for t in groups.members(g)]
        large = likeness.part_picture(project, exemplar, FACE)
        if large is None:
            large = likeness.plain_picture(project, exemplar, FACE)
        some = [m for m in members if m != exemplar][:12]
        small = "".join(image(likeness.plain_picture(project, m, (72, 72)), m) for m in some)
        more = (
            f"<span class=more>and {len(members) - 1 - len(some)} more</span>" if len(members) - 1 > len(some) else ""
        )
        caption = escape(exemplar).replace("_", "_<wbr>")
        blocks.append(
            f"<div class=group><figure>{image(large, exemplar)}<figcaption>★&nbsp;{caption}</figcaption></figure>"
            f"<div><h3>{dot(colours[g])}{escape(name)} <small>{len(members)}</small></h3>"
            f"<div class=strip>{small}{more}</div></div></div>"
        )
    left = int((groups.group < 0).sum())
    note = f"<p class=note>{counted(left, 'shape')} in no group.</p>" if left else ""
    return f"<div class=groups>{''.join(blocks)}</div>{note}"


def shapes(project: Any, shown: Sequence[str]) -> str:
    """The shapes ``shown``: as given, by part, by correspondence."""
    if not shown:
        return ""
    groups = project.groups
    index = {name: t for t, name in enumerate(project.names)}
    colours = group_colours(0 if groups is None else len(groups))
    cards = []
    for name in shown:
        pictures = [
            (likeness.plain_picture(project, name, CARD), "as given"),
            (likeness.part_picture(project, name, CARD), "parts"),
            (likeness.correspondence_picture(project, name, CARD), "correspondence"),
        ]
        three = "".join(image(picture, f"{name}, {words}") for picture, words in pictures if picture is not None)
        group = -1 if groups is None else int(groups.group[index[name]])
        mark = dot(colours[group]) if group >= 0 else ""
        star = "★ " if groups is not None and index[name] in groups.exemplars else ""
        cards.append(
            f"<figure class=card><div class=three>{three}</div>"
            f"<figcaption>{mark}<b>{star}{escape(name)}</b>{_about(project, name)}</figcaption></figure>"
        )
    left = len(project.names) - len(shown)
    note = f"<p class=note>{len(shown)} of {counted(len(project.names), 'shape')}, evenly chosen.</p>" if left else ""
    key = "Left to right: as given"
    if _part_names(project):
        key += ", by part"
    if project.hierarchy() is not None:
        key += ", by correspondence (the same colour is the same place on every shape)"
    return (
        f"<p class=note>{key}.</p><p class=legend>{_legend(project)}</p>{note}<div class=cards>{''.join(cards)}</div>"
    )


def _about(project: Any, name: str) -> str:
    """Faces, how sure the labels are, and the share of every part."""
    record = project.shape_record(name)
    words = f"<small>{counted(record['n_faces'], 'face')}"
    labels, probabilities = project.face_labels(name), project.face_probabilities(name)
    bar = ""
    if labels is not None and probabilities is not None:
        names = _part_names(project)
        mesh = project.shapes.named(name).mesh
        areas = likeness.part_areas(mesh, labels, len(names))
        sure = float(np.average(np.asarray(probabilities, float).max(axis=1), weights=mesh.face_areas + 1e-300))
        words += f" · {percent(sure)} sure"
        absent = [part for part, area in zip(names, areas, strict=True) if area == 0]
        if absent:
            words += f" · no {escape(', '.join(absent))}"
        css = [as_hex(ink) for ink in project.part_inks(names)]
        bar = svg.shares(list(areas), names, css, title="shares of the surface by part", width=320)
    return words + "</small>" + bar


def parts(project: Any, shown: Sequence[str]) -> str:
    """How many components of every part each of the shapes ``shown`` has, and how many copies beside them."""
    found = {name: project.part_counts(name) for name in shown}
    rows = [
        [escape(name), *(_count(*of) for of in zip(one.components.tolist(), one.copies.tolist(), strict=True))]
        for name, one in found.items()
        if one is not None
    ]
    if not rows:
        return ""
    note = "<p class=note>Components of every part, such as legs; + copies that the exemplars do not have.</p>"
    return note + table(rows, ("shape", *map(escape, _part_names(project))))


def _count(components: int, copies: int) -> str:
    """A number of components and of copies beside them, in words."""
    return f"{components} + {copies}" if copies else str(components or "–")


def fit(project: Any) -> str:
    """Curves and figures of the fit."""
    record = project.stage_record(project.fit_stage)
    if record is None or project.fit_id is None:
        return ""
    summary = record.get("summary") or {}
    plots, phases = [], phases_of(getattr(project.fit(), "family_from", -1), len(project.round_figures()) - 1)
    energies = recorded_energies(project)
    if len(energies) > 1:
        plots.append(
            svg.curve(range(1, len(energies) + 1), [svg.Series("energy", energies)], x_label="round",
                      y_label="energy (nats a point)", title="Energy of the fit by round", phases=phases)
        )  # fmt: skip
    moved = recorded_movement(project)
    if len(moved) > 1:
        told = [row[np.isfinite(row)] for row in moved]
        mean, most = ([float(of(row)) if len(row) else np.nan for row in told] for of in (np.mean, np.max))
        lines = [svg.Series("mean", mean), svg.Series("most", most, "var(--warning)")]
        title = "Mean movement of the template points: over all shapes, and of the shape that moved most"
        plots.append(
            svg.curve(range(1, len(moved) + 1), lines, x_label="round", y_label="movement (diagonals)", from_zero=True,
                      title=title, phases=phases)
        )  # fmt: skip
    facts = [
        ("rounds", summary.get("rounds")),
        ("energy, nats a point", summary.get("energy")),
        ("corresponding points", summary.get("points")),
        ("stopped because", summary.get("stop_reason")),
    ]
    rows = [[escape(words), number(value)] for words, value in facts if value is not None]
    said = "" if phases is None else f"<p class=note>{ANOTHER_SUM}</p>"
    return f"<div class=plots>{''.join(f'<figure>{p}</figure>' for p in plots)}{table(rows)}</div>{said}"


def phases_of(family_from: int, newest: int) -> tuple[float, str, str] | None:
    """Where a curve over rounds up to the ``newest`` is cut for ``svg.curve``: between the exemplars' and the family's.

    ``family_from`` is the round with which the exemplars were done; None where no round of the family came after it.
    """
    return (family_from + 0.5, "exemplars", "family") if 0 <= family_from < newest else None


def recorded_energies(project: Any) -> list[float]:
    """Energy (nats a point) after every recorded round of the fit; the affine start has none."""
    return [figures["energy"] for figures in project.round_figures() if np.isfinite(figures["energy"])]


def recorded_movement(project: Any) -> np.ndarray:
    """Mean movement (rounds - 1, T) of each shape's template points between recorded rounds, in diagonals.

    NaN where another template explains the shape from one round to the next.
    """
    columns, templates = [], [figures["template"] for figures in project.round_figures()]
    for index, name in enumerate(project.fit_names):
        rounds = [np.asarray(points, float) for points in project.rounds(name)]
        columns.append(
            [
                np.linalg.norm(rounds[n + 1] - rounds[n], axis=1).mean()
                if templates[n][index] == templates[n + 1][index]
                else np.nan
                for n in range(len(templates) - 1)
            ]
        )
    short = min((len(column) for column in columns), default=0)
    if not short:
        return np.zeros((0, 0))
    return np.array([column[:short] for column in columns]).T


def directions(project: Any) -> str:
    """Every slider: both its ends, where it moves the shape, and where the family lies."""
    from shapeforge.generative.inference import infer
    from shapeforge.generative.units import bundles, drive, middle_shape
    from shapeforge.viewer.palette import heat

    directions, machine, observations = project.directions(), project.machine(), project.observations()
    if not directions or machine is None or observations is None:
        return ""
    directions = [*directions, *bundles(machine, observations, BUNDLES)]
    colours = project.part_inks(machine.part_names)[machine.part]
    patterns, which, counts = np.unique(observations.exists, axis=0, return_inverse=True, return_counts=True)
    base_index = int(np.flatnonzero(which == counts.argmax())[0])
    one = slice(base_index, base_index + 1)
    base = infer(machine, observations.values[one], observations.exists[one])
    middle = middle_shape(machine, observations)
    blocks = []
    for index, direction in enumerate(directions):
        of_bundle = direction.kind == "bundle"
        start = middle if of_bundle else base
        # a bundle from where its unit is off in the family to where it is on, a direction over its usual range
        ends = (direction.edges[0], direction.edges[-1]) if of_bundle else (direction.low, direction.high)
        low, half, high = (
            np.asarray(drive(machine, start, {index: float(value)}, directions=directions))
            for value in (ends[0], sum(ends) / 2 if of_bundle else 0.0, ends[1])
        )
        between = colours if of_bundle else heat(np.asarray(direction.heat, float))
        pictures = [
            likeness.points_picture(points, shown, WIDE)
            for points, shown in ((low, colours), (half, between), (high, colours))
        ]
        words = ("at 0", "at ½", "at 1") if of_bundle else ("low end", "what moves", "high end")
        shown = zip(pictures, words, strict=True)
        three = "".join(f"<span>{image(p, f'{direction.name}, {w}')}<small>{w}</small></span>" for p, w in shown)
        bars = svg.histogram(
            direction.histogram, direction.edges, title="shapes of the family along this slider", width=450
        )
        blocks.append(
            f"<figure class=card><div class=three>{three}</div>{bars}"
            f"<figcaption><b>{escape(direction.name)}</b> <small>{escape(direction.caption)}</small></figcaption>"
            "</figure>"
        )
    note = "Left: the slider's low end. Middle: where it moves the shape (dark red: most). Right: its high end."
    note += " Bars: where the shapes of the family lie, the line is 0."
    note += " A bundle is one unit of the second layer with all those of the first that it drives, at 0, ½ and 1:"
    note += " where the family's shapes have it most off, half-way, and most on, from the middle of the family."
    return f"<p class=note>{note}</p><div class=cards>{''.join(blocks)}</div>"


def new_shapes(project: Any) -> str:
    """What ``synthesize`` made last, and of what."""
    from shapeforge.store_arrays import read_record

    folder, draws = project.current_folder("synthesize"), project.draws()
    if folder is None or draws is None:
        return ""
    cards = []
    for name in draws["names"]:
        path = folder / "shapes" / f"{name}.zarr.zip"
        if not path.is_file():
            continue
        made = read_record(path)[0]
        names = tuple(made["part_names"])
        inks = project.part_inks(names)
        picture = likeness.mesh_picture(made["vertices"], made["triangles"], made["part"], inks, FACE)
        from_ = ", ".join(f"{part} of {source}" for part, source in zip(names, made["sources"], strict=True) if source)
        measures = made["measures"]
        gap = measures.get("largest_gap")
        said = f"largest gap {100 * gap:.2f} % of size" if gap is not None else ""
        cards.append(
            f"<figure class=card>{image(picture, name)}<figcaption><b>{escape(name)}</b>"
            f"<small>{said}<br>{escape(from_)}</small></figcaption></figure>"
        )
    return f"<p class=legend>{_legend(project)}</p><div class='cards narrow'>{''.join(cards)}</div>" if cards else ""


def problems(project: Any) -> str:
    """Files that were not read, or that are doubtful."""
    rows = [
        [f'<b class="{p.kind}">{p.kind}</b>', escape(Path(p.file).name), escape(p.reason), escape(p.remedy)]
        for p in project.problems
    ]
    return table(rows, ("", "file", "what", "remedy")) if rows else ""
