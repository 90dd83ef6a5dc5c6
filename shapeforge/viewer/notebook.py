"""The window's Session in a notebook: pictures rendered off screen, buttons built from the same table of actions.

``FamilyView``, ``FitView`` and ``SliderView`` are ordinary ipywidgets over one Session, so they follow each other and
any change made in code.  A stage runs in a thread; pictures are taken on the thread of the kernel.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import ipywidgets
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from shapeforge.collection.counts import counted
from shapeforge.viewer import likeness, svg
from shapeforge.viewer.actions import Actions, groups_of
from shapeforge.viewer.display import Display, View
from shapeforge.viewer.fit_display import mesh_layer, template_view
from shapeforge.viewer.fit_record import FitRecord
from shapeforge.viewer.notebook_desk import NotebookDesk, action_button, show_verdict
from shapeforge.viewer.palette import as_hex, group_colours, rgb, tokens
from shapeforge.viewer.pictures import contact_sheet, shape_picture, take_picture
from shapeforge.viewer.report_sections import phases_of
from shapeforge.viewer.sculptor import Recipe, Sculptor
from shapeforge.viewer.sculpture import measure_words
from shapeforge.viewer.session import Session

MOST_PICTURES = 60
WATCHED = 3
SLIDERS = 6


def open_session(project: Any, theme: str = "light") -> Session:
    """A Session on a project (or the path of one), for any number of views."""
    session = Session(theme=theme)
    if isinstance(project, str | Path):
        from shapeforge.store import Project

        project = Project.open(project)
    session.open(project)
    return session


class _Watching(ipywidgets.VBox):
    """A view that redraws when fields of the session change, until it is closed."""

    _slots: Sequence[tuple[Any, Any]] = ()  # a view whose making failed is closed, too

    def __init__(self, session: Session, children: Sequence[ipywidgets.Widget], fields: Sequence[str]) -> None:
        super().__init__(list(children))
        self.session = session
        signals = [*(getattr(session.events, field) for field in fields), session.data_changed]
        self._slots = [(signal, lambda *_: self.refresh()) for signal in signals]
        for signal, slot in self._slots:
            signal.connect(slot)

    def refresh(self) -> None:
        """Draw what the session says now."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop following the session, and take the widget away."""
        for signal, slot in self._slots:
            signal.disconnect(slot, missing_ok=True)
        self._slots = ()
        super().close()


class FamilyView(_Watching):
    """The whole family as small pictures, coloured by group, part or correspondence; one shape can be selected."""

    COLOURS = (("as given", "shape"), ("group", "group"), ("part", "part"), ("correspondence", "correspondence"))

    def __init__(self, project_or_session: Any, size: int = 104, columns: int = 8) -> None:
        session = _session_of(project_or_session)
        self.size, self.columns = size, columns
        self.colour = ipywidgets.ToggleButtons(options=self.COLOURS, value=session.colour_by)
        self.select = ipywidgets.Dropdown(options=[("–", None), *((n, n) for n in session.project.names)])
        self.image = ipywidgets.Image(format="png")
        self.words = ipywidgets.HTML()
        row = ipywidgets.HBox([self.colour, self.select])
        super().__init__(session, [row, self.image, self.words], ("colour_by", "shape", "theme"))
        self.colour.observe(lambda change: setattr(session, "colour_by", change.new), "value")
        self.select.observe(lambda change: setattr(session, "shape", change.new), "value")
        self.refresh()

    def refresh(self) -> None:
        session, project = self.session, self.session.project
        names = list(project.names)[:MOST_PICTURES]
        if session.colour_by in dict(map(reversed, self.COLOURS)):
            self.colour.value = session.colour_by
        if session.shape in project.names or session.shape is None:
            self.select.value = session.shape
        if not names:
            self.words.value = "The project has no shapes yet."
            return
        groups = groups_of(session)
        stars = set() if groups is None else {project.names[t] for t in groups.exemplars}
        pictures = [self.picture_of(name) for name in names]
        captions = [f"{name} (exemplar)" if name in stars else name for name in names]
        columns = min(self.columns, len(names))
        self.image.value = encoded(contact_sheet(pictures, captions, columns, session.theme))
        left = len(project.names) - len(names)
        self.words.value = counted(len(project.names), "shape") + (
            f", the first {len(names)} are shown" if left else ""
        )

    def picture_of(self, name: str) -> UInt8[np.ndarray, "h w 3"]:
        """One shape in the colours asked for; grey where there is nothing yet to colour it by."""
        session, project = self.session, self.session.project
        by, theme = session.colour_by, session.theme
        groups = groups_of(session)
        if by == "group" and groups is not None:
            group = int(groups.group[project.names.index(name)])
            if group >= 0:
                colour = tuple(int(c) for c in group_colours(len(groups))[group])
                return _framed(shape_picture(project, name, self.size, theme, colour=colour), name, session)
        if by == "part":
            labels = project.face_labels(name)
            labels = project.labels(name) if labels is None else labels
            if labels is not None:
                picture = shape_picture(project, name, self.size, theme, labels=labels, inks=project.part_inks())
                return _framed(picture, name, session)
        if by == "correspondence":
            view = likeness.correspondence_view(project, name)
            if view is not None:
                return _framed(take_picture(view, self.size, theme), name, session)
        return _framed(shape_picture(project, name, self.size, theme), name, session)


