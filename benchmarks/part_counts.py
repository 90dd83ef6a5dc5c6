"""Are parts and their copies told apart?  Ghosts, losses and mislabelled copies on generated chairs and airplanes.

    python -m benchmarks.part_counts [--sets more-engines …] [--seeds 3] [--points 1500] [--shapes 6] [--json]

Every set has one or three exemplars, painted by the truth, and shapes of several kinds, ``--shapes`` of each, which are
not: with as many copies of a part as the exemplars have, with more (a fifth leg, engines three and four), with fewer,
or without the part.  Judged are the labels of faces as the project exports them.

A *ghost* is a part that a shape has not and that is given more than 1% of its area; a *loss* a part with less than 10%
of its true area; both count per shape and part, of the parts that an exemplar shows.  A *mislabelled copy* is one leg,
engine, arm, wing, … of which most of the area bears another label; per shape and copy.  Rails between legs, pylons and
castors are *ties*, counted by themselves in the same way.

Of the corresponding points judged is whether they exist: a *spare* component of the templates (the exemplar's outer
engines on a shape with two) is kept, or one that the shape has is gone, when most of its points exist, or do not; per
shape and component of parts that the shape has and the fit gives to it.  Ties, and names that several components of an
exemplar share (slats of a back), are left out, and so are parts of another build, which have none of the components:
two engines of an exemplar say where the one of a propeller airplane is.

Shares are of the cases; CPU-seconds a shape are those of the fit on one thread.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from threadpoolctl import threadpool_limits

from shapeforge.collection.align import affine_align
from shapeforge.collection.families import Generated, generate_one
from shapeforge.collection.families.copies import with_copy
from shapeforge.collection.groups import Groups
from shapeforge.collection.iterate import last
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape
from shapeforge.deformation.faces import explanations, label_faces
from shapeforge.deformation.fit import FitState, fit_templates
from shapeforge.deformation.hierarchy import deformed_family
from shapeforge.deformation.templates import template_from_exemplar
from shapeforge.validation.statistics import format_table

GHOST, LOSS = 0.01, 0.1
"""Share of the shape's area that makes a ghost; share of a part's own area below which it is lost."""

TIES = ("stretcher", "apron", "pylon", "outer pylon", "castor", "foot ring", "strut", "propeller", "canopy")
SMALLEST = 0.005
"""Share of the area below which a copy is not counted."""


# -- kinds of shapes -------------------------------------------------------------------------------------------------


def _moved_leg(shape: Generated, component: str, share: float) -> Generated:
    """A leg once more, at ``share`` of the way to the other side."""
    end = component.split()[1]
    tip = shape.landmarks[f"leg_tip_{end}_left"]
    return with_copy(shape, [component], [-2 * tip[0] * share, 0, 0])


def _five_legs(shape: Generated) -> Generated:
    return _moved_leg(shape, "leg front left", 0.5)


def _six_legs(shape: Generated) -> Generated:
    return _moved_leg(_moved_leg(shape, "leg front left", 0.5), "leg rear left", 0.5)


def _always(shape: Generated) -> bool:
    return True


def _has(*components: str, without: tuple[str, ...] = ()) -> Callable[[Generated], bool]:
    return lambda shape: set(components) <= set(shape.components) and not set(without) & set(shape.components)


def _under_wing(shape: Generated) -> bool:
    """Engines hang below the wings, not at the tail."""
    at = shape.landmarks.get("engine_front_left")
    return at is not None and at[2] > 0


@dataclass(frozen=True)
class Kind:
    """Shapes of some fine classes that are ``wanted``, ``changed``."""

    family: str
    classes: tuple[str, ...]
    wanted: Callable[[Generated], bool] = _always
    changed: Callable[[Generated], Generated] = lambda shape: shape


FOUR = ("side", "armchair")
KINDS = {
    "four legs": Kind("chairs", FOUR),
    "five legs": Kind("chairs", FOUR, changed=_five_legs),
    "swivel": Kind("chairs", ("swivel",)),
    "bench": Kind("chairs", ("bench",)),
    "six-legged bench": Kind("chairs", ("bench",), changed=_six_legs),
    "two engines": Kind("airplanes", ("airliner",), _has("engine left", without=("outer engine left",))),
    "four engines": Kind("airplanes", ("airliner",), _has("outer engine left")),
    "fighter": Kind("airplanes", ("fighter",)),
    "propeller": Kind("airplanes", ("propeller",)),
    "glider": Kind("airplanes", ("glider",)),
}
EXEMPLARS = {
    "armchair": Kind("chairs", ("armchair",)),
    "swivel": Kind("chairs", ("swivel",), _has("arm left")),
    "bench": Kind("chairs", ("bench",), _has("back", "arm left")),
    "two engines": Kind(
        "airplanes", ("airliner",),
        lambda shape: _under_wing(shape) and "outer engine left" not in shape.components,
    ),
    "four engines": KINDS["four engines"],
    "five legs": KINDS["five legs"],
    "six-legged bench": KINDS["six-legged bench"],
    "fighter": Kind("airplanes", ("fighter",), _has("tailplane left")),
    "propeller": Kind("airplanes", ("propeller",), _has("cowling", "fin")),
}  # fmt: skip

SETS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "four-leg chairs": (("armchair",), ("four legs",)),
    "swivel chairs": (("swivel",), ("swivel",)),
    "benches": (("bench",), ("bench",)),
    "more legs": (("armchair",), ("five legs", "bench", "six-legged bench")),
    "fewer legs": (("five legs",), ("five legs", "four legs")),
    "fewer legs of benches": (("six-legged bench",), ("six-legged bench", "bench")),
    "two-engined": (("two engines",), ("two engines",)),
    "more engines": (("two engines",), ("four engines",)),
    "fewer engines": (("four engines",), ("four engines", "two engines")),
    "no engines": (("propeller",), ("propeller", "glider")),
    "chairs": (("armchair", "swivel", "bench"), ("four legs", "five legs", "swivel", "bench", "six-legged bench")),
    "airplanes": (
        ("two engines", "fighter", "propeller"), ("two engines", "four engines", "fighter", "propeller", "glider"),
    ),
}  # fmt: skip
"""Exemplars and kinds of shapes."""


@dataclass(frozen=True)
class Count:
    """Cases and errors."""

    parts: int = 0
    ghosts: int = 0
    present: int = 0
    losses: int = 0
    copies: int = 0
    mislabelled: int = 0
    ties: int = 0
    mislabelled_ties: int = 0
    spare: int = 0
    spare_kept: int = 0
    components: int = 0
    components_gone: int = 0

    def __add__(self, other: Count) -> Count:
        return Count(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


def some(kind: Kind, count: int, seed: int) -> list[Generated]:
    """The first ``count`` shapes of a kind."""
    found: list[Generated] = []
    for index in range(10_000):
        if len(found) == count:
            break
        made = generate_one(kind.family, index, seed=seed, classes=kind.classes)
        if kind.wanted(made):
            found.append(kind.changed(made))
    return found


def judge(made: Generated, faces: np.ndarray, shown: np.ndarray) -> Count:
    """Errors in the labels ``faces`` (n_faces,) of a shape; ``shown`` (L,) are the parts that the exemplars have."""
    area, truth = made.mesh.face_areas, made.faces
    whole, n_parts = area.sum(), len(made.part_names)
    true, given = np.bincount(truth, area, n_parts), np.bincount(faces, area, n_parts)
    absent, present = shown & (true == 0), shown & (true > 0)
    right = np.bincount(truth[faces == truth], area[faces == truth], n_parts)
    lost = present & (right < LOSS * true)
    component = np.zeros(made.mesh.n_faces, int)
    component[made.mesh.face_of_triangle] = made.address[:, 0, 0].astype(int)
    count = Count(int(absent.sum() + present.sum()), int((absent & (given > GHOST * whole)).sum()),
                  int(present.sum()), int(lost.sum()))  # fmt: skip
    for number in np.unique(component):
        mine = component == number
        if not shown[truth[mine][0]] or area[mine].sum() < SMALLEST * whole:
            continue
        wrong = int(area[mine & (faces != truth)].sum() > 0.5 * area[mine].sum())
        tie = made.component_names[number].startswith(TIES)
        count += Count(ties=1, mislabelled_ties=wrong) if tie else Count(copies=1, mislabelled=wrong)
    return count


def component_names(state: FitState, made: list[Generated], shapes: list[Shape]) -> list[tuple[str, np.ndarray]]:
    """True names of the components of the top-level templates, and their points (K,): as their exemplars have them."""
    hierarchy = state.hierarchy()
    names = np.empty(hierarchy.top.n_points, object)
    for template, link in zip(state.templates, hierarchy.links, strict=True):
        own = np.flatnonzero(link.exists & (link.weight[:, 0] == 1.0))
        source = [shape.name for shape in shapes].index(template.source) if template.source else -1
        if source >= 0:
            first = template_from_exemplar(shapes[source], made[source].faces, made[source].part_names)
            known = dict(
                zip(map(tuple, shapes[source].points.tolist()), _names(made[source], shapes[source]), strict=True)
            )
            names[own] = [known[tuple(point)] for point in first.points[link.index[own, 0]].tolist()]
    number = hierarchy.top.components.number
    found = []
    for one in range(len(hierarchy.top.components.part)):
        mine = number == one
        there, times = np.unique(names[mine].astype(str), return_counts=True)
        found.append((str(there[times.argmax()]), mine))
    told = [name for name, _ in found]
    return [(name, mine) for name, mine in found if told.count(name) == 1 and not name.startswith(TIES)]


def _names(made: Generated, shape: Shape) -> list[str]:
    """Names of the components that the points of a shape are on."""
    component = np.zeros(made.mesh.n_faces, int)
    component[made.mesh.face_of_triangle] = made.address[:, 0, 0].astype(int)
    return [made.component_names[one] for one in component[shape.face_of_point].tolist()]


def judge_points(
    made: Generated, exists: np.ndarray, part: np.ndarray, components: list[tuple[str, np.ndarray]]
) -> Count:
    """Spare components kept, and components gone, by which top-level template points (K,) exist on a shape."""
    count = Count()
    shared = {int(part[mine][0]) for name, mine in components if name in made.components}
    for name, mine in components:
        if int(part[mine][0]) not in shared or not exists[part == part[mine][0]].any():
            continue
        there = int(exists[mine].mean() > 0.5)
        if name in made.components:
            count += Count(components=1, components_gone=1 - there)
        else:
            count += Count(spare=1, spare_kept=there)
    return count


def run(name: str, count: int, seed: int, n_points: int) -> tuple[dict[str, Count], float]:
    """Errors by kind of shape in one set, and CPU-seconds a shape of its fit."""
    exemplars, kinds = SETS[name]
    made = [some(EXEMPLARS[one], 1, 1000 + seed)[0] for one in exemplars]
    kind_of: list[str] = [""] * len(made)
    for kind in kinds:
        made += some(KINDS[kind], count, seed)
        kind_of += [kind] * count
    shapes = [
        prepare_shape(f"{t}", one.mesh, n_points=n_points, up="keep", rng=np.random.default_rng([seed, t]))
        for t, one in enumerate(made)
    ]
    groups = nearest_groups(shapes, len(exemplars))
    painted = {e: made[e].faces.astype(np.int32) for e in range(len(exemplars))}
    begin = time.process_time()
    state = last(fit_templates(shapes, groups, painted, made[0].part_names, rng=np.random.default_rng(0)))
    seconds = (time.process_time() - begin) / len(shapes)
    shown = np.any([template.has_part() for template in state.templates], axis=0)
    found: dict[str, Count] = {kind: Count() for kind in kinds}
    beliefs, hierarchy = state.beliefs, state.hierarchy()
    components = component_names(state, made, shapes)
    for t in range(len(exemplars), len(shapes)):
        faces = label_faces(shapes[t], beliefs[t], explained=explanations(state, t))[0]
        exists = deformed_family(beliefs[t], hierarchy)[2]
        here = judge(made[t], faces, shown) + judge_points(made[t], exists, hierarchy.top.label, components)
        found[kind_of[t]] += here
        if here.ghosts + here.losses + here.mislabelled + here.spare_kept + here.components_gone:
            print(f"{name}, seed {seed}, {made[t].name} ({kind_of[t]}): {here}", file=sys.stderr)
    return found, seconds


def nearest_groups(shapes: list[Shape], exemplars: int) -> Groups:
    """The first shapes are exemplars; every other is in the group of that which is nearest to it."""
    group = [
        t if t < exemplars else int(np.argmin([affine_align(shapes[e].points, shape.points).residual
                                               for e in range(exemplars)]))
        for t, shape in enumerate(shapes)
    ]  # fmt: skip
    names = tuple(f"Group {g + 1}" for g in range(exemplars))
    return Groups(names, np.array(group), np.arange(exemplars), np.zeros((len(shapes), 2)))


def row(count: Count) -> list[str]:
    """Shares of errors, with the numbers of cases."""
    pairs = ((count.ghosts, count.parts), (count.losses, count.parts), (count.mislabelled, count.copies),
             (count.mislabelled_ties, count.ties), (count.spare_kept, count.spare),
             (count.components_gone, count.components))  # fmt: skip
    return [f"{wrong} of {of} ({100 * wrong / max(of, 1):.1f}%)" for wrong, of in pairs]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--shapes", type=int, default=6, help="of each kind")
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    results: dict[str, dict[str, Count]] = {}
    cost: dict[str, list[float]] = {}
    with threadpool_limits(1):
        for name in options.sets:
            results[name] = {kind: Count() for kind in SETS[name][1]}
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                found, seconds = run(name, options.shapes, seed, options.points)
                cost.setdefault(name, []).append(round(seconds, 3))
                results[name] = {kind: before + found[kind] for kind, before in results[name].items()}
    whole = sum((count for found in results.values() for count in found.values()), Count())
    if not options.json:
        rows = [
            [name, str(len(SETS[name][0])), kind, *row(count), f"{np.mean(cost[name]):.2f}"]
            for name, found in results.items()
            for kind, count in found.items()
        ]
        titles = [
            "set",
            "exemplars",
            "shapes",
            "ghosts",
            "losses",
            "mislabelled copies",
            "ties",
            "spare kept",
            "gone",
            "CPU s",
        ]
        print(format_table(titles, [*rows, ["all", "", "", *row(whole), ""]]))
    told = {name: {kind: vars(count) for kind, count in found.items()} for name, found in results.items()}
    about = {"points": options.points, "shapes": options.shapes, "seeds": options.seeds}
    print(json.dumps(about | {"sets": told, "all": vars(whole), "cpu_seconds": cost}))


if __name__ == "__main__":
    main()
