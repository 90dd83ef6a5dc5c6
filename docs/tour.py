"""Pictures of the window, made by using it: ``python docs/tour.py`` (without a screen: ``xvfb-run`` is called for you).

A family of chairs is generated and taken through all stages in a temporary folder, or in ``--project DIR``, which is
used again when it is there.  Then the real window is opened on it, and every place is used with mouse and keys before
its picture is taken from the screen.  ``--all`` adds what `docs/tour.md` does not show: empty, busy and failed states.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tour_hands import LARGE, SMALL, Hands

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
SHAPES, POINTS = 20, 1500
IN_DOCS = (
    "collection-dark", "paint-dark", "fit-dark", "correspondence-dark", "synthesize-dark",
    "collection-light", "fit-light", "correspondence-light", "synthesize-light", "correspondence-large",
    "preview-dark", "refit-dark", "pins-dark", "gallery-dark", "surface-dark",
)  # fmt: skip

STATES = (
    "start", "preview", "reading", "problems", "unpainted", "busy", "refit", "random", "pins", "gallery", "surface",
    "grid", "landmarks", "unsure", "stale", "failed", "large", "turning",
)  # fmt: skip
"""Other states than the places after a full run; ``--all`` makes all of their pictures."""
NEW = ("preview", "problems", "unpainted")
"""Those that are seen in a project that has just been imported."""


def make_project(folder: Path) -> Path:
    """A generated family, imported, grouped, its exemplars labelled, fitted and learned: the project's folder."""
    from shapeforge.collection.families import write_family
    from shapeforge.collection.iterate import last
    from shapeforge.stages import run
    from shapeforge.store import Project

    truth, place = folder / "meshes", folder / "chairs"
    if (folder / "made").is_file():
        return place
    write_family(truth, "chairs", SHAPES, seed=7, classes=["side", "armchair", "stool", "bench"], broken=0.0)
    project = Project.create(place)
    options: dict[str, dict[str, Any]] = {
        "import": {"meshes": [truth], "points": POINTS, "up": "keep", "seed": 0}, "group": {"seed": 0},
        "label": {"labels": truth, "only": "exemplars"}, "fit": {"rounds": 8, "seed": 0}, "learn": {"seed": 0},
    }  # fmt: skip
    for stage, chosen in options.items():
        print(f"{stage}…", flush=True)
        last(run(project, stage, jobs=1, **chosen))
    (folder / "made").write_text("")
    return place


def make_fresh(folder: Path) -> Path:
    """A few shapes imported and grouped, one in millimetres, two that cannot be read; nothing painted."""
    from shapeforge.collection.families import write_family
    from shapeforge.collection.iterate import last
    from shapeforge.stages import run
    from shapeforge.store import Project

    files, place = folder / "files", folder / "new chairs"
    write_family(files, "chairs", 8, seed=3)
    (files / "empty.obj").write_text("v 0 0 0\n")
    _scaled(files / "chair_0000.obj", files / "armchair_mm.obj", 1000.0)
    (files / "notes.obj").write_text("This is no mesh.\n")
    project = Project.create(place)
    last(run(project, "import", meshes=[files], points=400, jobs=1))
    last(run(project, "group", jobs=1))
    return place


def _scaled(path: Path, other: Path, times: float) -> None:
    """Write a mesh in another unit."""
    lines = [line.split() for line in path.read_text().splitlines()]
    moved = [[w[0], *(f"{times * float(x):g}" for x in w[1:4])] if w[:1] == ["v"] else w for w in lines]
    other.write_text("\n".join(" ".join(words) for words in moved) + "\n")


