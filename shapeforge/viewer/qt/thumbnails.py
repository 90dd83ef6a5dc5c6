"""Pictures of shapes for Qt, one after the other while the window is idle, so that nothing waits for them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtGui import QImage, QOpenGLContext, QPixmap

from shapeforge.viewer.session import Session

KEPT = 600
"""Pictures kept in memory; the one used longest ago goes first."""
_IDLE_MS = 1


def to_pixmap(picture: np.ndarray) -> QPixmap:
    """A picture (h, w, 3 or 4) uint8 as a pixmap."""
    picture = np.ascontiguousarray(picture)
    height, width, channels = picture.shape
    kind = QImage.Format.Format_RGBA8888 if channels == 4 else QImage.Format.Format_RGB888
    return QPixmap.fromImage(QImage(picture.data, width, height, channels * width, kind).copy())


def beside_qt(take: Callable[[], np.ndarray]) -> np.ndarray:
    """Take a picture while Qt holds no GL context.

    VTK's hidden window makes a context of its own current behind Qt's back; Qt, believing that its own still is, would
    then draw the whole window into the picture (and leave the screen black).
    """
    context = QOpenGLContext.currentContext()
    surface = None if context is None else context.surface()
    if context is not None:
        context.doneCurrent()
    try:
        return take()
    finally:
        if context is not None and surface is not None:
            context.makeCurrent(surface)


class Thumbnails(QObject):
    """Takes pictures in the order they were asked for; ``arrived`` says that another one is there.

    ``pixmap(key, take)`` gives the picture at once when it is known, else None, and has ``take()`` called later.
    """

    arrived = Signal()

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._known: OrderedDict[tuple, QPixmap | None] = OrderedDict()
        self._wanted: OrderedDict[tuple, Callable[[], np.ndarray]] = OrderedDict()
        self._timer = QTimer(self)
        self._timer.setInterval(_IDLE_MS)
        self._timer.timeout.connect(self._take_one)

    def pixmap(self, key: tuple, take: Callable[[], np.ndarray]) -> QPixmap | None:
        """The picture ``key``, None while it is still to come (or could not be taken)."""
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        if key not in self._wanted:
            self._wanted[key] = take
            self._timer.start()
        return None

    def shape(
        self,
        name: str,
        size: int | tuple[int, int] = 96,
        *,
        colour: tuple[int, int, int] | None = None,
        parts: str = "",
    ) -> QPixmap | None:
        """Picture of a shape without background, in one ``colour``, or by ``parts``: "painted" or "fitted"."""
        from shapeforge.viewer.pictures import shape_picture

        session = self._session
        project, theme = session.project, session.theme
        stamp = project.label_key(name) if parts == "painted" else session.revision if parts else 0
        inks = project.part_inks() if parts else None
        look = (size, colour, parts, stamp, None if inks is None else inks.tobytes(), theme)
        key = (str(project.path), name, project.shape_record(name)["key"], *look)

        def take() -> np.ndarray:
            labels = None
            if parts:
                labels = project.labels(name) if parts == "painted" else project.face_labels(name)
            return shape_picture(project, name, size, theme, labels=labels, inks=inks, colour=colour, transparent=True)

        return self.pixmap(key, take)

    @property
    def waiting(self) -> int:
        """How many pictures are still to be taken."""
        return len(self._wanted)

    def forget(self) -> None:
        """Drop what is still to be taken (another project, another theme)."""
        self._wanted.clear()
        self._timer.stop()

    def _take_one(self) -> None:
        if not self._wanted:
            self._timer.stop()
            return
        key, take = self._wanted.popitem(last=False)
        try:
            self._known[key] = to_pixmap(beside_qt(take))
        except (ValueError, OSError, KeyError):
            self._known[key] = None  # a shape that cannot be drawn shows its outline; the list of problems says why
        while len(self._known) > KEPT:
            self._known.popitem(last=False)
        self.arrived.emit()
