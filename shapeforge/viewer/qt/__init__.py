"""The Qt window.  Import it only where there is a screen (see `shapeforge.viewer.open_window`)."""

from __future__ import annotations

import os
import sys
from collections.abc import MutableMapping
from pathlib import Path


def choose_platform(environment: MutableMapping[str, str]) -> None:
    """Let Qt talk to X11, as VTK does: under Wayland the window goes through XWayland when that is there.

    What the user has set stays.
    """
    if sys.platform.startswith("linux") and environment.get("DISPLAY"):
        environment.setdefault("QT_QPA_PLATFORM", "xcb")
        # And to GLX: with Qt on EGL in the same thread, each would draw into the other's window.
        environment.setdefault("QT_XCB_GL_INTEGRATION", "xcb_glx")
    environment.setdefault("QT_API", "pyside6")


def run(path: Path | None = None) -> int:
    """Show the window and run Qt's event loop until it is closed; returns the exit status."""
    choose_platform(os.environ)
    from PySide6.QtWidgets import QApplication

    from shapeforge.store import Project
    from shapeforge.viewer.qt.window import Window

    project = None if path is None else Project.open(path)
    application = QApplication.instance() or QApplication(sys.argv[:1])
    application.setApplicationName("shapeforge")
    application.setStyle("Fusion")
    window = Window()
    if project is not None:
        window.session.open(project)
    window.show()
    return application.exec()
