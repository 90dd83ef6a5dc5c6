"""Hands on the real window, for the pictures of the tour: keys, clicks, drags, and the picture of what is seen then."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

SMALL, LARGE = (1280, 800), (2560, 1440)
LONGEST = 120.0
"""Seconds that anything in the window may take."""


class Hands:
    """A window in hand: keys, clicks, and pictures in the folder ``out``; projects are copied to ``scratch``."""

    def __init__(self, out: Path, scratch: Path) -> None:
        from PySide6.QtWidgets import QApplication

        self.out, self.scratch, self.count = out, scratch, 0
        self.application = QApplication.instance() or QApplication(sys.argv[:1])
        self.application.setStyle("Fusion")
        self.window: Any = None

    def open(self, project: Path | None, theme: str, size: tuple[int, int], place: str = "collection") -> Any:
        """A window on a project; what was open is closed."""
        from shapeforge.store import Project
        from shapeforge.viewer.qt.window import Window

        self.close()
        self.window = Window()
        self.window.move(0, 0)
        self.window.resize(*size)
        if project is not None:
            copy = self.scratch / f"{self.count}" / "chairs"
            self.count += 1
            shutil.copytree(project, copy)
            self.window.session.open(Project.open(copy))
        self.window.session.theme = theme
        self.window.show()
        self.window.activateWindow()
        self.wait(lambda: self.window.isActiveWindow())
        self.go(place)
        return self.window

    def close(self) -> None:
        """Close the window, if one is open."""
        if self.window is not None:
            self.window.close()
            self.window.deleteLater()
            self.window = None
            self.pause(0.1)

    def go(self, place: str) -> Any:
        """Click a place in the rail; what comes back is the place."""
        if self.window.session.project is None:
            return None
        if self.window.session.place != place:
            self.click(self.window.rail.places[place])
        if self.window.session.place != place:
            raise RuntimeError(f"the rail did not go to {place}: {self.window.session.status}")
        return self.window.places[place]

    def pause(self, seconds: float) -> None:
        """Let the window work."""
        from PySide6.QtCore import QEvent

        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.application.processEvents()
            self.application.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
            time.sleep(0.005)

    def wait(self, until: Callable[[], bool], what: str = "") -> None:
        """Let the window work until something is so."""
        end = time.monotonic() + LONGEST
        while not until():
            if time.monotonic() > end:
                raise TimeoutError(f"{what or until} did not come about in {LONGEST:.0f} s")
            self.pause(0.02)

    def click(self, widget: Any, at: tuple[float, float] | None = None, *, control: bool = False) -> None:
        """A real click, in the middle of a widget or at a place of it."""
        from PySide6.QtCore import QPoint, Qt
        from PySide6.QtTest import QTest

        keys = Qt.KeyboardModifier.ControlModifier if control else Qt.KeyboardModifier.NoModifier
        place = widget.rect().center() if at is None else QPoint(round(at[0]), round(at[1]))
        QTest.mouseMove(widget, place)
        QTest.mouseClick(widget, Qt.MouseButton.LeftButton, keys, place)
        self.pause(0.1)

    def drag(self, widget: Any, places: list[tuple[float, float]], *, let_go: bool = True) -> None:
        """A real drag of the left button through places of a widget."""
        from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
        from PySide6.QtGui import QMouseEvent
        from PySide6.QtTest import QTest

        left, none = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
        points = [QPoint(round(x), round(y)) for x, y in places]
        QTest.mousePress(widget, left, none, points[0])
        for point in points[1:]:  # QTest's own move forgets the button
            there = QPointF(widget.mapToGlobal(point))
            event = QMouseEvent(QEvent.Type.MouseMove, QPointF(point), there, Qt.MouseButton.NoButton, left, none)
            self.application.sendEvent(widget, event)
            self.pause(0.03)
        if let_go:
            QTest.mouseRelease(widget, left, none, points[-1])

    def hover(self, widget: Any, at: tuple[float, float]) -> None:
        """Rest the pointer at a place of a widget."""
        from PySide6.QtCore import QEvent, QPointF, Qt
        from PySide6.QtGui import QMouseEvent

        none, here = Qt.MouseButton.NoButton, QPointF(*at)
        there = QPointF(widget.mapToGlobal(here.toPoint()))
        no_key = Qt.KeyboardModifier.NoModifier
        self.application.sendEvent(widget, QMouseEvent(QEvent.Type.MouseMove, here, there, none, none, no_key))
        self.pause(0.1)

    def key(self, key: str) -> None:
        """Press a key, in the centre of the present place."""
        from PySide6.QtTest import QTest

        QTest.keyClick(self.window.places[self.window.session.place].centre, key)
        self.pause(0.1)

    def settled(self, view: Any) -> None:
        """Wait until a view has drawn itself with smooth edges."""
        self.wait(lambda: view.at_rest, "a view at rest")
        self.pause(0.4)
        self.wait(lambda: view.at_rest, "a view at rest")
        self.pause(0.3)

    def picture(self, name: str) -> None:
        """Take the window from the screen and save it as a small PNG."""
        from PIL import Image
        from PySide6.QtGui import QImage

        self.pause(0.3)
        window = self.window  # what stands before it is in the picture, too
        shot = window.windowHandle().screen().grabWindow(0, *window.geometry().getRect()).toImage()
        shot = shot.convertToFormat(QImage.Format.Format_RGB888)
        image = Image.frombytes(
            "RGB", (shot.width(), shot.height()), bytes(shot.constBits()), "raw", "RGB", shot.bytesPerLine()
        )
        self.out.mkdir(parents=True, exist_ok=True)
        file = self.out / f"{name}.png"
        in_few_colours(image, 256 if image.width <= SMALL[0] else 80).save(file, optimize=True)
        print(f"{file} {file.stat().st_size // 1024} kB", flush=True)


def in_few_colours(image: Any, colours: int) -> Any:
    """The picture with a palette: rare colours (marks, dots) count more than their area says."""
    import numpy as np
    from PIL import Image
    from scipy.spatial import cKDTree
    from sklearn.cluster import MiniBatchKMeans

    pixels = np.asarray(image).reshape(-1, 3)
    seen, which, count = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
    centres = seen
    if len(seen) > colours:
        means = MiniBatchKMeans(colours, n_init=1, batch_size=4096, random_state=0)
        # The square root tells dark greys apart: the shadow on the floor has no steps.
        centres = means.fit(np.sqrt(seen / 255), sample_weight=count**0.4).cluster_centers_ ** 2 * 255
    palette = np.round(centres).astype(np.uint8)
    index = cKDTree(palette).query(seen)[1].astype(np.uint8)[which.ravel()]
    result = Image.fromarray(index.reshape(image.height, image.width), "P")
    result.putpalette(palette.ravel().tolist())
    return result
