"""The report: one self-contained HTML page about a project, for people who don't have the program.

Pictures are embedded, plots are inline SVG, nothing is loaded from anywhere.  Light and dark follow the reader's system.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.viewer import likeness, svg
from shapeforge.viewer.palette import DARK, LIGHT, PARTS, group_colours, part_colours

CARD, FACE, WIDE = (112, 112), (168, 168), (150, 150)
MOST_SHAPES = 400
"""Shapes shown at most: the page stays below some 12 MB.  Beyond, an even selection that has all exemplars."""


def write_report(
    project: Any, path: str | Path, *, measures: Mapping[str, Any] | None = None, most: int = MOST_SHAPES
) -> Path:
    """Write the report of a project to ``path``; returns the path.

    ``measures`` is what ``validate`` found (shown as a table); ``most`` the number of shapes shown at most.
    Pictures are taken off screen: RuntimeError where there is no OpenGL, OSError where ``path`` cannot be written.
    """
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
    sections = [
        ("overview", "Overview", _overview(project)),
        ("groups", "Groups", _groups(project)),
        ("shapes", "Shapes", _shapes(project, shown)),
        ("fit", "Fit", _fit(project)),
        ("family", "What varies", _directions(project)),
        ("new", "New shapes", _new_shapes(project)),
        ("measures", "Measures", _measures(project, measures)),
        ("problems", "Files", _problems(project)),
    ]
    there = [(anchor, title, body) for anchor, title, body in sections if body]
    links = "".join(f'<a href="#{anchor}">{title}</a>' for anchor, title, _ in there)
    bodies = "".join(f'<section id="{anchor}"><h2>{title}</h2>{body}</section>' for anchor, title, body in there)
    name = escape(project.name)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{name} · shapeforge</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_css()}</style></head><body>'
        f"<header><h1>{name}</h1><p>{_sentence(project)}</p><nav>{links}</nav></header><main>{bodies}</main>"
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


# -- pieces of a page ------------------------------------------------------------------------------------------------


def _image(picture: np.ndarray | None, alt: str) -> str:
    if picture is None:
        return ""
    height, width = picture.shape[:2]
    address = likeness.data_address(picture)
    return f'<img src="{address}" width="{width}" height="{height}" alt="{escape(alt, quote=True)}" loading="lazy">'


def _table(rows: Sequence[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of ready HTML cells; cells after the first stand right when they begin like a number."""

    def cell(text: str, kind: str = "td") -> str:
        numeric = text[:1].isdigit() or text[:1] in ".\N{MINUS SIGN}"
        return f"<{kind}{' class=n' if numeric else ''}>{text}</{kind}>"

    top = f"<thead><tr>{''.join(cell(text, 'th') for text in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{''.join(cell(text) for text in row)}</tr>" for row in rows)
    return f"<div class=scroll><table>{top}<tbody>{body}</tbody></table></div>"


def _dot(colour: Sequence[int] | np.ndarray | str) -> str:
    text = colour if isinstance(colour, str) else "#{:02X}{:02X}{:02X}".format(*(int(c) for c in colour))
    return f'<span class=dot style="background:{text}"></span>'


def _part_names(project: Any) -> tuple[str, ...]:
    hierarchy = project.hierarchy()
    if hierarchy is not None:
        return tuple(hierarchy.top.part_names)
    return project.part_names.names if project.part_names is not None else ()


def _legend(project: Any) -> str:
    names = _part_names(project)
    colours = part_colours(len(names))
    return "".join(f"<span>{_dot(c)}{escape(name)}</span>" for name, c in zip(names, colours, strict=True))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


# -- sections --------------------------------------------------------------------------------------------------------


def _sentence(project: Any) -> str:
    count = len(project.names)
    parts = _part_names(project)
    words = [f"{count} shape{'s' * (count != 1)}"]
    if project.groups is not None:
        words.append(f"{len(project.groups)} group{'s' * (len(project.groups) != 1)}")
    if parts:
        words.append(f"{len(parts)} parts")
    if project.part_of_point is not None:
        words.append(f"{len(project.part_of_point)} corresponding points")
    draws = project.draws()
    if draws is not None:
        words.append(f"{len(draws['names'])} new shapes")
    return " · ".join(words)


def _overview(project: Any) -> str:
    from shapeforge.stages import next_step, status

    marks = {"done": ("✓", "ok"), "stale": ("!", "warning"), "partial": ("…", "warning"), "missing": ("–", "off"),
             "locked": ("–", "off")}  # fmt: skip
    rows = []
    for stage, found in status(project).items():
        mark, tone = marks[found.state]
        record = project.stage_record(stage) or {}
        said = (record.get("summary") or {}).get("text") or found.reason
        if found.state == "stale":
            said = f"{said} (stale: {found.reason})"
        took = f"{record['seconds']:.0f} s" if record.get("seconds") is not None else ""
        rows.append([f'<b class="{tone}">{mark}</b> {stage}', found.state, escape(said), took])
    return _table(rows, ("stage", "state", "", "took")) + f"<p class=note>Next: {escape(next_step(project))}</p>"


