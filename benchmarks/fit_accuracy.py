"""How accurate is the fit?  The deformation model beside its ablations and its peers, on families whose truth is known.

    python -m benchmarks.fit_accuracy [--sets ikea-chairs …] [--methods ours affine …] [--seeds 3] [--points 2000]
                                      [--shapes 24] [--json]

Sets: ikea chairs and tables from $SHAPEFORGE_DATA or ../shared/data (left out, saying so, where absent), generated
chairs and airplanes; if asked for, the families of ``benchmarks.organic``, too.  Poses are known.  Three exemplars that
cover the parts are painted by the truth, every method gets the same ones, and they take no part in the scores.  A seed
draws the points, the generated family and the groups.

Columns: right faces, right area and part IoU, means over the shapes; corr@.02, .05, .10 and the area under that curve
from 0 to .25 (1 is perfect), landmarks of all ordered pairs of shapes pooled; corr@.05 of the pairs (nearest exemplar,
shape) alone, the first at its own samples; CPU-seconds a shape on one thread.  Mean ± standard deviation over seeds.

Ablations change the fit alone, by patching the model's constants and functions (``ABLATIONS``).  Without φ4 the labels
hear nothing of the templates; its correspondences are what is of interest.  Peers carry labels and points over from the
nearest exemplar: the affine map alone (``validation.transfer``), and from that start, at 1000 samples of either side,
coherent point drift (``pycpd``) and functional maps (``pyfmaps``; point-cloud Laplacian, as polygon soup has none of
its own; wave kernel signatures and coordinates as descriptors).  Labels go to the nearest moved point; from shape to
shape points correspond through those of the first exemplar.  Both packages are in the extra ``bench``, and a peer is
left out, saying so, where its package is missing.  The last line is one JSON object with the figures of every seed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from benchmarks._fit_ablations import ABLATIONS
from benchmarks.organic import FAMILIES as ORGANIC
from benchmarks.organic import write_organic
from shapeforge.collection.align import Alignment, affine_align, thinned
from shapeforge.collection.families import write_family
from shapeforge.collection.groups import Groups, group_shapes
from shapeforge.collection.iterate import last
from shapeforge.collection.labels import find_part_names, read_seg
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape
from shapeforge.collection.surface import closest_points
from shapeforge.deformation.faces import explanations, label_faces
from shapeforge.deformation.fit import FitDiverged, fit_templates
from shapeforge.deformation.hierarchy import corresponding_points
from shapeforge.validation.correspondence import corr_curve, landmark_errors
from shapeforge.validation.segmentation import mean_score, score_segmentation
from shapeforge.validation.statistics import format_table
from shapeforge.validation.transfer import affine_transfer, nearest_exemplar, reference_points, transfer_labels

DATA = Path(os.environ.get("SHAPEFORGE_DATA", Path(__file__).parents[2] / "shared" / "data"))
REAL = {"ikea-chairs": "ikea/chairs", "ikea-tables": "ikea/tables"}
GENERATED = {"generated-chairs": "chairs", "generated-airplanes": "airplanes"}
DEFAULT = (*REAL, *GENERATED)
EXEMPLARS = 3
PEER_POINTS = 1000
RADII, LARGEST_RADIUS = (0.02, 0.05, 0.10), 0.25
MEASURES = ("faces", "area", "part IoU", "corr@.02", "corr@.05", "corr@.10", "AUC", "ex@.05", "CPU s")
COMPARED = ("part IoU", "corr@.05", "AUC", "ex@.05")  # in the table of differences
PEERS = {"affine": "affine transfer", "cpd": "CPD", "functional-maps": "functional maps"}
PACKAGES = {"cpd": ("pycpd",), "functional-maps": ("pyFM", "robust_laplacian")}
METHODS = {"ours": "ours"} | {name: title for name, (title, _) in ABLATIONS.items()} | PEERS


# -- the families ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes with their truth: part index per face, landmarks in normal coordinates; the groups of the exemplars."""

    shapes: list[Shape]
    truth: list[np.ndarray]
    marks: list[dict[str, np.ndarray]]
    part_names: tuple[str, ...]
    groups: Groups

    @property
    def exemplars(self) -> list[int]:
        """Indices of the painted shapes, that which covers most parts first."""
        return self.groups.exemplars.tolist()

    @property
    def tested(self) -> list[int]:
        """Indices of the shapes that are scored."""
        return [t for t in range(len(self.shapes)) if t not in self.exemplars]


