"""The Qt window.  Import it only where there is a screen (see `shapeforge.viewer.open_window`)."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def run(path: Path | None = None) -> int:
    """Show the window and run Qt's event loop until it is closed; returns the exit status."""
    # VTK talks to X11: under Wayland the window goes through XWayland when that is there.
    if sys.platform.startswith("linux") and os.environ.get("DISPLAY"):
        os.environ.setdefault("QT_QPA_PLATFORM", "xcb")
        # And to GLX: with Qt on EGL in the same thread, each would draw into the other's window.
        os.environ.setdefault("QT_XCB_GL_INTEGRATION", "xcb_glx")
    os.environ.setdefault("QT_API", "pyside6")
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