def _groups(project: Any) -> str:
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
        small = "".join(_image(likeness.plain_picture(project, m, (72, 72)), m) for m in some)
        more = f"<span class=more>and {len(members) - 1 - len(some)} more</span>" if len(members) - 1 > len(some) else ""
        blocks.append(
            f"<div class=group><figure>{_image(large, exemplar)}<figcaption>★ {escape(exemplar)}</figcaption></figure>"
            f"<div><h3>{_dot(colours[g])}{escape(name)} <small>{len(members)}</small></h3>"
            f"<div class=strip>{small}{more}</div></div></div>"
        )
    left = int((groups.group < 0).sum())
    note = f"<p class=note>{left} shapes are in no group.</p>" if left else ""
    return "".join(blocks) + note


def _shapes(project: Any, shown: Sequence[str]) -> str:
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
        three = "".join(_image(picture, f"{name}, {words}") for picture, words in pictures if picture is not None)
        group = -1 if groups is None else int(groups.group[index[name]])
        dot = _dot(colours[group]) if group >= 0 else ""
        star = "★ " if groups is not None and index[name] in groups.exemplars else ""
        cards.append(
            f"<figure class=card><div class=three>{three}</div>"
            f"<figcaption>{dot}<b>{star}{escape(name)}</b>{_about(project, name)}</figcaption></figure>"
        )
    left = len(project.names) - len(shown)
    note = f"<p class=note>{len(shown)} of {len(project.names)} shapes, evenly chosen.</p>" if left else ""
    key = "Left to right: as given"
    if _part_names(project):
        key += ", by part"
    if project.hierarchy() is not None:
        key += ", by correspondence (the same colour is the same place on every shape)"
    return f"<p class=note>{key}.</p><p class=legend>{_legend(project)}</p>{note}<div class=cards>{''.join(cards)}</div>"


def _about(project: Any, name: str) -> str:
    """Faces, how sure the labels are, and the share of every part."""
    record = project.shape_record(name)
    words = f"<small>{record['n_faces']:,} faces".replace(",", "\N{NARROW NO-BREAK SPACE}")
    labels, probabilities = project.face_labels(name), project.face_probabilities(name)
    bar = ""
    if labels is not None and probabilities is not None:
        names = _part_names(project)
        mesh = project.shapes.named(name).mesh
        areas = likeness.part_areas(mesh, labels, len(names))
        sure = float(np.average(np.asarray(probabilities, float).max(axis=1), weights=mesh.face_areas + 1e-300))
        words += f" · {_percent(sure)} sure"
        absent = [part for part, area in zip(names, areas, strict=True) if area == 0]
        if absent:
            words += f" · no {escape(', '.join(absent))}"
        css = [PARTS[k % len(PARTS)] for k in range(len(names))]
        bar = svg.shares(list(areas), names, css, title="shares of the surface by part", width=320)
    return words + "</small>" + bar


def _fit(project: Any) -> str:
    record = project.stage_record(project.fit_stage)
    if record is None or project.fit_id is None:
        return ""
    summary = record.get("summary") or {}
    plots = []
    energies = recorded_energies(project)
    if len(energies) > 1:
        plots.append(
            svg.curve(range(len(energies)), [svg.Series("energy", energies)], x_label="round",
                      y_label="energy (nats a point)", title="Energy of the fit by round")
        )  # fmt: skip
    moved = recorded_movement(project)
    if len(moved) > 1:
        lines = [svg.Series("mean", moved.mean(axis=1)), svg.Series("most", moved.max(axis=1), "var(--warning)")]
        plots.append(
            svg.curve(range(1, len(moved) + 1), lines, x_label="round", y_label="movement (diagonals)",
                      title="Mean movement of the template points, over the shapes and of the shape that moved most")
        )  # fmt: skip
    facts = [("rounds", summary.get("rounds")), ("energy, nats a point", summary.get("energy")),
             ("corresponding points", summary.get("points")), ("stopped because", summary.get("stop_reason"))]  # fmt: skip
    state = project.fit()
    rows = [[escape(str(k)), _number(v)] for k, v in facts if v is not None]
    if state is not None:
        names = _part_names(project)
        for part, sigma in zip(names, np.asarray(state.sigma_by_part, float), strict=False):
            rows.append([f"spread of {escape(part)} around its template, diagonals", _number(float(sigma))])
    return f"<div class=plots>{''.join(f'<figure>{p}</figure>' for p in plots)}{_table(rows)}</div>"


