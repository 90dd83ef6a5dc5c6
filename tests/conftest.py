"""Shape and type checks for every module of shapeforge, and the real shapes where they are at hand."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# before Qt is imported anywhere: real widgets on a real (virtual) screen
os.environ.setdefault("QT_QPA_PLATFORM", "xcb")

settings.register_profile("shapeforge", deadline=None)  # a busy machine is no falsifying example
settings.load_profile("shapeforge")

REPOSITORY = Path(__file__).resolve().parent.parent


def checked_modules() -> list[str]:
    """Full names of all modules but packages, whose names are prefixes of the compiled modules', which checks break."""
    files = sorted((REPOSITORY / "shapeforge").rglob("*.py"))
    return [
        ".".join(file.relative_to(REPOSITORY).with_suffix("").parts)
        for file in files
        if file.stem != "__init__" and not file.stem.startswith("_kernels")
    ]


_hook = install_import_hook(checked_modules(), "beartype.beartype")


@pytest.fixture(scope="session")
def real_shapes() -> Path:
    """Folder of real shapes for development ($SHAPEFORGE_DATA, else ``../shared/data``); skips where there is none."""
    named = os.environ.get("SHAPEFORGE_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real shapes are not here: {folder} does not exist (set SHAPEFORGE_DATA)")
    return folder


def pytest_sessionfinish() -> None:
    """Close the window system's connection while its server lives: pytest-xvfb stops the server before Python exits,
    and Xlib ends a process whose server went away, with status 1, whatever the tests said."""
    pictures = sys.modules.get("shapeforge.viewer.pictures")
    if pictures is not None:
        pictures.close_studio()
    plotters = sys.modules.get("pyvista")
    if plotters is not None:
        plotters.close_all()
    widgets = sys.modules.get("PySide6.QtWidgets")
    application = widgets.QApplication.instance() if widgets is not None else None
    if application is not None:
        application.shutdown()
    gc.collect()
