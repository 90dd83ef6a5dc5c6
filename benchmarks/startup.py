"""How soon is the window there, and how soon does a project show its first picture?

    python -m benchmarks.startup [--shapes 50 1000] [--repeats 3] [--json]

Each start is a process of its own, on the screen or a virtual one.  "Window" is the time from the start of Python to
the first frame of the empty window; the first start of all is called cold (its files may be in the operating system's
cache: this program cannot empty it), the median of the others warm; "ready to open" is when what opening needs has
been imported behind the start page.  Projects are copies of a few generated chairs, grouped; "opened" is the time from
the click on the project to the Collection place on the screen, "first picture" to the first shape drawn in it, "all on
the screen" to the last one seen.  Seconds of wall clock, and of this process's CPU.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SEEDS = 8
"""Generated shapes that a project's are copies of."""
POINTS = 1500


def make_project(folder: Path, count: int) -> Path:
    """A grouped project of ``count`` shapes (copies of a few) in ``folder``; nothing is fitted."""
    from shapeforge.collection.families import write_family
    from shapeforge.collection.groups import Groups
    from shapeforge.collection.iterate import last
    from shapeforge.stages import run
    from shapeforge.store import Project

    write_family(folder / "meshes", "chairs", SEEDS, seed=3, broken=0.0)
    project = Project.create(folder / "chairs")
    last(run(project, "import", meshes=[folder / "meshes"], points=POINTS, up="keep", jobs=1))
    names = project.names
    records = {}
    for number in range(count):
        source, name = names[number % len(names)], f"copy_{number:04d}"
        record = dict(project.shape_record(source))
        mesh = project.mesh_path(source)
        record["file"] = f"meshes/{name}{mesh.suffix}"
        shutil.copyfile(mesh, project.path / record["file"])
        shutil.copyfile(project.shape_path(source), project.shape_path(name))
        records[name] = record
    project.remove_shapes(names)
    project.add_shapes(records)
    rng = np.random.default_rng(0)
    groups = (np.arange(count) * 3 // max(count, 1)).astype(np.int32)
    exemplars = np.array([int(np.flatnonzero(groups == g)[0]) for g in range(3)])
    embedding = rng.normal(0, 0.3, (count, 2)) + np.stack([groups, groups % 2], axis=1)
    project.set_groups(Groups(("A", "B", "C"), groups, exemplars, embedding.astype(np.float32)))
    return project.path


def child(project: str) -> dict[str, float]:
    """In a process of its own: show the window, open ``project`` (unless ""), and say when what was there."""
    begin = float(os.environ["SHAPEFORGE_BEGIN"])
    found: dict[str, float] = {}

    def say(what: str, since: float) -> None:
        found[what] = time.time() - since

    from PySide6.QtWidgets import QApplication

    application = QApplication.instance() or QApplication(sys.argv[:1])
    application.setStyle("Fusion")
    from shapeforge.viewer.qt.window import Window

    say("imported", begin)
    window = Window()
    window.resize(1440, 900)
    window.show()
    until(application, lambda: window.isVisible() and window.windowHandle().isExposed())
    window.repaint()
    application.processEvents()
    say("window", begin)
    if project:
        window._preload.join()  # a person needs longer to choose a project
        say("ready to open", begin)
        since, cpu = time.time(), time.process_time()
        window.actions_table.open_project(Path(project))
        application.processEvents()
        window.repaint()
        say("opened", since)
        place = window.places["collection"]
        until(application, lambda: bool(place.pictures._known) or place.pictures.waiting == 0)
        window.repaint()
        say("first picture", since)
        until(application, lambda: place.pictures.waiting == 0, 120)
        say("all on the screen", since)
        found["CPU to all on the screen"] = time.process_time() - cpu
    window.close()
    return found


def until(application: Any, true: Any, seconds: float = 60.0) -> None:
    """Let Qt work until something is so."""
    end = time.time() + seconds
    while not true():
        application.processEvents()
        if time.time() > end:
            raise TimeoutError("the window did not come to rest")


def start(project: Path | None) -> dict[str, float]:
    """Start a process and read what it says."""
    environment = {**os.environ, "SHAPEFORGE_BEGIN": repr(time.time()), "QT_API": "pyside6"}
    environment.setdefault("QT_QPA_PLATFORM", "xcb")
    command = [sys.executable, "-m", "benchmarks.startup", "--child", str(project or "")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(done.stdout.strip().splitlines()[-1])


def run(counts: list[int], repeats: int) -> dict[str, Any]:
    """All starts; seconds."""
    starts = [start(None) for _ in range(repeats + 1)]
    warm = {key: float(np.median([one[key] for one in starts[1:]])) for key in starts[0]}
    result: dict[str, Any] = {"cold": starts[0], "warm": warm, "projects": {}}
    with tempfile.TemporaryDirectory(prefix="shapeforge-startup-") as scratch:
        for count in counts:
            project = make_project(Path(scratch) / str(count), count)
            found = [start(project) for _ in range(repeats)]
            keys = [key for key in found[0] if key not in ("imported", "window")]
            result["projects"][str(count)] = {key: float(np.median([one[key] for one in found])) for key in keys}
    return result


def main() -> int:
    """Print a table and, last, one JSON object; the exit status."""
    from shapeforge.validation.statistics import format_table

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", type=int, nargs="*", default=[50, 1000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true", help="only the last line")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child is not None:
        print(json.dumps(child(options.child)))
        return 0
    if not os.environ.get("DISPLAY") and not os.environ.get("SHAPEFORGE_SCREEN") and shutil.which("xvfb-run"):
        command = ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24", sys.executable, "-m", "benchmarks.startup"]
        environment = {**os.environ, "SHAPEFORGE_SCREEN": "1"}
        return subprocess.run([*command, *sys.argv[1:]], env=environment).returncode
    result = run(options.shapes, options.repeats)
    if not options.json:
        rows = [[f"first start: {key}", value] for key, value in result["cold"].items()]
        rows += [[f"later starts: {key}", value] for key, value in result["warm"].items()]
        for count, found in result["projects"].items():
            rows += [[f"{count} shapes: {key}", value] for key, value in found.items()]
        print(format_table(["what", "seconds"], rows))
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