def recorded_energies(project: Any) -> list[float]:
    """Energy (nats a point) after every recorded round of the fit; only the last where rounds have none on disk."""
    from shapeforge.store_arrays import read_arrays

    folder = project.current_folder(project.fit_stage)
    found = []
    for file in sorted((folder / "rounds").glob("*.zarr.zip")) if folder is not None else ():
        arrays, attributes = read_arrays(file)
        value = arrays.get("energy", attributes.get("energy"))
        if value is not None:
            found.append(float(np.asarray(value)))
    if not found:
        summary = (project.stage_record(project.fit_stage) or {}).get("summary") or {}
        found = [float(e) for e in summary.get("energies") or ([summary["energy"]] if summary.get("energy") else [])]
    return found


def recorded_movement(project: Any) -> np.ndarray:
    """Mean movement (rounds - 1, T) of each shape's template points from one recorded round to the next, in diagonals."""
    columns = []
    for name in project.fit_names:
        rounds = [np.asarray(points, float) for points in project.rounds(name)]
        # another template may explain a shape from one round to the next: then there is no movement to tell
        columns.append(
            [np.linalg.norm(b - a, axis=1).mean() if a.shape == b.shape else np.nan for a, b in zip(rounds, rounds[1:])]
        )
    short = min((len(column) for column in columns), default=0)
    if not short:
        return np.zeros((0, 0))
    table = np.array([column[:short] for column in columns]).T
    return np.where(np.isfinite(table), table, 0.0)


def _directions(project: Any) -> str:
    from shapeforge.generative.inference import infer
    from shapeforge.generative.units import drive
    from shapeforge.viewer.palette import heat

    directions, machine, observations = project.directions(), project.machine(), project.observations()
    if not directions or machine is None or observations is None:
        return ""
    colours = likeness.part_point_colours(machine.part, len(machine.part_names))
    patterns, which, counts = np.unique(observations.exists, axis=0, return_inverse=True, return_counts=True)
    base_index = int(np.flatnonzero(which == counts.argmax())[0])
    one = slice(base_index, base_index + 1)
    base = infer(machine, observations.values[one], observations.exists[one])
    blocks = []
    for index, direction in enumerate(directions):
        ends = [
            drive(machine, base, {index: value}, directions=directions) for value in (direction.low, direction.high)
        ]
        middle = drive(machine, base, {}, directions=directions)
        pictures = (
            likeness.points_picture(ends[0], colours, WIDE),
            likeness.points_picture(middle, heat(np.asarray(direction.heat, float)), WIDE),
            likeness.points_picture(ends[1], colours, WIDE),
        )
        words = ("low end", "what moves", "high end")
        three = "".join(_image(p, f"{direction.name}, {w}") for p, w in zip(pictures, words, strict=True))
        bars = svg.histogram(direction.histogram, direction.edges, title="shapes of the family along this slider", width=450)
        blocks.append(
            f"<figure class=card><div class=three>{three}</div>{bars}"
            f"<figcaption><b>{escape(direction.name)}</b> <small>{escape(direction.caption)}</small></figcaption></figure>"
        )
    note = "Left: the slider's low end. Middle: where it moves the shape (dark red: most). Right: its high end. Bars: the family."
    return f"<p class=note>{note}</p><div class=cards>{''.join(blocks)}</div>"


def _new_shapes(project: Any) -> str:
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
        picture = likeness.mesh_picture(made["vertices"], made["triangles"], made["part"], len(names), FACE)
        from_ = ", ".join(f"{part} of {source}" for part, source in zip(names, made["sources"], strict=True) if source)
        measures = made["measures"]
        gap = measures.get("largest_gap")
        said = f"largest gap {_number(gap)} diagonals" if gap is not None else ""
        cards.append(
            f'<figure class=card title="{escape(from_, quote=True)}">{_image(picture, name)}<figcaption><b>{escape(name)}</b>'
            f"<small>{said}<br>{escape(from_)}</small></figcaption></figure>"
        )
    return f"<p class=legend>{_legend(project)}</p><div class='cards narrow'>{''.join(cards)}</div>" if cards else ""


