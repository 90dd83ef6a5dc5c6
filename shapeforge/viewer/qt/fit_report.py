"""The inspector of Fit: energy and spread over the rounds, and which parts the selected shape has."""

from __future__ import annotations

from functools import partial

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFrame, QWidget

from shapeforge.collection.counts import counted, grouped
from shapeforge.viewer.fit_display import sureness
from shapeforge.viewer.fit_record import WATCHED_AT_MOST, FitRecord
from shapeforge.viewer.palette import as_hex, tokens
from shapeforge.viewer.qt.controls import Clickable
from shapeforge.viewer.qt.fit_widgets import PHASES
from shapeforge.viewer.qt.plots import Curves
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.widgets import (
    ElidedLabel,
    Swatch,
    button,
    clear,
    column,
    framed,
    heading,
    icon_label,
    label,
    row,
    scrolled,
    section,
    separator,
)
from shapeforge.viewer.readiness import Verdict, planned_rounds
from shapeforge.viewer.session import Session

ANOTHER_SUM = (
    "From the line on the fit is by the family's own templates instead of the exemplars': "
    "its energy is another sum, not to be compared with the one before."
)
"""Why the curves begin anew there."""


class OffNote(QFrame):
    """Why a part is off on the shape, where else, and what can be done about it."""

    def __init__(
        self, part_name: str, reason: str, others: tuple[str, ...], override: Verdict, which: tuple[int, int]
    ) -> None:
        """``override`` is whether it can be insisted on now, and what to do then or why not.

        It is note ``which`` = (n, of all): the next one is shown after a click on ``next``.
        """
        super().__init__()
        self.setObjectName("note")
        also = f" Also off on {counted(len(others), 'other shape')}." if others else ""
        self.title = label(f"{part_name} switched off".capitalize(), "heading", wrap=True)
        self.text = label(f"{reason}{also}", "caption", wrap=True, tooltip=", ".join(others[:60]))
        self.override = button("Override", kind="link", tooltip=override[1])
        self.override.setEnabled(override[0])
        count = min(len(others), WATCHED_AT_MOST)
        words = (
            "Show it" if len(others) == 1 else f"Show the {count}" if count == len(others) else f"Show {count} of them"
        )
        self.show_others = button(words, kind="link", tooltip="Watch these shapes below")
        self.show_others.setVisible(bool(others))
        number = label(f"{which[0]} of {which[1]}" if which[1] > 1 else "", "caption")
        self.next = button("Next", kind="link", tooltip="Why the next part is off")
        self.next.setVisible(which[1] > 1)
        links = row(self.override, self.show_others, None, self.next, spacing=16)
        sign = column(icon_label("info", "accent_text"), None)
        top = row(spacing=8)
        top.addWidget(self.title, 1)
        top.addWidget(number)
        self.setLayout(row(sign, column(top, self.text, 2, links, spacing=2), margins=(12, 8, 12, 8)))


