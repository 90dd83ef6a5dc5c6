"""What opening a project needs is imported while the start page is looked at, in a thread that then ends."""

from __future__ import annotations

import importlib
import threading

MODULES = (
    "shapeforge.store", "shapeforge.stages", "vtkmodules.vtkRenderingOpenGL2", "vtkmodules.vtkRenderingFreeType",
    "shapeforge.viewer.scene", "shapeforge.viewer.layout",
)  # fmt: skip
"""Nothing of Qt: its modules are the window's thread's."""


def preload() -> threading.Thread:
    """Import ``MODULES`` in a thread; whoever needs one meanwhile waits for it as for any import."""
    thread = threading.Thread(target=_import_all, name="preload", daemon=True)
    thread.start()
    return thread


def _import_all() -> None:
    for name in MODULES:
        try:
            importlib.import_module(name)
        except ImportError:  # whoever needs it says what is missing
            return
