"""How soon does the window answer: a dab of the brush, a slider to points, preview and final mesh, a redrawn view?

    python -m benchmarks.latency [--faces 20000 200000 1000000] [--count 12] [--points 4500] [--moves 100] [--seed 0]
                                 [--only brush|fit|sliders] [--cpu] [--json]

The brush works on bumpy sheets of ``--faces`` face records ("compute": picking, the faces under the ring and their
paint; without a size in its name: 200 000 faces); the live fit view shows a generated chair, its template points and
its probable parts, all of which change from frame to frame, as they do at most once a round;
sliders on a machine learnt briefly on a generated family
with its true correspondences (their speed does not depend on how well it was learnt), whose meshes are as fine as gives
results of about 20 000 faces.  Every move puts one slider, taken at random, anywhere in its range; the others stay.
"preview frame" is what the window does from the move to the picture: points, place on the map, captions, preview mesh,
mesh and points drawn.  Pictures are 1000 x 640 pixels, off screen, one sample per pixel.  Milliseconds of wall clock
(with ``--cpu`` of the processor: on a machine that has other work), one BLAS thread: of sliders the 95th percentile
("median" where it says so), of the rest medians; "first" calls apart.
The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pyvista as pv
from threadpoolctl import threadpool_info, threadpool_limits

from benchmarks.true_family import TrueFamily, true_family
from shapeforge.collection.iterate import last
from shapeforge.collection.shape import Mesh
from shapeforge.generative.inference import infer
from shapeforge.generative.learning import learn_machine
from shapeforge.generative.observations import observe
from shapeforge.generative.units import directions, drive
from shapeforge.synthesis.assemble import SynthesizedShape, synthesize
from shapeforge.synthesis.retrieve import retrieve
from shapeforge.synthesis.sources import make_sources
from shapeforge.validation.statistics import format_table
from shapeforge.viewer import brushes
from shapeforge.viewer.display import Display, MeshLayer, PointLayer, View, face_colours
from shapeforge.viewer.fit_display import FittedPoints, TemplateLook, mesh_layer, probable_layer, three_views
from shapeforge.viewer.look import frame_of, place_camera
from shapeforge.viewer.painting import PaintState
from shapeforge.viewer.palette import label_colours, part_colours
from shapeforge.viewer.part_table import plain_table
from shapeforge.viewer.picking import Picker, project
from shapeforge.viewer.pulling import handles_of
from shapeforge.viewer.resemblance import nearest_shape, resemblance
from shapeforge.viewer.scene import Scene

clock: Callable[[], float] = time.perf_counter
WIDTH, HEIGHT = 1000, 640
BRUSH = 0.034  # diagonals, the window's own
FINE, RESULT = 10_000, 20_000
"""Least triangles of every training shape of the sliders' family, and of the shape that is moved."""


def bumpy_sheet(n_faces: int) -> Mesh:
    """A square of about ``n_faces`` triangles, one face record each, gently bent."""
    n = max(round((n_faces / 2) ** 0.5), 2)
    x, z = np.meshgrid(np.linspace(-0.35, 0.35, n + 1), np.linspace(-0.35, 0.35, n + 1), indexing="ij")
    vertices = np.stack([x, 0.05 * np.sin(9 * x) * np.cos(7 * z), z], axis=-1).reshape(-1, 3)
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (corner.reshape(-1) for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    triangles = np.stack([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)], axis=1).reshape(-1, 3)
    return Mesh(vertices, triangles, np.arange(len(triangles)), len(triangles))


def brush_times(n_faces: int) -> dict[str, float]:
    """Milliseconds of what one dab takes: picking, the faces under the ring, their paint, and the redrawn view."""
    mesh = bumpy_sheet(n_faces)
    begin = clock()
    surface = brushes.face_surface(mesh)
    prepare = 1e3 * (clock() - begin)
    state = PaintState(np.full(mesh.n_faces, -1, np.int32), plain_table(4))
    middle = mesh.n_faces // 2 + round(mesh.n_faces**0.5 / 2)
    position = surface.centres[middle]
    plotter, scene = _scene()
    first = MeshLayer("shape", mesh.vertices, mesh.triangles, face_colours(state.labels, part_colours(4)))
    scene.show(Display((View((first,)),)))
    place_camera(scene.camera, *frame_of(mesh.vertices, WIDTH / HEIGHT))
    begin = clock()
    scene.pixels()
    first_picture = 1e3 * (clock() - begin)
    picker, cell = Picker(), (0, 0, WIDTH, HEIGHT)
    place = tuple(float(p) for p in project(scene.camera, position[None], cell)[0])
    picker.pick(scene.camera, (first,), place, cell)
    parts = iter(int(p) for p in np.tile(np.arange(4), 1000))

    def dab() -> None:
        state.begin("brush", "x")
        state.paint(brushes.along(surface, middle, position, BRUSH), next(parts))
        state.end()

    def redraw() -> None:
        dab()
        colours = face_colours(state.labels, part_colours(4))[mesh.face_of_triangle]
        scene.show(Display((View((MeshLayer("shape", mesh.vertices, mesh.triangles, colours),)),)))
        scene.pixels()

    def compute() -> None:
        picker.pick(scene.camera, (first,), place, cell)
        dab()

    found = {
        "brush: compute": _median(compute, 25),
        "brush: pick": _median(lambda: picker.pick(scene.camera, (first,), place, cell), 25),
        "brush: faces under the ring": _median(lambda: brushes.along(surface, middle, position, BRUSH), 25),
        "brush: fill to creases": _median(lambda: brushes.up_to_creases(surface, middle), 5),
        "brush: dab to picture": _median(redraw, 7),
        "brush: prepare the shape (first)": prepare,
        "brush: picture (first)": first_picture,
    }
    _close(plotter, scene)
    return found