def _measures(project: Any, measures: Mapping[str, Any] | None) -> str:
    rows: list[list[str]] = [[escape(k), v] for k, v in flattened(measures or {})]
    learnt = (project.stage_record("learn") or {}).get("summary") or {}
    for key, words in (("train_error", "machine: training error, diagonals"),
                       ("held_out_error", "machine: held-out error, diagonals")):  # fmt: skip
        if learnt.get(key) is not None:
            rows.append([words, _number(learnt[key])])
    made = _synthesis_measures(project)
    for key, words in (("largest_gap", "new shapes: largest gap between parts, diagonals (median)"),
                       ("symmetry_error", "new shapes: symmetry error, diagonals (median)"),
                       ("distance_from_draw", "new shapes: distance from the draw, diagonals (median)"),
                       ("folded_triangles", "new shapes: folded triangle pairs (median)")):  # fmt: skip
        values = [m[key] for m in made if m.get(key) is not None]
        if values:
            rows.append([words, _number(float(np.median(values)))])
    return _table(rows, ("measure", "value")) if rows else ""


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
            rows.append((words, _number(value)))
    return rows


def _problems(project: Any) -> str:
    rows = [
        [f'<b class="{p.kind}">{p.kind}</b>', escape(p.file), escape(p.reason), escape(p.remedy)] for p in project.problems
    ]
    return _table(rows, ("", "file", "what", "remedy")) if rows else ""


def _number(value: Any) -> str:
    if isinstance(value, bool | str):
        return escape(str(value))
    return svg.number(float(value)) if np.isfinite(float(value)) else "–"


def _css() -> str:
    def variables(tokens: Mapping[str, str], bar: str) -> str:
        names = ("window", "panel", "separator", "text", "text_2", "text_off", "accent", "accent_text", "ok", "warning", "error")
        return "".join(f"--{name}:{tokens[name]};" for name in names) + f"--bar:{bar};"

    light, dark = variables(LIGHT, "#B9C4D8"), variables(DARK, "#4A5568")
    return f":root{{color-scheme:light dark;{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}" + _RULES


_RULES = """
*{box-sizing:border-box}body{margin:0;background:var(--window);color:var(--text);
font:13px/20px Inter,system-ui,-apple-system,"Segoe UI",sans-serif;font-variant-numeric:tabular-nums}
header{padding:32px max(24px,calc(50vw - 640px)) 0;background:var(--panel);border-bottom:1px solid var(--separator)}
h1{font-size:24px;line-height:32px;margin:0;font-weight:600}header p{margin:4px 0 16px;color:var(--text_2)}
nav{display:flex;flex-wrap:wrap;gap:24px}nav a{color:var(--text_2);text-decoration:none;padding:8px 0 12px}
nav a:hover{color:var(--accent_text)}
main{max-width:1328px;margin:0 auto;padding:8px 24px 32px}section{margin-top:32px}
h2{font-size:17px;line-height:24px;font-weight:600;margin:0 0 12px}
h3{font-size:13px;font-weight:600;margin:0 0 8px}small{font-size:11px;line-height:16px;color:var(--text_2);font-weight:400}
.note{color:var(--text_2);margin:4px 0 12px}.legend{display:flex;flex-wrap:wrap;gap:4px 16px;margin:4px 0 12px}
.dot{display:inline-block;width:10px;height:10px;border-radius:3px;margin-right:6px}
figure{margin:0}img{display:block;max-width:100%;height:auto}
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(352px,1fr));gap:16px}
.narrow{grid-template-columns:repeat(auto-fill,minmax(200px,1fr))}
.card,.group,.plots figure{background:var(--panel);border:1px solid var(--separator);border-radius:5px;padding:12px}
.narrow .card img{margin:0 auto}.card figcaption{margin-top:8px}.card small{display:block}.card svg{display:block;width:100%;margin-top:6px}
.three{display:flex;justify-content:space-between}.three img{min-width:0;flex:0 1 auto}
.group{display:flex;gap:16px;margin-bottom:16px;align-items:flex-start}.group>div{min-width:0}
.group figcaption{text-align:center;color:var(--text_2)}
.strip{display:flex;flex-wrap:wrap;gap:4px;align-items:center}.more{color:var(--text_2);padding:0 8px}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(360px,1fr));gap:16px;align-items:start}
.plots svg{width:100%;height:auto}.grid{stroke:var(--separator)}.tick{fill:var(--text_2);font-size:11px}
.label{fill:var(--text_2);font-size:12px}
.scroll{overflow-x:auto;background:var(--panel);border:1px solid var(--separator);border-radius:5px}
table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:6px 12px;vertical-align:top}
th{font-weight:500;color:var(--text_2)}tbody tr{border-top:1px solid var(--separator)}.n{text-align:right;white-space:nowrap}
.ok{color:var(--ok)}.warning{color:var(--warning)}.error{color:var(--error)}.off{color:var(--text_off)}
footer{padding:16px 24px 32px;text-align:center;color:var(--text_2)}
@media print{body{background:#fff}.card,.group{break-inside:avoid}}
"""