class FitView(_Watching):
    """A fit as it goes: template points on watched shapes, the energy, and buttons to run, pause, step and stop.

    ``run(rounds=…)`` starts it in the background; ``wait()`` stays until it is done.
    """

    def __init__(self, project_or_session: Any, watched: Sequence[str] = (), size: int = 260) -> None:
        session = _session_of(project_or_session)
        self.size, self.desk = size, NotebookDesk(session)
        self.actions = Actions(session, self.desk)
        self.record = FitRecord(session.project)
        self.record.load()
        session.watched = tuple(watched) or session.watched or _first_to_watch(session)
        self._ghosts: dict[str, Any] = {}
        self.buttons = {name: action_button(self.actions, name) for name in ("fit", "step", "stop")}
        self.by = ipywidgets.ToggleButtons(options=[("part", "part"), ("movement", "movement")])
        self.bar = ipywidgets.IntProgress(min=0, max=1, layout=ipywidgets.Layout(width="220px"))
        self.image = ipywidgets.Image(format="png")
        self.plot, self.words = ipywidgets.HTML(), ipywidgets.HTML()
        row = ipywidgets.HBox([*self.buttons.values(), self.bar, self.by])
        super().__init__(
            session, [row, self.image, self.plot, self.words],
            ("progress", "running", "is_paused", "watched", "status", "theme"),
        )  # fmt: skip
        self.by.observe(lambda _: self._draw(), "value")
        self.refresh()

    def run(self, stage: str = "fit", **options: Any) -> None:
        """Start a stage in the background (by default the fit), with options of ``stages.DEFAULTS``."""
        self.actions.start_stage(stage, **options)

    def wait(self, seconds: float | int | None = None) -> bool:
        """Stay until it has ended or paused; False when ``seconds`` were not enough."""
        return self.desk.wait(seconds)

    def refresh(self) -> None:
        session = self.session
        progress = session.progress
        new = progress is not None and self.record.add(progress.state, session.watched)
        if progress is not None:
            self.bar.max, self.bar.value = max(progress.of, 1), progress.step + progress.within
        for name, button in self.buttons.items():
            show_verdict(button, self.actions, name)
        self.buttons["fit"].description = (
            ("Go on" if session.is_paused else "Pause") if session.running else self.actions["fit"].label
        )
        said = progress.message if progress is not None and session.running else session.status
        self.words.value = f"<span>{escape(said)}</span>"
        if new or not self.image.value:
            self._draw()

    def _draw(self) -> None:
        newest = self.record.newest
        views = [self._view(name, newest) for name in self.session.watched if name in self.session.project.names]
        if views:
            self.image.value = encoded(
                display_picture(Display(tuple(views), 1, len(views)), self.size, self.session.theme)
            )
        rounds = [self.record.rounds[k] for k in sorted(self.record.rounds)]
        if len(rounds) > 1:
            numbers, energy = [r.number for r in rounds], [r.energy for r in rounds]
            lines = [svg.Series("energy", energy)]
            words = {"x_label": "round", "y_label": "energy (nats a point)", "title": "Energy of the fit by round"}
            words |= {"phases": phases_of(rounds[-1].family_from, rounds[-1].number)}
            self.plot.value = styled(svg.curve(numbers, lines, **words, width=520, height=200), self.session.theme)

    def _view(self, name: str, number: int) -> View:
        shape = self.session.project.shapes.named(name)
        if name not in self._ghosts:
            self._ghosts[name] = mesh_layer(shape, tokens(self.session.theme)["shape"], 0.25, "ghost")
        now = self.record.points(name, number) if number >= 0 else None
        before = self.record.points(name, number - 1) if number >= 1 else None
        look = self.record.looks[now.template] if now is not None and self.record.looks else None
        return template_view(self._ghosts[name], look, now, before, self.by.value)


