"""The window, the notebook and the report: everything that shows a project.  It knows the rooms, none knows it.

Importing this package loads neither Qt nor VTK; `open_window` does.
"""

from __future__ import annotations

import ctypes.util
import os
import sys
from pathlib import Path

_PACKAGES = "sudo apt install libegl1 libgl1 libgl1-mesa-dri libxkbcommon-x11-0 libxcb-cursor0"


def missing_graphics() -> str:
    """What keeps a window from opening on this machine, with the remedy; "" when nothing does.

    Looked for before VTK is loaded, because VTK ends the process when the libraries are missing.
    """
    if not sys.platform.startswith("linux"):
        return ""
    absent = [name for name in ("EGL", "GL") if ctypes.util.find_library(name) is None]
    if absent:
        return f"The graphics library lib{absent[0]} is missing. On Debian or Ubuntu: {_PACKAGES}"
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return "There is no screen (DISPLAY is not set). Use `shapeforge report` for pictures, or run under xvfb-run."
    return ""


def open_window(path: str | Path | None = None) -> int:
    """Open the window, on the project in ``path`` when given, and stay until it is closed; returns the exit status.

    Raises RuntimeError, saying what to install, when the machine has no screen or no graphics libraries.
    """
    problem = missing_graphics()
    if problem:
        raise RuntimeError(problem)
    from shapeforge.viewer.qt import run

    return run(None if path is None else Path(path))