class FitReport(QWidget):
    """Curves and parts, and below them a note about one part that is off: the one that was clicked, else the first.

    Curves and parts scroll where there is no room for them, the note does not: it is what something can be done with.
    ``watch`` asks to see the shapes it names.
    """

    watch = Signal(tuple)
    override = Signal(str)

    def __init__(self, above: QWidget | None = None) -> None:
        """``above`` is shown above the curves."""
        super().__init__()
        self.notes: dict[str, OffNote] = {}
        self.off_rows: dict[str, Clickable] = {}
        self._explained = ""
        self.energy = Curves(height=72, numbered=False, phases=PHASES)
        self.change = Curves(from_zero=True, height=58, numbered=False)
        self.sigma = Curves(from_zero=True, height=88)
        self.energy_text = label("", "caption", wrap=True)
        self.parts_title = ElidedLabel("Parts", "heading")
        self.part_list = column(spacing=0)
        energy = heading("Energy", "", label("nats per point", "caption"))
        change = heading("Movement of the points", "", label("% of size a round", "caption"))
        sigma = heading("Spread σ by part", "", label("% of size", "caption"))
        body = scrolled(
            *([] if above is None else [above]),
            section(
                energy,
                self.energy,
                self.energy_text,
                6,
                change,
                self.change,
                4,
                sigma,
                self.sigma,
                spacing=2,
            ),
            section(row(self.parts_title), self.part_list, line=False),
        )
        self._note_box = column(spacing=0, margins=(PADDING, 12, PADDING, 12))
        self._note_holder = framed(column(separator(), self._note_box, spacing=0))
        box = column(spacing=0)
        box.addWidget(body, 1)
        box.addWidget(self._note_holder)
        self.setLayout(box)

    def show_fit(self, record: FitRecord, session: Session, number: int) -> None:
        """Show the curves up to the newest round, the text of round ``number``, the parts of the selected shape."""
        self._show_curves(record, session, number)
        self.energy_text.setText(energy_text(record, number))
        self._show_parts(record, session)

    def _show_curves(self, record: FitRecord, session: Session, number: int) -> None:
        rounds = record.rounds
        numbers = sorted(rounds)
        of = record.planned or planned_rounds(session)
        look = tokens(session.theme)
        at = float(number) if numbers else None
        energies = [rounds[n].energy for n in numbers]
        self.energy.set_theme(session.theme)
        self.sigma.set_theme(session.theme)
        self.energy.set_series([(numbers, energies, look["accent"])], of, at)
        changes = [100 * rounds[n].change for n in numbers]
        self.change.set_theme(session.theme)
        self.change.set_series([(numbers, changes, look["text_2"])], of, at)
        names = record.looks[0].part_names if record.looks else ()
        inks = [as_hex(ink) for ink in record.looks[0].inks] if record.looks else []
        curves = [
            (numbers, [100 * float(rounds[n].sigma[part]) for n in numbers], inks[part]) for part in range(len(names))
        ]
        self.sigma.set_series(curves, of, at)
        for plot in (self.energy, self.change, self.sigma):
            plot.set_phase(record.family_after)
            plot.setToolTip("" if record.family_after is None else ANOTHER_SUM)

    def _show_parts(self, record: FitRecord, session: Session) -> None:
        clear(self.part_list)
        clear(self._note_box)
        self.notes, self.off_rows = {}, {}
        name = session.shape or ""
        self.parts_title.setText(f"Parts of {name}")
        beliefs = record.beliefs(name) if record.looks else None
        if beliefs is None or record.newest < 1:
            self.part_list.addWidget(label("Known after the first round.", "caption"))
            self._note_holder.hide()
            return
        sure = sureness(np.asarray(beliefs.segmentation, float))
        lent = {part: record.looks[theirs.template].source for part, theirs in beliefs.lent}
        names = record.looks[0].part_names
        off = [part for part in range(len(names)) if not (beliefs.active[part] or part in lent)]
        for part in range(len(names)):
            line = _part_row(record, part, part not in off, float(sure[part]), lent.get(part))
            self.part_list.addWidget(line)
            if part in off:
                self.off_rows[names[part]] = line
                line.clicked.connect(partial(self.explain, names[part]))
        for number, part in enumerate(off):
            note = self._add_note(record, session, part, name, (number + 1, len(off)))
            following = names[off[(number + 1) % len(off)]]
            note.next.clicked.connect(partial(self.explain, following))
        self._note_holder.setVisible(bool(off))
        if off:
            self._show_note(self._explained if self._explained in self.notes else names[off[0]])

    def explain(self, part_name: str, _checked: bool = False) -> None:
        """Show the note about a part that is off; it stays the one shown on other shapes that lack the part."""
        self._explained = part_name
        self._show_note(part_name)

    def _show_note(self, part_name: str) -> None:
        for one, note in self.notes.items():
            note.setVisible(one == part_name)
            self.off_rows[one].set_current(one == part_name and len(self.notes) > 1)

    def _add_note(
        self, record: FitRecord, session: Session, part: int, name: str, which: tuple[int, int]
    ) -> OffNote:  # fmt: skip
        """Why a part is off on the shape ``name``, on which others it is, and the way to insist on it."""
        beliefs, part_name = record.beliefs(name), record.looks[0].part_names[part]
        others = tuple(one for one in record.off_on(part) if one != name)
        known = part in record.looks[beliefs.template].label
        can = (
            (False, "Stop the fit first.") if session.running
            else (True, f"{name} has this part? Paint some of it, and the next fit keeps it.")
        )  # fmt: skip
        odds = float(beliefs.misfit[part]) if known else float("nan")
        note = OffNote(part_name, existence_text(odds), others, can, which)
        note.override.clicked.connect(lambda: self.override.emit(part_name))
        note.show_others.clicked.connect(lambda: self.watch.emit(others[:WATCHED_AT_MOST]))
        self.notes[part_name] = note
        self._note_box.addWidget(note)
        return note