def fit_view_times(family: TrueFamily) -> dict[str, float]:
    """Milliseconds of one frame of the live fit view, and frames per second."""
    shape, positions, names = family.shapes[0], family.positions[0], tuple(family.part_names)
    there = np.isfinite(positions).all(axis=1)
    look = TemplateLook(np.asarray(family.part)[there], names, "chair", part_colours(len(names)))
    rng = np.random.default_rng(0)
    plotter, scene = _scene()
    plain, ghost = mesh_layer(shape, "#CDD0D6"), mesh_layer(shape, "#CDD0D6", 0.16, "ghost")
    active = np.ones(len(names), bool)
    rounds = [
        FittedPoints((positions[there] + rng.normal(0, 0.004, (there.sum(), 3))).astype(np.float32), 0, active)
        for _ in range(4)
    ]
    chances = [rng.dirichlet(np.ones(len(names)), shape.mesh.n_faces) for _ in range(4)]
    turn = iter(range(10**6))

    def frame() -> None:
        number = next(turn)
        parts = probable_layer(shape, chances[number % 4], part_colours(len(names)))
        scene.show(three_views(plain, ghost, look, rounds[number % 4], rounds[(number - 1) % 4], parts, "part"))
        scene.pixels()

    frame()
    place_camera(scene.camera, *frame_of(plain.vertices, WIDTH / 3 / HEIGHT))
    taken = _median(frame, 15)
    _close(plotter, scene)
    return {"live fit: one frame": taken, "live fit: frames per second": 1e3 / taken}


def fine_family(family: TrueFamily, least: int) -> TrueFamily:
    """The family with triangles quartered until every mesh has at least ``least`` of them."""
    shapes, faces = [], []
    for shape, labels in zip(family.shapes, family.faces, strict=True):
        vertices, triangles = np.asarray(shape.mesh.vertices), np.asarray(shape.mesh.triangles)
        labels = labels[shape.mesh.face_of_triangle]
        while len(triangles) < least:
            vertices, triangles = quartered(vertices, triangles)
            labels = np.repeat(labels, 4)
        mesh = Mesh(vertices, triangles, np.arange(len(triangles), dtype=np.int32), len(triangles))
        shapes.append(replace(shape, mesh=mesh))
        faces.append(labels)
    return replace(family, shapes=tuple(shapes), faces=tuple(faces))


def quartered(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle as four, by the middles of its edges."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, index = np.unique(sides, axis=0, return_inverse=True)
    ab, bc, ca = (index.reshape(-1, 3) + len(vertices)).T
    a, b, c = triangles.T
    four = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]], axis=0).transpose(2, 0, 1)
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), four.reshape(-1, 3).astype(triangles.dtype)


