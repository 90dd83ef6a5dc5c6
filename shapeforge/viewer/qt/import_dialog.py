"""Before an import: what each file holds, its size and which way is up, what cannot be read and why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QPoint, QSize, Qt, Signal
from PySide6.QtGui import QColor, QIcon, QPainter
from PySide6.QtWidgets import (
    QAbstractItemView,
    QDialog,
    QHeaderView,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from shapeforge.collection.counts import counted, grouped
from shapeforge.viewer.import_preview import (
    FilePreview,
    Usual,
    doubts,
    previews,
    size_words,
    summary,
    upright_mesh,
    usual,
)
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.pictures import mesh_view, take_picture
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.controls import Choice as Menu
from shapeforge.viewer.qt.theme import colours
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import ElidedLabel, button, column, label, row
from shapeforge.viewer.runner import Runner, sentence
from shapeforge.viewer.session import Session

UPS = (("auto", "guessed"), ("keep", "as in the files"), ("y", "y"), ("z", "z"), ("x", "x"))
HEADINGS = ("File", "Faces", "Width × height × depth", "Remarks")
TICK = 12  # pixels
PICTURED = 20000  # faces: larger files get no picture here, it would make the list wait


class _Mail(QObject):
    arrived = Signal()


class _Names(QStyledItemDelegate):
    """Names that are too long lose their middle: what tells two files apart is often at the end.

    The tick is drawn here: a style sheet has none but from a file.
    """

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        super().paint(painter, option, index)
        if Qt.CheckState(index.data(Qt.ItemDataRole.CheckStateRole) or 0) != Qt.CheckState.Checked:
            return
        table, shown = option.widget, QStyleOptionViewItem(option)
        self.initStyleOption(shown, index)
        box = table.style().subElementRect(QStyle.SubElement.SE_ItemViewItemCheckIndicator, shown, table)
        corner = box.center() - QPoint(TICK // 2 - 1, TICK // 2 - 1)
        painter.drawPixmap(corner, icons.pixmap("check", colours(table)["on_accent"], TICK))

    def initStyleOption(self, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> None:
        super().initStyleOption(option, index)
        option.textElideMode = Qt.TextElideMode.ElideMiddle


class ImportDialog(QDialog):
    """Reads the files in a thread of its own; ``go(paths, up)`` is called with those that are ticked."""

    def __init__(
        self, session: Session, paths: tuple[Path, ...], go: Callable[[tuple[Path, ...], str], None],
        parent: QWidget | None = None,
    ) -> None:  # fmt: skip
        super().__init__(parent)
        self.setWindowTitle("Import shapes")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setModal(True)
        self.resize(1000, 560)
        self.session, self.go, self.paths = session, go, paths
        self.seen: list[FilePreview] = []
        self.among = Usual()
        known = session.project if session.project is not None and session.project.names else None
        record = (known.stage_record("import") or {}) if known is not None else {}
        self.up = record.get("options", {}).get("up", "auto")
        self.failed = ""
        self.pictures = Thumbnails(session)
        self.pictures.setParent(self)
        self.pictures.arrived.connect(self._show_pictures)
        self.title = label("Looking at the files…", "title")
        self.said = ElidedLabel("", "text2")
        self.up_choice = Menu("Up is", UPS, self.up, tooltip="Which axis of the files is up; each can be turned later")
        if known is not None:
            self.up_choice.setEnabled(False)
            self.up_choice.setToolTip("As for the shapes that are there already; each can be turned later.")
        self.up_choice.chosen.connect(self._choose_up)
        self._make_table()
        self.cancel = button("Cancel", tooltip="Import nothing  (Esc)")
        self.cancel.clicked.connect(self.reject)
        self.start = button("Import", kind="primary")
        self.start.setDefault(True)
        self.start.clicked.connect(self.accept)
        told = label("Sizes are for your information: every shape is scaled alike. Files are copied, never changed.",
                     "caption")  # fmt: skip
        foot = row(told, None, self.cancel, self.start, spacing=8)
        top = row(self.title, None, self.up_choice)
        self.setLayout(column(top, self.said, self.table, foot, spacing=10, margins=(20, 16, 20, 16)))
        self._mail = _Mail(self)
        self._mail.arrived.connect(self._read_mail)
        self.reader = Runner(self._mail.arrived.emit)
        self.done_reading = False
        self.reader.start("preview", lambda: previews(paths))
        self._show_count()

    def _make_table(self) -> None:
        self.table = QTableWidget(0, len(HEADINGS))
        self.table.setHorizontalHeaderLabels(HEADINGS)
        self.table.verticalHeader().hide()
        self.table.setShowGrid(False)
        self.table.setWordWrap(False)
        self.table.setItemDelegateForColumn(0, _Names(self.table))
        self.table.setIconSize(QSize(40, 40))
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        head = self.table.horizontalHeader()
        head.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        head.setHighlightSections(False)
        for number, width in enumerate((280, 76, 222)):
            self.table.setColumnWidth(number, width)
        head.setSectionResizeMode(3, QHeaderView.ResizeMode.Stretch)
        self.table.itemChanged.connect(lambda _item: self._show_count())

    def _read_mail(self) -> None:
        news = self.reader.take()
        if news is None:
            return
        for one in news.states:
            self._add(one)
        among = usual(self.seen)
        if news.outcome is not None or (among.units, among.up) != (self.among.units, self.among.up):
            self.among = among
            self._fill_all()
        if news.outcome is not None:
            self._put_doubtful_first()
            self.done_reading = True
            self.failed = sentence(news.error) if news.error is not None else ""
        self._show_count()

    def _add(self, one: FilePreview) -> None:
        theme = self.session.theme
        # What cannot be read comes first: it is what needs a look.
        line = sum(bool(other.problem) for other in self.seen) if one.problem else len(self.seen)
        self.seen.insert(line, one)
        self.table.blockSignals(True)
        self.table.insertRow(line)
        self.table.setRowHeight(line, 48)
        name = QTableWidgetItem(one.name)
        name.setToolTip(str(one.path))
        flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        if one.problem:
            name.setFlags(flags)
            name.setIcon(QIcon(icons.pixmap("error", tokens(theme)["error"], 16, 1.0)))
            remark = QTableWidgetItem(f"not read: {one.problem}")
            remark.setToolTip(f"{one.problem}. {one.remedy}.")
        else:
            name.setFlags(flags | Qt.ItemFlag.ItemIsUserCheckable)
            name.setCheckState(Qt.CheckState.Checked)
            remark = QTableWidgetItem()
        cells = (name, QTableWidgetItem("" if one.problem else grouped(one.n_faces)), QTableWidgetItem(), remark)
        for number, cell in enumerate(cells):
            if number:
                cell.setFlags(flags)
            self.table.setItem(line, number, cell)
        self._fill(line)
        self.table.blockSignals(False)
        self._show_picture(line)

    def _fill_all(self) -> None:
        self.table.blockSignals(True)
        for line in range(len(self.seen)):
            self._fill(line)
        self.table.blockSignals(False)

    def _fill(self, line: int) -> None:
        """Size and remarks of a file, as they are beside those of the others."""
        one, remark, look = self.seen[line], self.table.item(line, 3), tokens(self.session.theme)
        odd = doubts(one, self.among, self.up)
        sign = "error" if one.problem else "warning" if odd else "ok"
        drawn = {"error": "error", "warning": "warning", "ok": "check"}[sign]
        remark.setIcon(QIcon(icons.pixmap(drawn, look[sign], 16, 1.0)))
        if not one.problem:
            up = one.up if self.up == "auto" else "as in the file" if self.up == "keep" else f"{self.up} is up"
            said = odd if any(words.startswith(up) for words in odd) else (*odd, up)
            remark.setText(" · ".join(said))
            remark.setToolTip("\n".join(said))
            unlike = any(words not in one.notes for words in odd)
            remark.setForeground(QColor(look["warning" if unlike else "text"]))
            self.table.item(line, 2).setText(size_words(one, self.among))

    def _put_doubtful_first(self) -> None:
        """What cannot be read, then what needs a look, then the rest, each in the order of the names; ticks stay."""
        rank = [0 if one.problem else 1 if doubts(one, self.among, self.up) else 2 for one in self.seen]
        order = sorted(range(len(self.seen)), key=lambda line: (rank[line], line))
        self.table.blockSignals(True)
        self.table.clearSelection()
        taken = [[self.table.takeItem(line, number) for number in range(len(HEADINGS))] for line in order]
        for line, cells in enumerate(taken):
            for number, cell in enumerate(cells):
                self.table.setItem(line, number, cell)
        self.table.blockSignals(False)
        self.seen = [self.seen[line] for line in order]

    def _picture_of(self, one: FilePreview):
        up, theme = self.up, self.session.theme

        def take() -> np.ndarray:
            return take_picture(mesh_view(upright_mesh(one, up), None, theme), 80, theme, transparent=True)

        return self.pictures.pixmap(("import", str(one.path), up, theme), take)

    def _show_picture(self, line: int) -> None:
        one = self.seen[line]
        if one.mesh is not None and one.n_faces <= PICTURED:
            pixmap = self._picture_of(one)
            if pixmap is not None:
                self.table.item(line, 0).setIcon(QIcon(pixmap))

    def _show_pictures(self) -> None:
        self.table.blockSignals(True)
        for line in range(len(self.seen)):
            self._show_picture(line)
        self.table.blockSignals(False)

    def _choose_up(self, up: str) -> None:
        self.up = up
        self._fill_all()
        self._show_pictures()
        self._show_count()

    def ticked(self) -> tuple[Path, ...]:
        """The files that will be imported."""
        return tuple(
            one.path for line, one in enumerate(self.seen)
            if not one.problem and self.table.item(line, 0).checkState() == Qt.CheckState.Checked
        )  # fmt: skip

    def _show_count(self) -> None:
        count, of = len(self.ticked()), max((one.of for one in self.seen), default=0)
        if not self.done_reading:
            self.title.setText(
                f"Looking at file {grouped(len(self.seen) + 1)} of {grouped(of)}…" if of else "Looking at the files…"
            )
        else:
            self.title.setText(
                "Nothing to import" if not any(not one.problem for one in self.seen) else "Import shapes"
            )
        self.said.setText(self.failed or (summary(self.seen, self.up) if self.seen else ""))
        self.start.setText(f"Import {counted(count, 'shape')}" if count else "Import")
        can = self.done_reading and count > 0
        self.start.setEnabled(can)
        why = "" if can else "Tick at least one file." if self.done_reading else "The files are still being looked at."
        self.start.setToolTip(why or "Copy these files into the project and find groups of similar shapes")

    def accept(self) -> None:
        """Import what is ticked: all files given, those that cannot be read too, so that they are named afterwards."""
        if not self.start.isEnabled():
            return
        ticked = self.ticked()
        bad = tuple(one.path for one in self.seen if one.problem)
        all_of_it = len(ticked) + len(bad) == len(self.seen)
        super().accept()
        self.go(self.paths if all_of_it else (*ticked, *bad), self.up)

    def done(self, result: int) -> None:
        self.reader.stop()
        self.reader.on_news = lambda: None
        self.pictures.forget()
        super().done(result)