def read_family(folder: Path, count: int, n_points: int, seed: int, exemplars: int = EXEMPLARS) -> Family:
    """At most ``count`` shapes of a folder, evenly picked, with so many exemplars."""
    files = sorted(folder.glob("*.obj"))
    files = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, count).round().astype(int))]
    names, places = find_part_names(folder), json.loads((folder / "landmarks.json").read_text())
    shapes, truth, marks = [], [], []
    for t, file in enumerate(files):
        mesh = read_mesh(file)
        shape = prepare_shape(file.stem, mesh, n_points=n_points, up="keep", rng=np.random.default_rng([seed, t]))
        shapes.append(shape)
        truth.append(read_seg(file.with_suffix(".seg"), mesh.n_faces, names))
        given = places.get(file.stem, {}).items()
        marks.append({mark: shape.frame.to_normal(np.asarray(place, float)) for mark, place in given})
    groups = last(group_shapes(shapes, rng=np.random.default_rng(seed))).groups
    has = np.array([[(faces == part).any() for part in range(len(names.names))] for faces in truth])
    return Family(shapes, truth, marks, names.names, around(groups, covering(has, groups.dissimilarity, exemplars)))


def covering(has: np.ndarray, distance: np.ndarray, count: int = EXEMPLARS) -> list[int]:
    """Exemplars: each with the most parts (``has`` (T, L)) that none before has, of those the most central one."""
    chosen: list[int] = []
    while len(chosen) < count:
        new = (has & ~has[chosen].any(axis=0)).sum(axis=1)
        new[chosen] = -1
        left = np.minimum(distance, distance[chosen].min(axis=0, initial=np.inf)).sum(axis=1)
        chosen.append(min(np.flatnonzero(new == new.max()).tolist(), key=lambda t: left[t]))
    return chosen


def around(groups: Groups, exemplars: list[int]) -> Groups:
    """Groups of the shapes nearest to each of the exemplars."""
    group = groups.dissimilarity[:, exemplars].argmin(axis=1)
    group[exemplars] = np.arange(len(exemplars))
    names = tuple(f"Group {g + 1}" for g in range(len(exemplars)))
    return replace(groups, names=names, group=group, exemplars=np.array(exemplars))