class SliderView(_Watching):
    """New shapes by hand: a slider for each direction the machine found, a box for each part, Mean and Random.

    Points follow at once; the mesh is made when asked for.  Sliders show where the shape in hand stands, in standard
    deviations over the family.
    """

    def __init__(self, project_or_session: Any, size: int = 420, sliders: int = SLIDERS) -> None:
        session = _session_of(project_or_session)
        self.sculptor = Sculptor(session)
        self.sculptor.reload()
        if not self.sculptor.has_machine:
            raise ValueError("project: wanted one whose family was learned, got one without; run the stage learn first")
        self.size, self.made, self._sources = size, None, None
        sculptor = self.sculptor
        self.sliders = [self._slider(index) for index in range(min(sliders, len(sculptor.directions)))]
        always, seen = sculptor.always(), sculptor.seen()
        self.boxes = {
            index: ipywidgets.Checkbox(value=True, description=name, disabled=bool(always[index]), indent=False)
            for index, name in enumerate(sculptor.part_names)
            if seen[index]
        }
        self.buttons = {
            "Mean": lambda: self.start(Recipe("mean", sculptor.mean_base(), origin="mean")),
            "Random": lambda: self.start(sculptor.drawn()),
            "Make the mesh": self.make_mesh,
        }
        row = []
        for words, act in self.buttons.items():
            button = ipywidgets.Button(description=words)
            button.on_click(lambda _, act=act: act())
            row.append(button)
        self.image, self.words = ipywidgets.Image(format="png"), ipywidgets.HTML()
        left = ipywidgets.VBox([ipywidgets.HBox(row), *self.sliders, ipywidgets.HBox(list(self.boxes.values()))])
        body = ipywidgets.HBox([left, ipywidgets.VBox([self.image, self.words])])
        self._quiet = False
        super().__init__(session, [body], ("sliders", "parts_on", "theme"))
        for index, slider in enumerate(self.sliders):
            slider.observe(lambda change, index=index: self._slid(index, change.new), "value")
        for index, box in self.boxes.items():
            box.observe(lambda change, index=index: self._switched(index, change.new), "value")
        self.refresh()

    def _slider(self, index: int) -> ipywidgets.FloatSlider:
        direction, unit = self.sculptor.directions[index], self.sculptor.unit(index)
        return ipywidgets.FloatSlider(
            value=0.0, min=round(min(direction.low / unit, -0.1), 2), max=round(max(direction.high / unit, 0.1), 2),
            step=0.01, description=self.sculptor.names[index], continuous_update=True, readout_format=".1f",
            style={"description_width": "190px"}, layout=ipywidgets.Layout(width="440px"),
        )  # fmt: skip

    def _slid(self, index: int, value: float) -> None:
        if not self._quiet:
            self.sculptor.slide(index, float(value))

    def _switched(self, index: int, on: bool) -> None:
        if not self._quiet:
            self.session.parts_on = {**self.session.parts_on, index: bool(on)}

    def refresh(self) -> None:
        if self.sculptor.reload():  # learned anew: what was made belongs to the old family
            self._sources = None
        exists = self.sculptor.exists()
        self._quiet, values = True, self.sculptor.values()  # the session leads, the widgets follow
        for index, slider in enumerate(self.sliders):
            slider.value = min(max(float(values[index]), slider.min), slider.max)
        for index, box in self.boxes.items():
            box.value = bool(exists[index])
        self._quiet = False
        self.made = None
        self._show(View((self.sculptor.points_layer(self.sculptor.points(), 3.5),), ground=False))
        name, distance = self.sculptor.nearest(self.sculptor.points())
        self.words.value = f"nearest real shape: {escape(name)}, {100 * distance:.1f} % of its size away"

    def start(self, recipe: Recipe) -> None:
        """Take another shape in hand."""
        self.sculptor.start(recipe)
        self.refresh()

    def make_mesh(self) -> Any:
        """The mesh of the shape in hand (a ``SynthesizedShape``); it takes a second or more, and is shown."""
        from shapeforge.stages_synthesis import sources_of
        from shapeforge.synthesis.assemble import synthesize

        if self._sources is None:
            self._sources = sources_of(self.session.project)
        sculptor = self.sculptor
        made = synthesize(sculptor.points(), sculptor.exists(), self._sources, symmetric=sculptor.symmetric())
        self._show(View((self.sculptor.mesh_layer(made),)))
        self.words.value = escape(measure_words(made.measures))
        self.made = made
        return made

    def _show(self, view: View) -> None:
        self.image.value = encoded(take_picture(view, self.size, self.session.theme))