class Moves:
    """Random moves of sliders on the shape of a family that has about RESULT triangles, as the window makes them."""

    def __init__(self, family: TrueFamily, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        observations = observe(family.positions, family.part, family.part_names)
        self.machine = last(learn_machine(observations, rng=self.rng, epochs=2)).machine
        self.directions = directions(self.machine, observations)
        sizes = np.array([len(shape.mesh.triangles) for shape in family.shapes])
        index = int(np.abs(sizes - RESULT).argmin())
        self.base = infer(self.machine, observations.values[[index]], observations.exists[[index]])
        self.exists, self.positions = observations.exists[index], observations.positions()
        self.settings: dict[int, float] = {}

    def move(self) -> np.ndarray:
        """One slider anywhere in its range: the points."""
        index = int(self.rng.integers(len(self.directions)))
        self.settings[index] = float(self.rng.uniform(self.directions[index].low, self.directions[index].high))
        return np.asarray(drive(self.machine, self.base, self.settings, directions=self.directions), float)


def slider_times(family: TrueFamily, seed: int, n_moves: int) -> dict[str, float]:
    """Milliseconds from a slider to points, to the picture of points, to preview mesh and frame, to the final mesh."""
    sources = make_sources(
        [shape.name for shape in family.shapes], lambda t: family.shapes[t], family.faces, family.positions,
        family.part, family.part_names,
    )  # fmt: skip
    moves = Moves(family, seed)
    points, exists = moves.move(), moves.exists
    begin = clock()
    chosen = retrieve(points, exists, sources).shape
    read = 1e3 * (clock() - begin)
    for index in range(len(family.shapes)):
        for part in sources.parts_of(index).values():
            part.prepare()
    plotter, scene = _scene()
    colours = label_colours(np.asarray(family.part, np.int64), part_colours(len(family.part_names)))
    inks = part_colours(len(family.part_names))

    def dots(now: np.ndarray) -> PointLayer:
        there = np.isfinite(now).all(axis=1)
        return PointLayer("points", now[there], colours[there], 3.0)

    def show_points() -> None:
        scene.show(Display((View((dots(moves.move()),)),)))
        scene.pixels()

    def preview() -> SynthesizedShape:
        return synthesize(moves.move(), exists, sources, preview=True, shapes=chosen)

    def show_preview() -> None:
        now = moves.move()
        made = synthesize(now, exists, sources, preview=True, shapes=chosen)
        nearest_shape(moves.positions, now)
        handles_of(now)
        resemblance(moves.positions, now)
        mesh = MeshLayer("mesh", made.vertices, made.triangles, label_colours(np.asarray(made.part, np.int64), inks))
        scene.show(Display((View((mesh, dots(now)), moves=True),)))
        scene.pixels()

    def final() -> SynthesizedShape:
        return synthesize(moves.move(), exists, sources)

    show_points()
    place_camera(scene.camera, *frame_of(points[np.isfinite(points).all(axis=1)], WIDTH / HEIGHT))
    times = {
        "slider to points": _times(moves.move, n_moves),
        "slider to picture of points": _times(show_points, n_moves),
        "slider to preview mesh": _times(preview, n_moves),
        "slider to preview frame": _times(show_preview, n_moves),
        "slider to final mesh": _times(final, n_moves),
    }
    result = {what: float(np.percentile(taken, 95)) for what, taken in times.items()}
    result |= {f"{what}, median": float(np.median(taken)) for what, taken in times.items()}
    result["faces of a result"] = float(np.median([len(final().triangles) for _ in range(7)]))
    result["a shape's parts read and made ready (first)"] = read / max(len(set(chosen[chosen >= 0].tolist())), 1)
    _close(plotter, scene)
    return result


def _scene() -> tuple[pv.Plotter, Scene]:
    plotter = pv.Plotter(off_screen=True, window_size=(WIDTH, HEIGHT))
    plotter.ren_win.SetMultiSamples(0)
    return plotter, Scene(plotter, lambda: None)


def _close(plotter: pv.Plotter, scene: Scene) -> None:
    scene.clear()
    plotter.close()


def _times(action: Callable[[], object], times: int) -> list[float]:
    """Milliseconds of so many calls, after one that is not counted."""
    action()
    taken = []
    for _ in range(times):
        begin = clock()
        action()
        taken.append(1e3 * (clock() - begin))
    return taken


def _median(action: Callable[[], object], times: int) -> float:
    return float(np.median(_times(action, times)))


def run(n_faces: list[int], count: int, n_points: int, n_moves: int, seed: int, only: str | None = None) -> dict:
    """All of it, or ``only`` one of its three pieces, on one BLAS thread."""
    with threadpool_limits(1, "blas"):
        milliseconds = {}
        for n in n_faces if only in (None, "brush") else ():  # the size that targets are stated for has the plain names
            size = "" if n == 200_000 else f"{n} faces, "
            milliseconds |= {f"{size}{what}": taken for what, taken in brush_times(n).items()}
        if only in (None, "fit"):
            milliseconds |= fit_view_times(true_family("chairs", count, seed=seed))
        if only in (None, "sliders"):
            family = true_family("chairs", count, seed=seed, n_points=n_points)
            milliseconds |= slider_times(fine_family(family, FINE), seed, n_moves)
        blas = [
            f"{lib.get('internal_api')} {lib.get('architecture', '')} x{lib.get('num_threads')}"
            for lib in threadpool_info()
            if lib.get("user_api") == "blas"
        ]
    return {
        "faces": n_faces, "shapes": count, "points": n_points, "moves": n_moves, "clock": clock.__name__,
        "milliseconds": milliseconds, "blas": blas,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--faces", type=int, nargs="*", default=[20_000, 200_000, 1_000_000])
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--points", type=int, default=4500)
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--only", choices=("brush", "fit", "sliders"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    parser.add_argument("--cpu", action="store_true", help="time of the processor instead of wall clock")
    options = parser.parse_args()
    if options.cpu:
        globals()["clock"] = time.process_time
    result = run(options.faces, options.count, options.points, options.moves, options.seed, options.only)
    if not options.json:
        print(f"{result['faces']} faces, {result['shapes']} shapes of {result['points']} points, {result['blas']}")
        print(format_table(["what", "ms"], [[name, value] for name, value in result["milliseconds"].items()]))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
