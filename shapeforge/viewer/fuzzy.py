"""The fuzzy correspondence of one shape: which template points each surface sample may be, as it is after the fit.

The fit stores no correspondence; here the correspondence update (supplement 1.3) is done once more for one shape, and
read in two ways: where on the shape one template point may lie, and how undecided every sample is.  No Qt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import Covariances
from shapeforge.deformation.hierarchy import Hierarchy
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import find_candidates, make_problem, update_correspondences

NEIGHBOURHOOD = 0.05
"""Diagonals: template points this near (one standard deviation) to the picked one count as the same place."""
MOST_SHARE = 0.01
"""Of a template's points: where so many are as likely as each other, entropy has its hottest colour."""
SAMPLES_PER_VERTEX = 3


@dataclass(frozen=True, eq=False)
class Fuzzy:
    """q of one shape for each template that explains some part of it: (P, K of that template), rows sum to 1.

    ``bits`` (P,) is the entropy of each sample's correspondence; ``near`` (V, 3) and ``share`` (V, 3) are the samples
    next to each vertex that is shown, and their weights.
    """

    q: dict[int, csr_matrix]
    lender: dict[int, int]
    template: int
    bits: Float[np.ndarray, " P"]
    near: Int[np.ndarray, "V 3"]
    share: Float[np.ndarray, "V 3"]

    @property
    def unsure(self) -> Float[np.ndarray, " P"]:
        """Entropy of each sample (P,): 1 where a hundredth of the template is as likely, however dense that is."""
        return self.bits / max(1.0, float(np.log2(MOST_SHARE * self.q[self.template].shape[1])))

    def at_vertices(self, values: Float[np.ndarray, " P"]) -> Float[np.ndarray, " V"]:
        """Values of the samples (P,) at the vertices that are shown (V,)."""
        return (values[self.near] * self.share).sum(axis=1)


def fuzzy_correspondence(
    shape: Shape, beliefs: Beliefs, templates: tuple[PartTemplates, ...], covariances: Covariances,
    vertices: Float[np.ndarray, "V 3"], painted: Int[np.ndarray, " F"] | None = None,
) -> Fuzzy:  # fmt: skip
    """The correspondence of a fitted shape; ``vertices`` (V, 3) as the shape lies, ``painted`` parts per face."""
    problem = make_problem(shape, painted)
    q = {}
    for one in (beliefs, *(theirs for _, theirs in beliefs.lent)):
        if one.template not in q:
            template = templates[one.template]
            candidates = find_candidates(problem, template, one, covariances.descriptor)
            found = update_correspondences(problem, template, candidates, one, covariances.unary)
            where = (np.asarray(found.q, float), candidates.template_index, candidates.offsets)
            q[one.template] = csr_matrix(where, shape=(shape.n_points, template.n_points))
    main = q[beliefs.template]
    log = main.copy()
    log.data = -main.data * np.log2(np.maximum(main.data, 1e-300))
    distance, near = cKDTree(shape.points).query(vertices, k=min(SAMPLES_PER_VERTEX, shape.n_points))
    distance, near = distance.reshape(len(vertices), -1), near.reshape(len(vertices), -1)
    weight = 1.0 / (distance + 1e-3) ** 2
    share = weight / weight.sum(axis=1, keepdims=True)
    lender = {part: theirs.template for part, theirs in beliefs.lent}
    bits = np.asarray(log.sum(axis=1), float).ravel()
    return Fuzzy(q, lender, beliefs.template, bits, near, share)


def where_it_may_lie(
    fuzzy: Fuzzy, hierarchy: Hierarchy, templates: tuple[PartTemplates, ...], point: int
) -> Float[np.ndarray, " P"]:
    """Chance (P,) of every sample to be top-level point ``point`` or one within NEIGHBOURHOOD of it on its part."""
    part = int(hierarchy.top.label[point])
    which = fuzzy.lender.get(part, fuzzy.template)
    link, template = hierarchy.links[which], templates[which]
    place = link.weight[point] @ template.points[link.index[point]]
    away = ((template.points - place) ** 2).sum(axis=1)
    same = np.exp(-0.5 * away / NEIGHBOURHOOD**2) * (template.label == part)
    return np.asarray(fuzzy.q[which] @ same, float)


def part_bits(probabilities: Float[np.ndarray, "F L"]) -> Float[np.ndarray, " F"]:
    """Entropy (F,) of the part of every face, in bits: 1 where two parts are as likely as each other."""
    p = np.asarray(probabilities, float)
    p = p / np.maximum(p.sum(axis=1, keepdims=True), 1e-12)
    return -(p * np.log2(np.maximum(p, 1e-300))).sum(axis=1)
