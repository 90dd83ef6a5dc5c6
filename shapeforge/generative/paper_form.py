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

    ``bias1`` (M,) is w[m,0] and so on.  ``absent1`` (M,) is added to w[m,0] of a part's units where the part is absent,
    and ``existence_top`` (L, O) couples E to H3: both are ours, and zero in the print.
    """

    on: tuple[Float[np.ndarray, "2 _ _"], ...]
    off: tuple[Float[np.ndarray, "2 _ _"], ...]
    base: tuple[Float[np.ndarray, "2 _"], ...]
    bias1: Float[np.ndarray, " M"]
    absent1: Float[np.ndarray, " M"]
    weights12: Float[np.ndarray, "M N"]
    bias2: Float[np.ndarray, " N"]
    weights23: Float[np.ndarray, "N O"]
    bias3: Float[np.ndarray, " O"]
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
        base.append(rest - weight @ machine.centre1[slot] - negative.sum(axis=2))
        pull.append(np.einsum("sfm,sf->m", weight, centre))
    absent1 = np.concatenate(pull)
    return PaperForm(
        on=tuple(on), off=tuple(off), base=tuple(base),
        bias1=machine.bias1 - absent1 - machine.weights12 @ machine.centre2,
        absent1=absent1,
        weights12=machine.weights12,
        bias2=machine.bias2 - machine.centre1 @ machine.weights12 - machine.weights23 @ machine.centre3,
        weights23=machine.weights23,
        bias3=machine.bias3 - machine.centre2 @ machine.weights23 - machine.existence_centre @ machine.existence_top,
        existence_top=machine.existence_top,
    )  # fmt: skip


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
        rest.append(base + off.sum(axis=2) + weight @ like.centre1[slot])
        pull.append(np.einsum("sfm,sf->m", weight, centre))
    return replace(
        like,
        weights=tuple(weights), rest=tuple(rest), weights12=form.weights12, weights23=form.weights23,
        existence_top=form.existence_top,
        bias1=form.bias1 + np.concatenate(pull) + form.weights12 @ like.centre2,
        bias2=form.bias2 + like.centre1 @ form.weights12 + form.weights23 @ like.centre3,
        bias3=form.bias3 + like.centre2 @ form.weights23 + like.existence_centre @ form.existence_top,
    )  # fmt: skip


def log_unnormalized_as_printed(
    form: PaperForm, machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"],
    hidden: Hidden,
) -> Float[np.ndarray, " n"]:  # fmt: skip
    """Eq. 2 literally (n,), without its structure terms; ``machine`` only tells which points and units a part has."""
    first, second, third = hidden
    total = first @ form.bias1 + second @ form.bias2 + third @ form.bias3
    total = total + np.einsum("nm,mo,no->n", first, form.weights12, second)
    total = total + np.einsum("nm,mo,no->n", second, form.weights23, third)
    total = total + np.einsum("nl,lo,no->n", exists.astype(float), form.existence_top, third)
    for index, slot in enumerate(machine.units_of_part):
        h = first[:, slot]
        exponent = (
            form.base[index] - 1
            + np.einsum("sfm,nm->nsf", form.on[index], h)
            + np.einsum("sfm,nm->nsf", form.off[index], 1 - h)
        )  # fmt: skip
        geometry = np.einsum("nsf,nsf->n", exponent, log_features(machine.coordinates(values, index)))
        total = total + np.where(exists[:, index], geometry, h @ form.absent1[slot])
    return total
