"""The exact two-way map between the natural centred form and the print's a, b, c, d, a0, b0 >= 0 (Eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative.energy import Hidden, log_features
from shapeforge.generative.machine import BetaShapeMachine


@dataclass(frozen=True, eq=False)
class PaperForm:
    """Eq. 2 as printed, per part: ``on[l]`` = [a, b], ``off[l]`` = [c, d] (2, F, M), ``base[l]`` = [a0, b0] (2, F).

    ``biases[0]`` (M,) is w[m,0] and so on up, ``couplings[0]`` (M, N) is w[m,n].  ``absent1`` (M,) is added to w[m,0]
    of a part's units where the part is absent, and ``existence_top`` (L, O) couples E to the top: both are ours, and
    zero in the print.
    """

    on: tuple[Float[np.ndarray, "2 _ _"], ...]
    off: tuple[Float[np.ndarray, "2 _ _"], ...]
    base: tuple[Float[np.ndarray, "2 _"], ...]
    absent1: Float[np.ndarray, " M"]
    biases: tuple[Float[np.ndarray, " _"], ...]
    couplings: tuple[Float[np.ndarray, "_ _"], ...]
    existence_top: Float[np.ndarray, "L O"]


def to_paper(machine: BetaShapeMachine) -> PaperForm:
    """a = max(W, 0), c = max(-W, 0), a0 = A - Σ c, with A = Ā - W ν; likewise b, d, b0; and the uncentred biases."""
    on, off, base, pull = [], [], [], []
    for slot, weight, rest, centre in zip(
        machine.units_of_part, machine.weights, machine.rest, machine.data_centre, strict=True
    ):
        negative = np.maximum(-weight, 0)
        on.append(np.maximum(weight, 0))
        off.append(negative)
        base.append(rest - weight @ machine.centres[0][slot] - negative.sum(axis=2))
        pull.append(np.einsum("sfm,sf->m", weight, centre))
    absent1 = np.concatenate(pull)
    biases = [bias - said for bias, said in zip(machine.biases, _said_by_centres(machine), strict=True)]
    biases[0] = biases[0] - absent1
    biases[-1] = biases[-1] - machine.existence_centre @ machine.existence_top
    return PaperForm(
        tuple(on), tuple(off), tuple(base), absent1, tuple(biases), machine.couplings, machine.existence_top
    )


def from_paper(form: PaperForm, like: BetaShapeMachine) -> BetaShapeMachine:
    """The natural form of printed parameters, centred where ``like`` is centred.

    The term ``absent1`` belongs to the centring and is recomputed; whatever ``form`` says there is not used.
    """
    weights, rest, pull = [], [], []
    for slot, on, off, base, centre in zip(
        like.units_of_part, form.on, form.off, form.base, like.data_centre, strict=True
    ):
        weight = on - off
        weights.append(weight)
        rest.append(base + off.sum(axis=2) + weight @ like.centres[0][slot])
        pull.append(np.einsum("sfm,sf->m", weight, centre))
    back = replace(
        like, weights=tuple(weights), rest=tuple(rest), couplings=form.couplings, existence_top=form.existence_top
    )
    biases = [bias + said for bias, said in zip(form.biases, _said_by_centres(back), strict=True)]
    biases[0] = biases[0] + np.concatenate(pull)
    biases[-1] = biases[-1] + like.existence_centre @ form.existence_top
    return replace(back, biases=tuple(biases))


def _said_by_centres(machine: BetaShapeMachine) -> list[np.ndarray]:
    """What every layer hears from the layers next to it when these are at their centres."""
    said = [np.zeros_like(bias) for bias in machine.biases]
    for index, coupling in enumerate(machine.couplings):
        said[index] = said[index] + coupling @ machine.centres[index + 1]
        said[index + 1] = said[index + 1] + machine.centres[index] @ coupling
    return said


def log_unnormalized_as_printed(
    form: PaperForm, machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"],
    hidden: Hidden,
) -> Float[np.ndarray, " n"]:  # fmt: skip
    """Eq. 2 literally (n,), without its structure terms; ``machine`` only tells which points and units a part has."""
    total = np.einsum("nl,lo,no->n", exists.astype(float), form.existence_top, hidden[-1])
    for layer, bias in zip(hidden, form.biases, strict=True):
        total = total + layer @ bias
    for index, coupling in enumerate(form.couplings):
        total = total + np.einsum("nm,mo,no->n", hidden[index], coupling, hidden[index + 1])
    for index, slot in enumerate(machine.units_of_part):
        h = hidden[0][:, slot]
        exponent = (
            form.base[index] - 1
            + np.einsum("sfm,nm->nsf", form.on[index], h)
            + np.einsum("sfm,nm->nsf", form.off[index], 1 - h)
        )  # fmt: skip
        geometry = np.einsum("nsf,nsf->n", exponent, log_features(machine.coordinates(values, index)))
        total = total + np.where(exists[:, index], geometry, h @ form.absent1[slot])
    return total