class Tour(Hands):
    """The places of the window, each used before its picture is taken."""

    def __init__(self, out: Path, scratch: Path, everything: bool) -> None:
        super().__init__(out, scratch)
        self.everything = everything

    def wanted(self, name: str) -> bool:
        """Whether this run makes the picture ``name``."""
        return self.everything or name in IN_DOCS

    # -- places ----------------------------------------------------------------------------------------------------

    def collection(self) -> None:
        """The map with all its pictures, one shape selected."""
        place = self.go("collection")
        self.pause(0.5)
        names = self.window.session.project.names
        self.click(place.map, place.map.at(len(names) // 2).toTuple())
        self.hover(place.map, (2, 2))
        self.wait(lambda: place.pictures.waiting == 0, "the pictures of the map")
        self.pause(0.6)

    def paint(self) -> None:
        """The first exemplar: a part of its back is erased, one stroke paints some of it again, the pointer rests."""
        project = self.window.session.project
        self.window.session.shape = project.names[int(project.groups.exemplars[0])]
        place = self.go("paint")
        self.settled(place.view)
        view, painter = place.view, place.painter
        names = list(project.part_names.names)
        back = painter.surface.centres[painter.state.labels == names.index("back")]
        low, high = back.min(axis=0), back.max(axis=0)
        across = [low + (high - low) * (x, 0.9, 0.7) for x in (0.1, 0.3, 0.5, 0.7, 0.9)]
        stroke = [view.place_of(point) for point in across]
        self.key("E")
        self.drag(view.plotter, stroke)
        self.key("B")
        self.key(str(names.index("back") + 1))
        self.drag(view.plotter, stroke[:3])
        self.settled(view)
        self.hover(view.plotter, stroke[2])

    def fit(self) -> None:
        """A finished fit."""
        place = self.go("fit")
        self.pause(0.3)
        self.settled(place.view)

    def correspondence(self) -> None:
        """One click on the first shape lights a point up on all, a second one measures."""
        place = self.go("correspondence")
        self.settled(place.view)
        for direction in ((-0.6, 1.0, 0.0), (0.6, -0.1, 1.0)):
            self.click(place.view.plotter, self.seen(place, direction))
        if self.window.session.picked is None or place.second is None:
            raise RuntimeError("the clicks on the first shape picked nothing")
        self.settled(place.view)

    def seen(self, place: Any, direction: tuple[float, float, float]) -> tuple[float, float]:
        """Where in the first cell the outermost visible template point in a direction is seen."""
        positions = place.box.shape(place.names[0]).positions
        for point in (-positions @ direction).argsort():
            at = place.view.place_of(positions[point], 0)
            hit = place.view.pick(*at)
            if hit is not None and abs(hit.position - positions[point]).max() < 0.02:
                return at
        raise RuntimeError(f"nothing of {place.names[0]} is seen")

    def synthesize(self) -> None:
        """A shape between two of the family, its first slider pulled to the right."""
        place = self.go("synthesize")
        self.meshed(place)
        self.key("B")
        self.meshed(place)
        slider = place.inspector.rows[0].slider
        middle, y = slider.width() / 2, slider.height() - 8
        self.drag(slider, [(slider.x_of(slider.value), y), (middle + 20, y), (middle + 40, y)])
        self.meshed(place)

    def meshed(self, place: Any) -> None:
        """Wait until the shape in hand has its mesh, and its picture in the history."""
        self.pause(0.2)
        self.wait(lambda: place.made is not None and not place.made.preview, "a mesh")
        self.settled(place.view)
        self.wait(lambda: place.thumbnails.waiting == 0, "the pictures of the history")

    # -- other states ----------------------------------------------------------------------------------------------

    def others(self, project: Path, only: str) -> None:
        """Empty, busy and failed states, and what places show besides."""
        wanted = [
            (state, theme, name) for theme in ("dark", "light") for state in STATES
            if self.wanted(name := f"{state}-{theme}") and only in name
        ]  # fmt: skip
        fresh = make_fresh(self.scratch / "fresh") if any(state in NEW for state, *_ in wanted) else project
        for state, theme, name in wanted:
            getattr(self, state)(fresh if state in NEW else project, theme)
            self.picture(name)

    def start(self, _project: Path, theme: str) -> None:
        """No project yet."""
        self.open(None, theme, SMALL)

    def preview(self, project: Path, theme: str) -> None:
        """What is in the files, before they are imported: two cannot be read."""
        self.open(project, theme, SMALL)
        self.window.actions_table.offer_import((project.parent / "files",))
        dialog = self.window.import_dialog
        self.wait(lambda: dialog.done_reading, "the files")
        self.pause(0.3)
        self.wait(lambda: dialog.pictures.waiting == 0, "the pictures of the files")

    def reading(self, project: Path, theme: str) -> None:
        """A first import, held after the third file."""
        from shapeforge.store import Project

        self.open(None, theme, SMALL)
        session = self.window.session
        session.open(Project.create(self.scratch / f"reading-{theme}" / "chairs"))
        self.window.actions_table.import_shapes((project.parent / "meshes",))
        self.wait(lambda: session.progress is not None and session.progress.step >= 3, "the third file")
        self.window.control("pause")

    def problems(self, project: Path, theme: str) -> None:
        """Files that were not read are named."""
        self.open(project, theme, SMALL)
        self.collection()

    def unpainted(self, project: Path, theme: str) -> None:
        """Paint, before the first part."""
        self.open(project, theme, SMALL)
        self.click(self.window.places["collection"].strip.next)
        self.settled(self.window.places["paint"].view)

    def busy(self, project: Path, theme: str) -> None:
        """A fit paused in its second round, seen as a grid."""
        self.open(project, theme, SMALL)
        place = self.go("fit")
        for number in (0, 1):
            self.click(place.step)
            self.wait(lambda n=number: place.record.newest == n and self.window.runner.paused, "a round")
        self.pause(0.3)
        self.settled(place.view)

    def refit(self, project: Path, theme: str) -> None:
        """A shape was corrected since the fit: it can be taken up again from where it is."""
        self.open(project, theme, SMALL)
        session = self.window.session
        family, exemplars = session.project, {int(t) for t in session.project.groups.exemplars}
        session.shape = name = next(name for t, name in enumerate(family.names) if t not in exemplars)
        family.set_labels(name, family.face_labels(name))
        session.touch("labels")
        self.fit()

    def random(self, project: Path, theme: str) -> None:
        """A shape drawn from what was learned."""
        self.open(project, theme, SMALL)
        place = self.go("synthesize")
        self.meshed(place)
        self.key("R")
        self.meshed(place)
        self.key("R")
        self.meshed(place)

    def pins(self, project: Path, theme: str) -> None:
        """Two handles pulled one after the other: both points are held, and the pointer is at the second."""
        self.open(project, theme, SMALL)
        place = self.go("synthesize")
        self.meshed(place)
        for across, up in ((-35, -15), (40, 10)):
            free = [i for i, point in enumerate(place.handles.shown) if int(point) not in place.session.pins]
            x, y = place.view.place_of(place.handles.places[free[0]])
            self.drag(place.view.plotter, [(x, y), (x + across / 2, y + up / 2), (x + across, y + up)])
            self.meshed(place)
        row = list(place.handles.shown).index(list(place.session.pins)[-1])
        self.hover(place.view.plotter, place.view.place_of(place.handles.places[row]))

    def gallery(self, project: Path, theme: str) -> None:
        """A dozen draws, all of them meshes."""
        self.open(project, theme, SMALL)
        place = self.go("synthesize")
        self.meshed(place)
        self.key("G")
        gallery = place.shows.gallery
        self.wait(lambda: len(gallery.made) == len(gallery.cards), "the meshes of the gallery")
        self.pause(0.3)
        self.wait(lambda: place.thumbnails.waiting == 0, "the pictures of the gallery")

    def surface(self, project: Path, theme: str) -> None:
        """A shape of the family as a new closed surface around its points."""
        self.open(project, theme, SMALL)
        place = self.go("synthesize")
        self.meshed(place)
        self.key("B")
        self.meshed(place)
        made = place.inspector.mesh
        place.inspector._sections.ensureWidgetVisible(made)
        self.click(made.route.button("surface"))
        self.meshed(place)

    def grid(self, project: Path, theme: str) -> None:
        """The collection in rows; the fit as a grid is the same kind of picture."""
        self.open(project, theme, SMALL)
        self.click(self.window.places["collection"].mode.button("grid"))
        self.collection()

    def large(self, project: Path, theme: str) -> None:
        """Five shapes side by side."""
        self.open(project, theme, SMALL)
        self.window.session.selected = self.window.session.project.names[:5]
        self.key("3")
        self.settled(self.window.places["collection"].large.view)

    def turning(self, project: Path, theme: str) -> None:
        """A shape that lies on its back, with the rings that turn it; the exemplar beside it."""
        self.open(project, theme, SMALL)
        session = self.window.session
        exemplars = session.project.groups.exemplars
        session.shape = next(name for t, name in enumerate(session.project.names) if t not in exemplars)
        self.key("O")
        self.window.actions_table.run("turn_x")
        self.settled(self.window.places["collection"].large.view)

    def landmarks(self, project: Path, theme: str) -> None:
        """Two landmarks kept, two shapes laid over each other."""
        self.open(project, theme, SMALL)
        self.correspondence()
        self.key("K")
        place = self.window.places["correspondence"]
        for cell in (0, 2):
            shape = place.box.shape(place.names[cell])
            middle = shape.vertices[abs(shape.vertices[:, 0]).argmin()]
            self.click(place.view.plotter, place.view.place_of(middle, cell), control=True)
        self.key("O")
        self.settled(place.view)

    def unsure(self, project: Path, theme: str) -> None:
        """Colours by the entropy of the correspondence, the least sure shapes first, on a large screen."""
        self.open(project, theme, LARGE)
        place = self.go("correspondence")
        self.key("W")
        place.colour._choose("entropy")
        self.settled(place.view)

    def stale(self, project: Path, theme: str) -> None:
        """The fit is out of date: what is shown is the old one."""
        self.open(project, theme, SMALL)
        self._unpaint()
        place = self.go("correspondence")
        self.settled(place.view)

    def failed(self, project: Path, theme: str) -> None:
        """Out of date, seen as a grid on a large screen; a fit that could not be started says why."""
        self.open(project, theme, LARGE)
        self._unpaint()
        place = self.go("fit")
        self.click(place.mode.button("grid"))
        self.window.session.say("No space left on device. Free some, then run it again.", "error")
        self.pause(0.3)
        self.settled(place.view)

    def _unpaint(self) -> None:
        project = self.window.session.project
        labels = project.labels(project.labelled[0]).copy()
        labels[:3] = -1
        project.set_labels(project.labelled[0], labels)
        self.window.session.touch("labels")


def main() -> int:
    """Make the pictures; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=HERE / "tour", help="folder of the pictures")
    parser.add_argument("--project", type=Path, help="folder in which the family is kept for the next time")
    parser.add_argument("--only", default="", help="only pictures whose name contains this")
    parser.add_argument("--all", action="store_true", help="also pictures that docs/tour.md does not show")
    given = parser.parse_args()
    if not os.environ.get("SHAPEFORGE_TOUR") and shutil.which("xvfb-run"):
        screen = f"-screen 0 {LARGE[0]}x{LARGE[1]}x24"
        command = ["xvfb-run", "-a", "-s", screen, sys.executable, *sys.argv]
        return subprocess.run(command, env={**os.environ, "SHAPEFORGE_TOUR": "1"}).returncode
    os.environ.setdefault("QT_QPA_PLATFORM", "xcb")
    os.environ.setdefault("QT_API", "pyside6")
    scratch = Path(tempfile.mkdtemp(prefix="shapeforge-tour-"))
    os.environ["SHAPEFORGE_CONFIG"] = str(scratch / "settings")  # the user's list of projects is none of its business
    try:
        project = make_project((given.project or scratch).absolute())
        tour = Tour(given.out, scratch, given.all)
        for theme in ("dark", "light"):
            for place in ("collection", "paint", "fit", "correspondence", "synthesize"):
                name = f"{place}-{theme}"
                if tour.wanted(name) and given.only in name:
                    tour.open(project, theme, SMALL)
                    getattr(tour, place)()
                    tour.picture(name)
        if tour.wanted("correspondence-large") and given.only in "correspondence-large":
            tour.open(project, "dark", LARGE)
            tour.correspondence()
            tour.picture("correspondence-large")
        tour.others(project, given.only)
        tour.close()
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
