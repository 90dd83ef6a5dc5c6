"""Sections of the Synthesize inspector: what random draws keep to, and how the mesh is made and coloured."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QMenu, QWidget

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.qt.bind import ENABLING, Binding, action_button
from shapeforge.viewer.qt.controls import Segments, Switch
from shapeforge.viewer.qt.widgets import column, framed, label, row, section
from shapeforge.viewer.session import Session

TEMPERATURES = (("0.6", "Less", ""), ("1.0", "Usual", ""), ("1.5", "More", ""))
ROUTES = (("parts", "Parts", ""), ("surface", "New surface", ""))
COLOURS = (("parts", "Parts", ""), ("sources", "Materials", ""))


def not_learnt(actions: Actions, binding: Binding) -> QWidget:
    """What is in the middle of the place before there is a machine: what is missing, and the button that makes it."""
    session = actions.session
    title, words = label("Nothing has been learnt yet", "title"), label("", "text2")
    go = action_button(actions, "learn", binding, kind="primary")
    for one in (title, words):
        one.setAlignment(Qt.AlignmentFlag.AlignCenter)

    def show() -> None:
        learns = session.running and session.stage == "learn"
        can, why = actions.verdict("learn")
        words.setText(
            "The family is being learnt: see the bar below." if learns
            else "New shapes come from what the fitted shapes have in common." if can else why
        )  # fmt: skip

    binding.on(ENABLING, show)
    return framed(column(None, title, words, row(None, go, None, margins=(0, 12, 0, 0)), None, spacing=6), "centre")


def shapes_menu(parent: QWidget, actions: Actions, names: Sequence[str], take: Callable[[str], None]) -> QMenu:
    """A menu of the family's shapes to ``take`` one of, and of recipes."""
    menu = QMenu(parent)
    menu.setStyleSheet("QMenu { menu-scrollable: 1; max-height: 480px; }")
    menu.addAction(actions["open_recipe"].label, lambda: actions.run("open_recipe"))
    menu.addSeparator()
    for name in names:
        menu.addAction(name, lambda name=name: take(name))
    return menu


class DrawSection(QWidget):
    """What *Random* and the gallery keep to.  The Session holds it."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.temperature = Segments(TEMPERATURES, "1.0")
        for value, words in (
            ("0.6", "Draws near the middle of the family"),
            ("1.0", "Draws that vary as the family does"),
            ("1.5", "Draws that vary more than the family does"),
        ):
            self.temperature.button(value).setToolTip(words)
        self.temperature.chosen.connect(lambda value: setattr(session, "temperature", float(value)))
        self.near = Switch(False, "Variations of the shape in hand instead of draws from the whole family")
        self.near.setAccessibleName("Near the shape in hand")
        self.near.clicked.connect(lambda on: setattr(session, "near", bool(on)))
        self.kept = label("", "caption", wrap=True)
        inside = section(
            label("Random draws", "heading"), row(label("Variety"), None, self.temperature),
            row(label("Near the shape in hand"), None, self.near), self.kept,
        )  # fmt: skip
        self.setLayout(column(inside, spacing=0))

    def show_wishes(self, parts: tuple[str, ...] = (), n_locked: int = 0, n_pins: int = 0) -> None:
        """Show the Session's wishes; draws keep ``parts`` (in words: "arms off"), so many locked sliders and pins."""
        self.temperature.set_value(f"{self.session.temperature:.1f}")
        self.near.setChecked(self.session.near)
        counted = (n_locked, "locked slider"), (n_pins, "pin")
        kept = [*parts, *(f"{n} {word}{'s' * (n != 1)}" for n, word in counted if n)]
        always = "They keep pins, locked sliders and switched parts."
        self.kept.setText(f"They keep: {', '.join(kept)}." if kept else always)


class MeshSection(QWidget):
    """How the mesh is made (route, one solid) and whose colours it has.  Shows what it is told, emits what is asked."""

    route_chosen = Signal(str)
    union_switched = Signal(bool)
    colours_chosen = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.route = Segments(ROUTES, "parts")
        self.route.button("parts").setToolTip("Parts of the family's shapes, bent and put together: sharp detail")
        self.route.button("surface").setToolTip("A new closed surface around the points: no seams, soft detail")
        self.route.chosen.connect(self.route_chosen)
        self.union = Switch()
        self.union.setAccessibleName("One watertight solid")
        self.union.clicked.connect(lambda on: self.union_switched.emit(bool(on)))
        self.union_words = label("One watertight solid")
        self.colours = Segments(COLOURS, "parts")
        self.colours.chosen.connect(self.colours_chosen)
        self.note = label("", "caption_warning", wrap=True)
        inside = section(
            label("Mesh", "heading"), row(label("Made of"), None, self.route),
            row(self.union_words, None, self.union), row(label("Colours"), None, self.colours), self.note, line=False,
        )  # fmt: skip
        self.setLayout(column(inside, spacing=0))

    def show_choice(
        self, route: str, union: bool, colours: str, *, no_union: str, no_colours: str, problem: str
    ) -> None:
        """Show what is chosen; ``no_union`` and ``no_colours`` say why a choice cannot be made ("": it can),
        ``problem`` what did not work for the mesh on show."""
        self.route.set_value(route)
        self.union.setChecked(union or route == "surface")
        self.union.setEnabled(not no_union)
        self.union_words.setEnabled(not no_union)
        self.union.setToolTip(no_union or "All parts in one closed surface without anything inside: for printing")
        self.colours.set_value("parts" if no_colours else colours)
        self.colours.button("parts").setToolTip("The colours of the parts, as everywhere in the window")
        self.colours.button("sources").setEnabled(not no_colours)
        self.colours.button("sources").setToolTip(
            no_colours or "The files' own colours, of the shapes that the parts come from"
        )
        self.note.setText(problem)
        self.note.setVisible(bool(problem))
