"""How soon does the window answer: a dab of the brush, a slider to points, preview and final mesh, a redrawn view?

    python -m benchmarks.latency [--faces 20000 200000 1000000] [--count 12] [--points 1500] [--seed 0] [--json]

The brush works on bumpy sheets of ``--faces`` face records ("compute": picking, the faces under the ring and their
paint; without a size in its name: 200 000 faces); the live fit view shows a generated chair, its template points and
its probable parts, all of which change from frame to frame, as they do at most once a round;
sliders on a machine learnt briefly on a generated family
with its true correspondences (their speed does not depend on how well it was learnt).  Pictures are 1000 x 640 pixels,
off screen, one sample per pixel.  Medians in milliseconds of wall clock, one BLAS thread; "first" calls apart.
The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import pyvista as pv
from threadpoolctl import threadpool_info, threadpool_limits

from benchmarks.synthesis_quality import TrueFamily, true_family
from shapeforge.collection.iterate import last
from shapeforge.collection.shape import Mesh
from shapeforge.generative.draw import fit_mixture
from shapeforge.generative.inference import infer
from shapeforge.generative.learning import learn_machine
from shapeforge.generative.observations import observe
from shapeforge.generative.units import directions, drive
from shapeforge.synthesis.assemble import synthesize
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
from shapeforge.viewer.scene import Scene

WIDTH, HEIGHT = 1000, 640
BRUSH = 0.034  # diagonals, the window's own


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
    begin = time.perf_counter()
    surface = brushes.face_surface(mesh)
    prepare = 1e3 * (time.perf_counter() - begin)
    state = PaintState(np.full(mesh.n_faces, -1, np.int32), plain_table(4))
    middle = mesh.n_faces // 2 + round(mesh.n_faces**0.5 / 2)
    position = surface.centres[middle]
    plotter, scene = _scene()
    first = MeshLayer("shape", mesh.vertices, mesh.triangles, face_colours(state.labels, part_colours(4)))
    scene.show(Display((View((first,)),)))
    place_camera(scene.camera, *frame_of(mesh.vertices, WIDTH / HEIGHT))
    begin = time.perf_counter()
    scene.pixels()
    first_picture = 1e3 * (time.perf_counter() - begin)
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


def slider_times(family: TrueFamily, seed: int) -> dict[str, float]:
    """Milliseconds from a slider to points, to the picture of points, to the preview mesh and to the final one."""
    rng = np.random.default_rng(seed)
    observations = observe(family.positions, family.part, family.part_names)
    machine = last(learn_machine(observations, rng=rng, epochs=2)).machine
    found = directions(machine, fit_mixture(machine, observations), observations)
    base = infer(machine, observations.values[:1], observations.exists[:1])
    sources = make_sources(
        [shape.name for shape in family.shapes], lambda t: family.shapes[t], family.faces, family.positions,
        family.part, family.part_names,
    )  # fmt: skip
    exists = observations.exists[0]
    values = iter(np.tile(np.linspace(-1.5, 1.5, 11), 100).tolist())

    def move() -> np.ndarray:
        return np.asarray(drive(machine, base, {0: next(values)}, directions=found), float)

    points = move()
    begin = time.perf_counter()
    chosen = retrieve(points, exists, sources).shape
    read = 1e3 * (time.perf_counter() - begin)
    plotter, scene = _scene()
    colours = label_colours(np.asarray(family.part, np.int64), part_colours(len(family.part_names)))

    def show_points() -> None:
        now = move()
        there = np.isfinite(now).all(axis=1)
        scene.show(Display((View((PointLayer("points", now[there], colours[there]),)),)))
        scene.pixels()

    show_points()
    result = {
        "slider to points": _median(move, 25),
        "slider to picture of points": _median(show_points, 9),
        "slider to preview mesh": _median(lambda: synthesize(move(), exists, sources, preview=True, shapes=chosen), 5),
        "slider to final mesh": _median(lambda: synthesize(move(), exists, sources), 3),
        "parts of the family read (first)": read,
    }
    _close(plotter, scene)
    return result


def _scene() -> tuple[pv.Plotter, Scene]:
    plotter = pv.Plotter(off_screen=True, window_size=(WIDTH, HEIGHT))
    plotter.ren_win.SetMultiSamples(0)
    return plotter, Scene(plotter, lambda: None)


def _close(plotter: pv.Plotter, scene: Scene) -> None:
    scene.clear()
    plotter.close()


def _median(action: Callable[[], object], times: int) -> float:
    action()
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        action()
        taken.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(taken))


def run(n_faces: list[int], count: int, n_points: int, seed: int) -> dict:
    """All of it, one BLAS thread."""
    with threadpool_limits(1, "blas"):
        milliseconds = {}
        for n in n_faces:  # the size that targets are stated for has the plain names
            size = "" if n == 200_000 else f"{n} faces, "
            milliseconds |= {f"{size}{what}": taken for what, taken in brush_times(n).items()}
        family = true_family("chairs", count, seed=seed, n_points=n_points)
        milliseconds |= fit_view_times(family)
        milliseconds |= slider_times(family, seed)
        blas = [
            f"{lib.get('internal_api')} {lib.get('architecture', '')} x{lib.get('num_threads')}"
            for lib in threadpool_info()
            if lib.get("user_api") == "blas"
        ]
    return {"faces": n_faces, "shapes": count, "points": n_points, "milliseconds": milliseconds, "blas": blas}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--faces", type=int, nargs="*", default=[20_000, 200_000, 1_000_000])
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    result = run(options.faces, options.count, options.points, options.seed)
    if not options.json:
        print(f"{result['faces']} faces, {result['shapes']} shapes of {result['points']} points, {result['blas']}")
        print(format_table(["what", "ms"], [[name, value] for name, value in result["milliseconds"].items()]))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
