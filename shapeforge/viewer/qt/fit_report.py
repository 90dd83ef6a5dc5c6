"""The inspector of Fit: energy and spread over the rounds, and which parts the selected shape has."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QWidget

from shapeforge.viewer.fit_display import sureness
from shapeforge.viewer.fit_record import WATCHED_AT_MOST, FitRecord
from shapeforge.viewer.palette import part_colours, tokens
from shapeforge.viewer.qt.plots import Curves
from shapeforge.viewer.qt.widgets import (
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
)
from shapeforge.viewer.session import Session


class FitReport(QWidget):
    """Curves, parts, and a note about parts that are switched off; ``watch`` asks to see the shapes it names."""

    watch = Signal(tuple)
    override = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self._off_here = ""
        self._off: tuple[str, ...] = ()
        self.energy, self.sigma = Curves(), Curves(from_zero=True)
        self.energy_text = label("", "caption", wrap=True)
        self.parts_title = label("Parts", "heading")
        self.part_list = column(spacing=0)
        self.note_title, self.note_text = label("", "heading", wrap=True), label("", "caption", wrap=True)
        self.note_show = button("", kind="link", tooltip="Watch these shapes below")
        self.note_show.clicked.connect(lambda: self.watch.emit(self._off))
        self.note_override = button("Override", kind="link")
        self.note_override.clicked.connect(lambda: self.override.emit(self._off_here))
        words = column(
            self.note_title, self.note_text, 4, row(self.note_override, self.note_show, None, spacing=16), spacing=2
        )
        sign = column(icon_label("info", "accent_text"), None)
        self.note = framed(row(sign, words, margins=(12, 10, 12, 10)), "note")
        energy = heading("Energy", "", label("nats per point", "caption"))
        sigma = heading("Spread σ by part", "", label("% of size", "caption"))
        body = scrolled(
            section(energy, self.energy, self.energy_text, spacing=4),
            section(sigma, self.sigma, spacing=4),
            section(row(self.parts_title), self.part_list, self.note, line=False),
        )
        self.setLayout(column(body, spacing=0))

    def show_fit(self, record: FitRecord, session: Session, number: int) -> None:
        """Show the curves up to the newest round, the text of round ``number``, the parts of the selected shape."""
        self._show_curves(record, session, number)
        self.energy_text.setText(energy_text(record, number))
        self._show_parts(record, session)

    def _show_curves(self, record: FitRecord, session: Session, number: int) -> None:
        rounds = record.rounds
        numbers = sorted(rounds)
        of = record.planned
        look = tokens(session.theme)
        at = float(number) if numbers else None
        energies = [rounds[n].energy for n in numbers]
        self.energy.set_theme(session.theme)
        self.sigma.set_theme(session.theme)
        self.energy.set_series([(numbers, energies, look["accent"])], of, at)
        names = record.looks[0].part_names if record.looks else ()
        inks = ["#{:02X}{:02X}{:02X}".format(*ink) for ink in part_colours(len(names))]
        curves = [
            (numbers, [100 * float(rounds[n].sigma[part]) for n in numbers], inks[part]) for part in range(len(names))
        ]
        self.sigma.set_series(curves, of, at)

    def _show_parts(self, record: FitRecord, session: Session) -> None:
        clear(self.part_list)
        name = session.shape or ""
        self.parts_title.setText(f"Parts of {name}")
        beliefs = record.beliefs(name) if record.looks else None
        self._off: tuple[str, ...] = ()
        self.note.setVisible(False)
        if beliefs is None or record.newest < 1:
            self.part_list.addWidget(label("Known after the first round.", "caption"))
            return
        names = record.looks[0].part_names
        inks = part_colours(len(names))
        sure = sureness(np.asarray(beliefs.segmentation, float))
        for part, part_name in enumerate(names):
            on = bool(beliefs.active[part])
            swatch = Swatch("#{:02X}{:02X}{:02X}".format(*inks[part]))
            swatch.setEnabled(on)
            said = label(part_name, "" if on else "off")
            if not on:
                state = label("off", "off")
            elif np.isnan(sure[part]):
                state = label("no points", "warning")
            else:
                state = label(f"{100 * sure[part]:.0f}% sure", "text2" if sure[part] > 0.75 else "warning")
            self.part_list.addWidget(framed(row(swatch, 4, said, None, state), "", height=30))
        off = [part for part in range(len(names)) if not beliefs.active[part]]
        if off:
            part = off[0]
            self._off_here = names[part]
            self.note_override.setEnabled(not session.running)
            self.note_override.setToolTip(
                "Stop the fit first." if session.running
                else f"{name} has this part? Paint some of it, and the next fit keeps it."
            )  # fmt: skip
            odds = float(beliefs.misfit[part])
            self._off = record.off_elsewhere(part, name)
            also = f" Also on {len(self._off)} other shapes." if self._off else ""
            self.note_title.setText(f"{' and '.join(names[p] for p in off)} switched off".capitalize())
            self.note_text.setText(f"{existence_text(odds)}{also}")
            others = len(self._off)
            self._off = self._off[:WATCHED_AT_MOST]
            count = len(self._off)
            all_of = f"Show the {count}" if count > 1 else "Show it"
            self.note_show.setText(all_of if count == others else f"Show {count} of them")
            self.note_show.setVisible(bool(self._off))
            self.note.setVisible(True)


def existence_text(odds: float) -> str:
    """Why a part is off, from the log odds (nats) of its existence: NaN when its template has no such part."""
    if np.isnan(odds):
        return "The exemplar that explains this shape best has no such part."
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
    if before is not None and np.isfinite(before.energy):
        parts.append(f"This round {now.energy - before.energy:+.3f} nats.".replace("-", "−"))
    else:
        parts.append(f"{now.energy:.3f} nats.".replace("-", "−"))
    if np.isfinite(now.change):
        parts.append(f"Points moved {100 * now.change:.2f}% of size.")
    if now.stop_reason:
        parts.append(f"Stopped: {now.stop_reason}.")
    return " ".join(parts)
