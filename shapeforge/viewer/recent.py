"""The projects opened last, newest first, remembered from one start of the program to the next."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from shapeforge.store_arrays import ProjectError, write_text

KEPT = 8


def settings_folder() -> Path:
    """Where the program keeps what it remembers: ``$SHAPEFORGE_CONFIG``, else the platform's usual place."""
    if os.environ.get("SHAPEFORGE_CONFIG"):
        return Path(os.environ["SHAPEFORGE_CONFIG"])
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA", Path.home())) / "shapeforge"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "shapeforge"
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "shapeforge"


def recent_projects() -> tuple[Path, ...]:
    """Folders of projects that are still there, newest first; nothing when the list cannot be read."""
    try:
        listed = json.loads((settings_folder() / "recent.json").read_text("utf-8"))
        paths = [Path(one) for one in listed if isinstance(one, str)]
        return tuple(path for path in paths if (path / "project.json").is_file())
    except (OSError, ValueError, TypeError):
        return ()


def remember(path: Path) -> None:
    """Put a project at the head of the list; where that cannot be written, it is just not remembered."""
    path = Path(path).resolve()
    listed = [path, *(other for other in recent_projects() if other != path)][:KEPT]
    try:
        settings_folder().mkdir(parents=True, exist_ok=True)
        write_text(settings_folder() / "recent.json", json.dumps([str(one) for one in listed], indent=1))
    except (OSError, ProjectError):
        return
