"""Descriptors in a pipeline of scikit-learn."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.model_selection import cross_val_score
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline

from shapeforge.generative.descriptors import describe_shapes
from shapeforge.generative.observations import observe
from shapeforge.generative.transformer import ShapeDescriptors
from tests.generative.synthetic import PART_NAMES, chair_family


@pytest.fixture(scope="module")
def family():
    return chair_family(40, rng=np.random.default_rng(0), density=0.06)


def test_classes_are_told_apart_in_a_pipeline_that_is_cross_validated(family):
    positions, part, classes = family
    describe = ShapeDescriptors(part, PART_NAMES, epochs=30, layers=1)
    pipeline = make_pipeline(describe, KNeighborsClassifier(1, metric="manhattan"))
    flat = positions.reshape(len(positions), -1)
    assert cross_val_score(pipeline, flat, classes, cv=2).mean() > 0.75


def test_numbers_are_those_of_the_machine_and_have_names(family):
    positions, part, _ = family
    fitted = clone(ShapeDescriptors(part, PART_NAMES, epochs=5, random_state=3)).fit(positions[:20])
    found = fitted.transform(positions[20:25])
    machine = fitted.machine_
    seen = observe(positions[20:25], machine.part, machine.part_names, machine.low, machine.high)
    np.testing.assert_array_equal(found, describe_shapes(machine, seen))
    names = fitted.get_feature_names_out()
    assert len(names) == found.shape[1] and names[-1] == f"has {PART_NAMES[-1]}"
    np.testing.assert_array_equal(found, clone(fitted).fit(positions[:20]).transform(positions[20:25]))


def test_shapes_of_another_family_are_refused(family):
    positions, part, _ = family
    fitted = ShapeDescriptors(part, PART_NAMES, epochs=2).fit(positions[:8])
    with pytest.raises(ValueError, match="another family"):
        fitted.transform(positions[:, :-1])
    with pytest.raises(ValueError, match="different fits"):
        ShapeDescriptors(part[:-1], PART_NAMES).fit(positions)
    with pytest.raises(ValueError, match="X: wanted"):
        ShapeDescriptors().fit(np.zeros((3, 4)))