# -- the methods -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says of the shapes tested: labels per face, corresponding points (K, 3), and per shape its exemplar
    with corresponding points of both."""

    faces: dict[int, np.ndarray]
    positions: dict[int, np.ndarray]
    pairs: dict[int, tuple[int, np.ndarray, np.ndarray]]


def fitted(family: Family, method: str) -> Answer:
    """Our fit, or one of its ablations."""
    groups = around(family.groups, family.exemplars[:1]) if method == "one-exemplar" else family.groups
    painted = {int(e): family.truth[e] for e in groups.exemplars}
    shapes = family.shapes
    with ExitStack() as patched:
        for name, value in ABLATIONS.get(method, ("", {}))[1].items():
            patched.enter_context(patch(f"shapeforge.deformation.{name}", value))
        try:
            for now in fit_templates(shapes, groups, painted, family.part_names, rng=np.random.default_rng(0)):
                state = now
        except FitDiverged as error:  # the state before is as good as the ablation gets
            print(f"{method}: {error}; scored as it was after round {state.round}", file=sys.stderr)
    beliefs = state.beliefs
    hierarchy = state.hierarchy()
    places = {t: corresponding_points(shapes[t], beliefs[t], hierarchy)[0] for t in range(len(shapes))}
    pairs = {}
    for t in family.tested:
        e = family.exemplars[nearest_exemplar(shapes[t], [shapes[e] for e in family.exemplars])[0]]
        pairs[t] = e, places[e], places[t]
    faces = {t: label_faces(shapes[t], beliefs[t], explained=explanations(state, t))[0] for t in family.tested}
    return Answer(faces, {t: places[t] for t in family.tested}, pairs)


def affine(family: Family, method: str) -> Answer:
    """The nearest exemplar under the affine map alone."""
    exemplars = [family.shapes[e] for e in family.exemplars]
    painted, references = [family.truth[e] for e in family.exemplars], reference_points(exemplars)
    faces, positions, pairs = {}, {}, {}
    for t in family.tested:
        found = affine_transfer(family.shapes[t], exemplars, painted, references)
        faces[t], positions[t] = found.faces, found.positions
        chosen = exemplars[found.exemplar].points
        moved = affine_align(chosen, family.shapes[t].points)(chosen)
        pairs[t] = family.exemplars[found.exemplar], chosen, moved
    return Answer(faces, positions, pairs)


def registered(family: Family, method: str) -> Answer:
    """A peer that registers pairs of point sets, from the affine start; all points go along with the samples."""
    register = {"cpd": drifted, "functional-maps": mapped}[method]

    def moved(points: np.ndarray, alignment: Alignment, source: Shape, target: Shape) -> np.ndarray:
        start = alignment(thinned(source.points, PEER_POINTS))
        return carried(alignment(points), start, register(start, thinned(target.points, PEER_POINTS)))

    first, *others = exemplars = [family.shapes[e] for e in family.exemplars]
    references = [first.points]
    for other in others:
        places = moved(first.points, affine_align(first.points, other.points), first, other)
        references.append(closest_points(other.mesh, places)[0])
    faces, positions, pairs = {}, {}, {}
    for t in family.tested:
        shape = family.shapes[t]
        chosen, alignment = nearest_exemplar(shape, exemplars)
        e, exemplar = family.exemplars[chosen], exemplars[chosen]
        both = moved(np.concatenate([exemplar.points, references[chosen]]), alignment, exemplar, shape)
        own, positions[t] = both[: exemplar.n_points], both[exemplar.n_points :]
        faces[t] = transfer_labels(shape, own, family.truth[e][exemplar.face_of_point])
        pairs[t] = e, exemplar.points, own
    return Answer(faces, positions, pairs)


def carried(points: np.ndarray, samples: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """``points`` (n, 3) shifted as the three nearest of the ``samples`` (m, 3) were, near ones counting more."""
    distance, near = cKDTree(samples).query(points, k=3)
    weight = 1.0 / (distance + 1e-6)
    weight /= weight.sum(axis=1, keepdims=True)
    return points + np.einsum("nk,nki->ni", weight, (moved - samples)[near])


def drifted(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """``source`` (n, 3) moved onto ``target`` (m, 3) by coherent point drift."""
    from pycpd import DeformableRegistration

    # started as narrow as the affine start allows: from the package's own width it throws that start away
    return DeformableRegistration(X=target, Y=source, alpha=2, beta=0.5, w=0.1, sigma2=0.05**2).register()[0]


def mapped(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The point of ``target`` (m, 3) for each of ``source`` (n, 3) by a functional map.

    Not refined by ZoomOut, and by coordinates more than by looks: on shapes of many loose symmetric pieces both
    alternatives were worse.
    """
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh

    model = FunctionalMapping(TriMesh(target), TriMesh(source))
    model.preprocess(n_descr=60, k_process=100, k_descr=100, descr_type="WKS", subsample_step=20)
    model.add_descriptors(target, source)
    model.fit(K=(15, 15))
    return target[model.get_p2p()]


def answer(family: Family, method: str) -> Answer:
    """What a method of the table says."""
    ways: Mapping[str, Callable[[Family, str], Answer]] = {"affine": affine} | dict.fromkeys(PACKAGES, registered)
    return ways.get(method, fitted)(family, method)


# -- the figures -----------------------------------------------------------------------------------------------------


