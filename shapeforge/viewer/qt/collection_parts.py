"""Pieces of the Collection place: the strip with the exemplars to paint, and the list of files not read or doubtful."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QFrame, QProgressBar, QScrollArea, QWidget

from shapeforge.collection.counts import counted, grouped
from shapeforge.store import Problem
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.palette import rgb
from shapeforge.viewer.qt.bind import Binding, action_button, tooltip_of
from shapeforge.viewer.qt.controls import Clickable
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.map_drawing import group_colour
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import (
    ElidedLabel,
    Picture,
    button,
    clear,
    column,
    framed,
    icon_label,
    label,
    row,
    section,
    separator,
    set_style,
    shortened,
)
from shapeforge.viewer.readiness import group_of, groups_of, next_step, next_to_paint, unpainted_exemplars
from shapeforge.viewer.regroup import chosen_shapes, is_left_out
from shapeforge.viewer.runner import DOING, duration
from shapeforge.viewer.session import Session

MAP_PICTURE = 160
"""Side of the pictures of the map (pixels): sharp up to twice the size they are first seen at."""


class CollectionStrip(QWidget):
    """Exemplars to paint, what runs or was done, and the one blue button: the next step."""

    chosen = Signal(str)
    opened = Signal(str)

    def __init__(self, session: Session, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.session, self.actions = session, actions
        self.card_of: dict[str, Clickable] = {}
        self._card_pictures: list[tuple[Picture, str, bool]] = []
        self.strip_title, self.strip_count = label("Exemplars to paint", "heading"), label("", "text2")
        self.done_icon = icon_label("check", "ok")
        self.status = ElidedLabel("", "text2")
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(160)
        self.stop = action_button(actions, "stop", binding)
        self.next = button("Next", kind="primary")
        self.next.setLayoutDirection(Qt.LayoutDirection.RightToLeft)
        set_icon(self.next, "right", "on_accent")
        self.next.clicked.connect(self._press_next)
        self.line = separator(vertical=True)
        top = row(
            self.strip_title, self.strip_count, None, self.done_icon, self.status, self.bar, self.stop, 4,
            self.line, 4, self.next, margins=(PADDING, 0, PADDING, 0),
        )  # fmt: skip
        self.cards = row(None, spacing=8, margins=(PADDING, 0, PADDING, 0))
        inside = QWidget()
        inside.setLayout(self.cards)
        area = QScrollArea()
        area.setObjectName("panel")
        area.setFrameShape(QFrame.Shape.NoFrame)
        area.setWidgetResizable(True)
        area.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(inside)
        area.setFixedHeight(63)
        head = framed(top, height=39)
        self.setLayout(column(head, separator(), area, spacing=0))

    def show_exemplars(self) -> None:
        """Show the exemplars of the project as it is now."""
        session, groups = self.session, groups_of(self.session)
        clear(self.cards)
        self.card_of, self._card_pictures = {}, []
        if groups is None:
            self.strip_title.setText(counted(len(session.project.names), "shape"))
            self.strip_count.setText("")
            self.cards.addWidget(label("Grouping finds similar shapes and, for each group, one to paint.", "caption"))
            self.cards.addStretch(1)
            return
        left = set(unpainted_exemplars(session))
        exemplars = [session.project.names[i] for i in groups.exemplars]
        self.strip_title.setText("Exemplars to paint")
        self.strip_count.setText(f"{len(exemplars) - len(left)} of {len(exemplars)} painted")
        upcoming = next_to_paint(session)
        for name in exemplars:
            painted = name not in left
            role = "caption_ok" if painted else "caption"
            state = "painted" if painted else "next" if name == upcoming else "to paint"
            picture = Picture((38, 38))
            words = column(ElidedLabel(name, "strong", Qt.TextElideMode.ElideMiddle), label(state, role), spacing=0)
            about = f"{name}\nClick selects, double-click looks at it large."
            card = Clickable(row(picture, words, spacing=10, margins=(10, 3, 10, 3)), "card", tooltip=about)
            card.setFixedHeight(47)
            card.setMinimumWidth(132)
            card.clicked.connect(lambda name=name: self.chosen.emit(name))
            card.double_clicked.connect(lambda name=name: self.opened.emit(name))
            self.cards.addWidget(card, 1)
            self.card_of[name] = card
            self._card_pictures.append((picture, name, painted))
        if len(exemplars) < 4:
            self.cards.addStretch(4 - len(exemplars))
        self.show_current()

    def show_current(self) -> None:
        """Mark the card of the selected shape."""
        for name, card in self.card_of.items():
            card.set_current(name == self.session.shape)

    def show_pictures(self, pictures: Thumbnails) -> None:
        """Put the pictures that have arrived on their cards."""
        groups = groups_of(self.session)
        for picture, name, painted in self._card_pictures:
            shown = pictures.shape(name, MAP_PICTURE, parts="painted") if painted else None
            colour = rgb(group_colour(group_of(self.session, name), len(groups)))
            picture.set_pixmap(shown or pictures.shape(name, MAP_PICTURE, colour=colour))

    def show_progress(self) -> None:
        """Show what runs, else what was said last, and the next step."""
        session, progress = self.session, self.session.progress
        running = session.running
        self.bar.setVisible(running)
        self.stop.setVisible(running)
        for one in (self.line, self.next):
            one.setVisible(not running)
        self.done_icon.setVisible(not running and bool(session.status))
        if running and progress is not None:
            self.bar.setRange(0, 1000)
            self.bar.setValue(round(1000 * progress.share))
            left = f" · {duration(progress.seconds_left)} left" if progress.seconds_left is not None else ""
            self.status.setText(f"{DOING.get(progress.stage, progress.stage)} {progress.step} of {progress.of}{left}")
        elif running:
            self.bar.setRange(0, 0)
            self.status.setText(f"{DOING.get(session.stage or '', 'Working')}…")
        else:
            self.status.setText(session.status or self._group_text())
            kind = {"warning": "warning", "error": "error"}.get(session.status_kind, "check")
            set_icon(self.done_icon, kind, {"check": "ok"}.get(kind, kind))
            self.done_icon.setVisible(bool(self.status.full_text()))
        self._show_next()

    def _group_text(self) -> str:
        record = self.session.project.stage_record("group")
        if not record or "seconds" not in record or groups_of(self.session) is None:
            return ""
        return f"Grouped {counted(len(self.session.project.names), 'shape')} in {duration(record['seconds'])}"

    def _show_next(self) -> None:
        name, text = next_step(self.session)
        self.next.setText(shortened(text, 34))
        turning = self.session.turn is not None  # one blue button at a time: "Keep" is it then
        set_style(self.next, "kind", "" if turning else "primary")
        set_icon(self.next, "right", "text_2" if turning else "on_accent")
        self.next.setEnabled(self.actions.verdict(name)[0])
        self.next.setToolTip(tooltip_of(self.actions, name))

    def _press_next(self) -> None:
        self.actions.run(next_step(self.session)[0])


class SelectionSection(QWidget):
    """What is selected, and what can be done to it; always there, so that nothing below it jumps."""

    def __init__(self, session: Session, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self._session = session
        self.what = ElidedLabel("", "text2", Qt.TextElideMode.ElideMiddle)
        self.move = action_button(actions, "move_shapes", binding)
        self.new = action_button(actions, "make_group", binding)
        self.out = action_button(actions, "leave_out", binding)
        self.turn = action_button(actions, "turn_shape", binding)
        rows = []
        for pair in ((self.move, self.new), (self.out, self.turn)):
            line = row(*pair, spacing=8)
            line.setStretch(0, 1)
            line.setStretch(1, 1)
            rows.append(line)
        head = row(label("Selected", "heading"), self.what)
        head.setStretch(1, 1)
        self.setLayout(column(section(head, *rows), spacing=0))

    def show_selection(self) -> None:
        """Show the selection as it is now."""
        names, total = chosen_shapes(self._session), len(self._session.project.names)
        self.what.setText(
            "nothing" if not names else names[0] if len(names) == 1 else f"{grouped(len(names))} of {grouped(total)}"
        )
        self.what.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.out.setText("Put it back" if is_left_out(self._session) else "Leave out")


class ProblemList(QWidget):
    """Every file that was not read or is doubtful, with the reason; its tooltip has the remedy."""

    fix_wanted = Signal(str)

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self.read_count = label("", "off")
        self.copy = button("Copy list", kind="link", tooltip="Copy the list of problems as text")
        self.copy.clicked.connect(self._copy_problems)
        self.problem_list = column(spacing=8)
        head = row(label("Import", "heading"), self.read_count, None, self.copy)
        self.setLayout(column(section(head, self.problem_list, line=False), spacing=0))

    def show_problems(self, session: Session) -> None:
        """Show the problems of the project as they are now."""
        clear(self.problem_list)
        project = session.project
        problems = sorted(project.problems, key=lambda problem: problem.kind)
        by_source = {project.shape_record(name)["source"]: name for name in project.names}
        errors = sum(problem.kind == "error" for problem in problems)
        total = len(project.names) + errors
        self.read_count.setText(f"{grouped(len(project.names))} of {grouped(total)} read" if total else "")
        self.copy.setVisible(bool(problems))
        of_file: dict[str, list[Problem]] = {}
        for problem in problems:
            of_file.setdefault(problem.file, []).append(problem)
        for file, found in of_file.items():
            self._add(file, found, by_source.get(file))
        if not problems:
            nothing = "Files are being read…" if session.running else "Nothing has been imported yet."
            text = "Every file was read without complaint." if project.names else nothing
            self.problem_list.addWidget(label(text, "caption", wrap=True))
        refresh(self, session.theme)

    def _add(self, file: str, problems: Sequence[Problem], shape: str | None) -> None:
        """One file, and all that is to be said of it; ``shape`` is the name of what was read from it."""
        failed = any(problem.kind == "error" for problem in problems)
        reasons = "; ".join(problem.reason for problem in problems)
        said = label(f"{'not read' if failed else 'read'}: {reasons}", "caption", wrap=True)
        said.setToolTip("\n".join(problem.remedy for problem in problems if problem.remedy))
        name = ElidedLabel(Path(file).name, "strong", Qt.TextElideMode.ElideMiddle)
        sign = icon_label("error" if failed else "warning", "error" if failed else "warning")
        words = column(name, said, spacing=0)
        if shape is not None and any(problem.reason.startswith("turned") for problem in problems):
            fix = button("Turn it…", kind="link", tooltip="Put it upright, facing as the others do")
            fix.setStyleSheet("font-size: 11px; min-height: 16px; max-height: 16px;")
            fix.clicked.connect(lambda: self.fix_wanted.emit(shape))
            words.addLayout(row(fix, None))
        self.problem_list.addLayout(row(column(sign, None, margins=(0, 2, 0, 0)), words, spacing=8))

    def _copy_problems(self) -> None:
        text = "\n".join(str(problem) for problem in self._session.project.problems)
        QGuiApplication.clipboard().setText(text)
        self._session.say("The list of problems is in the clipboard", "ok")
