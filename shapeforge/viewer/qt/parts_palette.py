"""The palette of parts: their colours, keys and shares; new, rename, hide and merge."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QMessageBox, QWidget

from shapeforge.viewer.painter import Painter
from shapeforge.viewer.palette import part_colours
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import PartRow
from shapeforge.viewer.qt.widgets import button, clear, column, label, row, section
from shapeforge.viewer.session import Session


class PartsPalette(QWidget):
    """Shows the parts of the project; the chosen one is ``session.part``, ``second`` the one to merge into it.

    ``view_changed`` is called when the shape has to be drawn again, ``counts_wanted`` when the shares have.
    """

    def __init__(
        self, session: Session, painter: Painter, view_changed: Callable[[], None], counts_wanted: Callable[[], None]
    ) -> None:
        super().__init__()
        self.session, self.painter = session, painter
        self.view_changed, self.counts_wanted = view_changed, counts_wanted
        self.second: int | None = None
        self.rows: list[PartRow] = []
        self.part_count = label("", "off")
        self.part_rows = column(spacing=2)
        new = button("New part", icon="plus", tooltip="Add a part to the family  (Shift+N)")
        new.clicked.connect(self.new_part)
        self.merge = button("Merge…")
        self.merge.clicked.connect(self._ask_merge)
        self.merge_hint = label("", "caption_off", wrap=True)
        buttons = row(new, self.merge, spacing=8)
        buttons.setStretch(0, 1)
        buttons.setStretch(1, 1)
        head = row(label("Parts", "heading"), self.part_count, None, label("share of the area", "caption"))
        self.setLayout(column(section(head, self.part_rows, 4, buttons, self.merge_hint, spacing=6), spacing=0))

    def show_parts(self) -> None:
        """Rows for the parts there are now."""
        names = self.painter.part_names
        clear(self.part_rows)
        self.rows = []
        for part, (name, colour) in enumerate(zip(names, part_colours(len(names)), strict=True)):
            one = PartRow(name, "#{:02X}{:02X}{:02X}".format(*colour), str(part + 1) if part < 9 else "")
            one.clicked.connect(lambda part=part: setattr(self.session, "part", part))
            one.ctrl_clicked.connect(lambda part=part: self.select_second(part))
            one.eye_clicked.connect(lambda part=part: self.hide_part(part))
            one.renamed.connect(lambda text, part=part: self._rename(part, text))
            one.set_hidden(part in self.painter.hidden)
            self.part_rows.addWidget(one)
            self.rows.append(one)
        if not names:
            self.part_rows.addWidget(label("No parts yet. Add the first, or just paint.", "caption", wrap=True))
        refresh(self, self.session.theme)
        self.part_count.setText(str(len(names)) if names else "")
        self.show_chosen()
        self.counts_wanted()

    def show_chosen(self) -> None:
        """Mark the current part, and the one to merge it with."""
        for part, one in enumerate(self.rows):
            one.set_current(part in (self.session.part, self.second))
        ready = self.second is not None and self.second != self.session.part
        self.merge.setEnabled(ready)
        self.merge.setToolTip(
            "Give all paint of the second part to the first, on every shape" if ready
            else "Select two parts first: Ctrl-click the second."
        )  # fmt: skip
        self.merge_hint.setText(
            f"Merge {self.rows[self.second].name.text()} into {self.rows[self.session.part].name.text()}."
            if ready and max(self.second, self.session.part) < len(self.rows)
            else "Merge: select two parts first (Ctrl-click)."
        )
        if self.painter.isolated:
            self.view_changed()

    def select_second(self, part: int) -> None:
        """Choose (or no more) the part to merge into the current one."""
        self.second = None if self.second == part else part
        self.show_chosen()

    def hide_part(self, part: int) -> None:
        """Shut or open the eye of a part."""
        self.painter.hidden = self.painter.hidden ^ {part}
        self.rows[part].set_hidden(part in self.painter.hidden)
        self.view_changed()

    def new_part(self) -> None:
        """Add a part, take it, and let its name be written."""
        names = self.painter.part_names
        name = next(f"part {i}" for i in range(1, len(names) + 2) if f"part {i}" not in names)
        self.session.part = self._try(lambda: self.painter.add_part(name), self.session.part)
        self.show_parts()
        if self.rows:
            self.rows[-1].rename()

    def _rename(self, part: int, text: str) -> None:
        self._try(lambda: self.painter.rename_part(part, text), None)
        QTimer.singleShot(0, self.show_parts)
        self.session.touch("labels")

    def _ask_merge(self) -> None:
        kept, gone, names = self.session.part, self.second, self.painter.part_names
        if gone is None:
            return
        count = len(self.session.project.labelled)
        ask = QMessageBox(self.window())
        ask.setWindowTitle("Merge parts")
        ask.setText(f"Merge {names[gone]} into {names[kept]}?")
        ask.setInformativeText(f"It is done on {count} labelled shape{'s' * (count != 1)} and cannot be undone.")
        ask.setStandardButtons(QMessageBox.StandardButton.Ok | QMessageBox.StandardButton.Cancel)
        ask.accepted.connect(lambda: self.merged(kept, gone))
        ask.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        ask.open()

    def merged(self, kept: int, gone: int) -> None:
        """Merge ``gone`` into ``kept`` on every shape."""
        self.second = None
        self._try(lambda: self.painter.merge_parts(kept, gone), None)
        self.show_parts()
        self.session.touch("labels")
        self.view_changed()

    def _try(self, do: Callable[[], object], otherwise: object) -> object:
        try:
            return do()
        except (ValueError, OSError) as error:
            self.session.say(str(error), "error")
            return otherwise
