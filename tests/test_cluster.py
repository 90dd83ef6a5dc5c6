"""Groups, fit and machine on a dask cluster of two processes: the same bytes as here."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups, group_shapes
from shapeforge.collection.iterate import last
from shapeforge.deformation.fit import FitDiverged, fit_templates
from tests.generated import prepared

distributed = pytest.importorskip("distributed", reason="dask's distributed is not installed: pip install '.[dask]'")


class Lazy:
    """Shapes that are made when they are asked for; how often each was is written down."""

    def __init__(self, shapes):
        self.shapes, self.reads = shapes, [0] * len(shapes)

    names = property(lambda self: tuple(shape.name for shape in self.shapes))

    def __len__(self):
        return len(self.shapes)

    def __getitem__(self, index):
        self.reads[index] += 1
        return self.shapes[index]

    def __iter__(self):
        return (self[index] for index in range(len(self)))


@pytest.fixture(scope="module")
def family():
    made = generate("chairs", 4, seed=11, broken=0.0, classes=("side",))
    shapes = prepared(made, 400)
    groups = Groups(("a",), np.zeros(4, int), np.array([0]), np.zeros((4, 2)))
    return shapes, groups, {0: np.asarray(made[0].faces, np.int32)}, made[0].part_names


@pytest.fixture(scope="module")
def executor(tmp_path_factory):
    import dask

    folder = tmp_path_factory.mktemp("dask")
    settings = {"distributed.dashboard.link": "", "temporary-directory": str(folder)}
    with dask.config.set(settings), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of packages that the cluster brings with it
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
            worker_dashboard_address=None,
        )  # fmt: skip
        with cluster, distributed.Client(cluster) as client:
            yield client.get_executor()


def run(family, shapes=None, **options):
    own, groups, labels, names = family
    return last(fit_templates(shapes or own, groups, labels, names, rounds=6, rng=np.random.default_rng(0), **options))


def test_a_fit_on_two_processes_gives_the_same_bytes_and_reads_every_shape_once(family, executor):
    here, shapes = run(family), Lazy(family[0])
    there = run(family, shapes, executor=executor)
    assert shapes.reads[1:] == [1, 1, 1]
    assert here.energy == there.energy
    for one, other in zip(here.candidates, there.candidates, strict=True):
        for x, y in zip(one, other, strict=True):
            assert x.weight == y.weight
            for name in ("deformed", "variance", "maps", "offsets", "segmentation", "active"):
                assert np.array_equal(getattr(x.beliefs, name), getattr(y.beliefs, name)), name
    for x, y in zip(here.templates, there.templates, strict=True):
        assert np.array_equal(x.points, y.points)


@pytest.mark.slow
def test_a_fit_that_diverges_on_a_cluster_says_where(family, executor):
    from dataclasses import replace

    shapes = list(family[0])
    shapes[2] = replace(shapes[2], descriptors=np.full_like(shapes[2].descriptors, np.nan))
    with pytest.raises(FitDiverged, match=shapes[2].name):
        run(family, shapes, executor=executor)


@pytest.mark.slow
def test_groups_on_two_processes_are_the_same(family, executor):
    here = last(group_shapes(family[0], rng=np.random.default_rng(0))).groups
    there = last(group_shapes(family[0], rng=np.random.default_rng(0), executor=executor)).groups
    assert np.array_equal(here.dissimilarity, there.dissimilarity) and np.array_equal(here.group, there.group)