def _part_row(record: FitRecord, part: int, on: bool, sure: float, source: str | None) -> QFrame:
    """One part: colour, name, the exemplar that lends it (``source``), and how sure it is (NaN: without points).

    The row of a part that is off can be clicked.
    """
    look, off_on = record.looks[0], record.off_on(part)
    tooltip = f"Off on {grouped(len(off_on))} of {counted(len(record.active), 'shape')}" if off_on else "On every shape"
    swatch = Swatch(as_hex(look.inks[part]))
    swatch.setEnabled(on)
    said = ElidedLabel(look.part_names[part], "" if on else "off", Qt.TextElideMode.ElideMiddle, about=tooltip)
    lender = ElidedLabel(f"from {source}" if source else "", "caption", Qt.TextElideMode.ElideMiddle, about=LENT)
    if not on:
        state = label("off", "off", tooltip=tooltip)
    elif np.isnan(sure):
        state = label("no points", "warning", tooltip="No surface of the shape is taken for this part")
    else:
        certain = "How sure the surface that is taken for this part is"
        state = label(f"{100 * sure:.0f}% sure", "text2" if sure > 0.75 else "warning", tooltip=certain)
    line = row(swatch, 4, said, lender, None, state, margins=(ROW_INSET, 0, ROW_INSET, 0))
    if on:
        return framed(line, "", height=28)
    result = Clickable(line, "row", tooltip=f"{tooltip}; a click tells why")
    result.setFixedHeight(28)
    return result


ROW_INSET = 6
"""Pixels at both ends of a row, for the ground of the one that is explained."""
LENT = "The exemplar that explains this shape best lacks the part: another one brings it"


def existence_text(odds: float) -> str:
    """Why a part is off, from the log odds (nats) of its existence: NaN when its template has no such part."""
    if np.isnan(odds):
        return "The exemplar that explains this shape best has no such part, and no other brings one."
    if np.isinf(odds):
        return "It claims no surface that another part would not."
    chance = 100 / (1 + np.exp(-np.clip(odds, -50, 50)))
    words = "less than 1%" if chance < 1 else f"{chance:.0f}%"
    return f"Its points hardly fit the surface: {words} likely to be there."


def energy_text(record: FitRecord, number: int) -> str:
    """What a round brought, in a sentence or two with units."""
    rounds = record.rounds
    if number < 1:
        return "The curve starts with the first round."
    now, before = rounds.get(number), rounds.get(number - 1)
    if now is None:
        return "Of this round only the positions were recorded."
    parts = []
    if number - 1 == record.family_after:
        parts.append(f"{now.energy:.3f} nats: the family's first round, another sum.".replace("-", "−"))
    elif before is not None and np.isfinite(before.energy):
        parts.append(f"This round {now.energy - before.energy:+.3f} nats.".replace("-", "−"))
    else:
        parts.append(f"{now.energy:.3f} nats.".replace("-", "−"))
    if np.isfinite(now.change):
        parts.append(f"Moved {100 * now.change:.2f}%.")
    if now.stop_reason:
        parts.append(f"Stopped: {now.stop_reason}.")
    return " ".join(parts)