def figures(family: Family, found: Answer) -> list[float]:
    """The accuracy measures, in the order of ``MEASURES``."""
    shapes, by_name = family.shapes, {shape.name: t for t, shape in enumerate(family.shapes)}

    def errors(points: Mapping[int, np.ndarray]) -> np.ndarray:
        return landmark_errors(
            {shapes[t].name: family.marks[t] for t in points}, {shapes[t].name: points[t] for t in points},
            lambda name: shapes[by_name[name]].mesh,
        )  # fmt: skip

    scores = [score_segmentation(shapes[t].mesh, faces, family.truth[t]) for t, faces in found.faces.items()]
    mean = mean_score([score for score in scores if score is not None])
    between = errors(found.positions)
    # both directions of a pair, first towards the exemplar; there are as many of each
    both = [errors({e: on_exemplar, t: on_shape}) for t, (e, on_exemplar, on_shape) in found.pairs.items()]
    onto = np.concatenate([pair[len(pair) // 2 :] for pair in both])
    area_under = float(np.clip(1.0 - between / LARGEST_RADIUS, 0.0, None).mean())
    at_exemplar = float(corr_curve(onto, (0.05,))[0])
    return [mean.faces, mean.area, mean.part_iou, *corr_curve(between, RADII).tolist(), area_under, at_exemplar]


def run(sets: list[str], methods: list[str], seeds: int, count: int, n_points: int) -> dict[str, dict]:
    """Figures by set, method and measure, one of each seed; one thread."""
    results: dict[str, dict] = {}
    with threadpool_limits(1):
        for name in sets:
            found = results[name] = {method: {measure: [] for measure in MEASURES} for method in methods}
            for seed in range(seeds):
                with tempfile.TemporaryDirectory() as made:
                    folder = DATA / REAL[name] if name in REAL else Path(made)
                    if name in GENERATED:
                        write_family(folder, GENERATED[name], count, seed=seed)
                    elif name in ORGANIC:
                        write_organic(folder, name, count, seed=seed)
                    family = read_family(folder, count, n_points, seed)
                for method in methods:
                    begin = time.process_time()
                    said = answer(family, method)
                    seconds = (time.process_time() - begin) / len(family.shapes)
                    for measure, value in zip(MEASURES, [*figures(family, said), seconds], strict=True):
                        found[method][measure].append(round(value, 4))
                    print(f"{name}, seed {seed}: {method}, {seconds:.2f} CPU-seconds a shape", file=sys.stderr)
    return results


def cell(values: list[float] | np.ndarray, form: str = ".3f") -> str:
    """Mean ± standard deviation over the seeds."""
    return f"{np.mean(values):{form}}" + (f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else "")


def differences(found: dict[str, dict[str, list[float]]]) -> list[list[str]]:
    """Rows of ours minus every other method: what the draw of a seed does to both alike falls out."""
    others = [method for method in found if method != "ours"]
    return [
        [METHODS[m], *(cell(np.subtract(found["ours"][what], found[m][what]), "+.3f") for what in COMPARED)]
        for m in others
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", choices=[*DEFAULT, *ORGANIC], default=DEFAULT)
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--shapes", type=int, default=24, help="of each set, at most")
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    if not EXEMPLARS + 2 <= options.shapes <= 100:
        parser.error(f"--shapes: wanted {EXEMPLARS + 2} to 100 (exemplars, and at least a pair to score)")
    absent = [name for name in options.sets if name in REAL and not (DATA / REAL[name]).is_dir()]
    missing = [m for m in options.methods if not all(map(find_spec, PACKAGES.get(m, ())))]
    skipped = [f"{name}: {DATA / REAL[name]} is not here (set SHAPEFORGE_DATA)" for name in absent]
    skipped += [f"{METHODS[m]}: {', '.join(PACKAGES[m])} not installed (pip install '.[bench]')" for m in missing]
    sets = [name for name in options.sets if name not in absent]
    methods = [method for method in options.methods if method not in missing]
    results = run(sets, methods, options.seeds, options.shapes, options.points)
    if not options.json:
        for reason in skipped:
            print(f"left out: {reason}")
        for name, found in results.items():
            title = f"{name}: P = {options.points}, at most {options.shapes} shapes, seeds {options.seeds}, "
            print(f"\n{title}{EXEMPLARS} exemplars that cover the parts, not scored")
            rows = [[METHODS[m], *(cell(values) for values in one.values())] for m, one in found.items()]
            print(format_table(["", *MEASURES], rows))
            if "ours" in found and len(found) > 1:
                print(format_table(["ours minus, seed by seed", *COMPARED], differences(found)))
    about = {"points": options.points, "shapes": options.shapes, "seeds": options.seeds, "left_out": skipped}
    print(json.dumps(about | {"sets": results}))


if __name__ == "__main__":
    main()
