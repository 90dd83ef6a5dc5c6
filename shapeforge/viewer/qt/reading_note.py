"""What stands in the middle of the collection while it has no shapes: which files are being read, or how to begin."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QWidget

from shapeforge.stages import Progress
from shapeforge.viewer.qt.icons import set_icon
from shapeforge.viewer.qt.widgets import ElidedLabel, column, icon_label, label, row
from shapeforge.viewer.session import Session

LINES, WIDTH = 8, 440
"""Files that are named at most, and how wide they stand (pixels)."""


class ReadingNote(QWidget):
    """The last files read, newest first, with what is wrong with them; the pointer goes through to what is below."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.title, self.words = label("", "title"), label("", "text2")
        self.read: list[tuple[str, str]] = []
        self.lines = [
            (icon_label("check", "ok", 14), ElidedLabel("", "text2", Qt.TextElideMode.ElideMiddle))
            for _ in range(LINES)
        ]
        self.files = QWidget()
        self.files.setFixedHeight(LINES * 24)
        listed = [row(sign, name, spacing=8) for sign, name in self.lines]
        for line, (_, name) in zip(listed, self.lines, strict=True):
            line.setStretchFactor(name, 1)
        self.files.setLayout(column(*listed, None, spacing=6))
        block = QWidget()
        block.setFixedWidth(WIDTH)
        block.setLayout(column(self.title, self.words, 8, self.files, spacing=6))
        self.setLayout(column(None, row(None, block, None), None, spacing=0))

    def show_now(self, shapes: bool) -> None:
        """Show how far the reading is; nothing where ``shapes`` are seen (an import under way has some before)."""
        session, progress = self.session, self.session.progress
        if shapes:
            self.read = []
            self.setVisible(False)
            return
        reading = session.running and progress is not None and progress.stage == "import"
        if not session.running:
            self.read = []
        if reading and progress.phase == "read" and progress.message:
            said = _said(progress)
            if said not in self.read[:1]:
                self.read = [said, *self.read][:LINES]
        self.files.setVisible(session.running)
        for one in (self.title, self.words):  # in a line with the names
            one.setAlignment(Qt.AlignmentFlag.AlignLeft if session.running else Qt.AlignmentFlag.AlignHCenter)
        if not session.running:
            self.title.setText("No shapes yet")
            self.words.setText("Import some, or drop files or a folder here.")
        elif reading and progress.of:
            self.title.setText(f"{progress.step} of {progress.of} read")
            self.words.setText("The shapes appear here when all of them are read.")
        else:
            self.title.setText("Looking for files…")
            self.words.setText("")
        for number, (sign, name) in enumerate(self.lines):
            text, kind = self.read[number] if number < len(self.read) else ("", "")
            sign.setVisible(bool(kind))
            if kind:
                set_icon(sign, kind, "ok" if kind == "check" else kind, 14)
            name.setText(text)
        self.setVisible(True)


def _said(progress: Progress) -> tuple[str, str]:
    """The line of a file that was read, with what is wrong with it, and its sign."""
    problem = progress.problem
    if problem is None:
        return progress.message, "check"
    # Of a file that could not be read the message is its whole path: there would be no room for the reason.
    read = f"{Path(problem.file).name}: " if problem.kind == "error" else f"{progress.message} · "
    return read + problem.reason, problem.kind