# -- small things ------------------------------------------------------------------------------------------------------


def _session_of(project_or_session: Any) -> Session:
    return project_or_session if isinstance(project_or_session, Session) else open_session(project_or_session)


def _first_to_watch(session: Session) -> tuple[str, ...]:
    """Shapes worth watching: those the templates do not come from."""
    groups = groups_of(session)
    exemplars = set() if groups is None else {session.project.names[t] for t in groups.exemplars}
    others = [name for name in session.project.names if name not in exemplars]
    return tuple((others or list(session.project.names))[:WATCHED])


def display_picture(display: Display, size: int, theme: str) -> UInt8[np.ndarray, "h w 3"]:
    """All views of a Display side by side in its rows and columns, each ``size`` pixels square."""
    pictures = [take_picture(view, size, theme) for view in display.views]
    blank = np.full((size, size, 3), rgb(tokens(theme)["view"]), np.uint8)
    pictures += [blank] * (display.rows * display.columns - len(pictures))
    rows = [np.hstack(pictures[r * display.columns : (r + 1) * display.columns]) for r in range(display.rows)]
    return np.vstack(rows)


def encoded(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """A picture as PNG bytes, for ``ipywidgets.Image``."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return buffer.getvalue()


def styled(plot: str, theme: str) -> str:
    """An SVG plot with the colours that its CSS variables and classes stand for."""
    colours = tokens(theme)
    variables = "".join(f"--{name}:{colour};" for name, colour in colours.items())
    rules = ".grid{stroke:var(--separator)}.tick,.label{fill:var(--text_2);font-size:11px}"
    rules += ".divider{stroke:var(--text_2)}"
    return f'<div style="{variables}background:{colours["panel"]};width:fit-content"><style>{rules}</style>{plot}</div>'


def legend(project: Any) -> ipywidgets.HTML:
    """The parts and their colours."""
    names = project.part_names.names if project.part_names is not None else ()
    words = []
    for name, ink in zip(names, project.part_inks(names), strict=True):
        words.append(f'<span style="background:{as_hex(ink)};padding:0 .5em">&nbsp;</span> {escape(name)}')
    return ipywidgets.HTML(" &emsp; ".join(words))


def _framed(picture: np.ndarray, name: str, session: Session) -> np.ndarray:
    """The picture with a frame when its shape is the selected one."""
    if name == session.shape:
        picture = picture.copy()
        for edge in (np.s_[:2], np.s_[-2:], np.s_[:, :2], np.s_[:, -2:]):
            picture[edge] = rgb(tokens(session.theme)["accent"])
    return picture
