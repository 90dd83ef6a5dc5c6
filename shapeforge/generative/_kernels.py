"""Compiled inner loops of learning: serial, no Python objects, GIL released.  Kept away from the type hooks."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def adam_step(parameter, gradient, first, second, rate, decay, step):
    """One Adam update in place of flat arrays (beta1 .9, beta2 .99), with decoupled weight decay ``decay``.

    ``rate`` is the step size, ``step`` counts from 1; ``first`` and ``second`` are the running moments.
    """
    beta1, beta2 = np.float32(0.9), np.float32(0.99)
    scale = np.float32(rate / (1.0 - 0.9**step))
    root = np.float32(1.0 / np.sqrt(1.0 - 0.99**step))
    keep = np.float32(1.0 - rate * decay)
    tiny = np.float32(1e-8)
    one = np.float32(1.0)
    for i in range(parameter.size):
        g = gradient[i]
        m = beta1 * first[i] + (one - beta1) * g
        v = beta2 * second[i] + (one - beta2) * g * g
        first[i] = m
        second[i] = v
        parameter[i] = keep * parameter[i] - scale * m / (np.sqrt(v) * root + tiny)


@njit(cache=True, nogil=True)
def beta_means(both, rest, floor):
    """Means of Betas, and [α, β] in place.  ``both`` (R, 2F) holds W(h-ν) on entry; ``rest`` (2F) is Ā."""
    rows, n = both.shape[0], both.shape[1] // 2
    mean = np.empty((rows, n), both.dtype)
    for r in range(rows):
        for f in range(n):
            a = max(both[r, f] + rest[f], floor)
            b = max(both[r, n + f] + rest[n + f], floor)
            both[r, f] = a
            both[r, n + f] = b
            mean[r, f] = a / (a + b)
    return mean


@njit(cache=True, nogil=True)
def reconstruction_loss(both, rest, target, row_weight, rounding, floor):
    """Sum of sqrt(residual^2 + rounding^2) per row, and its weighted derivative in place of ``both``.

    ``both`` (R, 2F) holds W(h-ν) on entry and d loss / d [α, β] on return; ``rest`` (2F) is Ā; row r is compared with
    ``target`` (B, F) row r mod B and counts ``row_weight[r]``.  Where α or β sits on the floor its derivative is 0.
    Returns the *unweighted* sums per row (R,), in float64.
    """
    rows, n = both.shape[0], both.shape[1] // 2
    batch = target.shape[0]
    sums = np.zeros(rows)
    square = rounding * rounding
    zero = both.dtype.type(0)
    for r in range(rows):
        weight = row_weight[r]
        t = r % batch
        total = 0.0
        if weight == zero:
            both[r] = zero
            continue
        for f in range(n):
            a = both[r, f] + rest[f]
            b = both[r, n + f] + rest[n + f]
            free_a, free_b = a > floor, b > floor
            a = max(a, floor)
            b = max(b, floor)
            inverse = 1 / (a + b)
            residual = a * inverse - target[t, f]
            size = np.sqrt(residual * residual + square)
            total += size
            slope = weight * residual / size * inverse * inverse
            both[r, f] = slope * b if free_a else zero
            both[r, n + f] = -slope * a if free_b else zero
        sums[r] = total
    return sums


@njit(cache=True, nogil=True)
def neighbour_signs(values, start, index, block, signs):
    """For rows of ``values`` (n, F): ``signs`` (n, F) int32 = Σ sign(own - neighbour's) over the neighbours of a row.

    Row i's neighbours are ``index[start[i] : start[i + 1]]``.  ``block`` (n, B) is room for B features at a time, so
    that what is compared lies together in the cache.
    """
    n, n_features = values.shape
    width = block.shape[1]
    for first in range(0, n_features, width):
        stop = min(first + width, n_features)
        size = stop - first
        for i in range(n):
            for f in range(size):
                block[i, f] = values[i, first + f]
        for i in range(n):
            for f in range(size):
                signs[i, first + f] = 0
            for j in range(start[i], start[i + 1]):
                other = index[j]
                for f in range(size):
                    a, b = block[i, f], block[other, f]
                    signs[i, first + f] += np.int32(a > b) - np.int32(a < b)


@njit(cache=True, nogil=True)
def prior_step(parameter, signs, per_sign, sparse):
    """Flat ``parameter`` (n, F) in place: less ``per_sign`` (n,) x signs (n, F), then ``sparse`` closer to 0 (L1)."""
    rows, columns = parameter.shape
    zero = parameter.dtype.type(0)
    for i in range(rows):
        for f in range(columns):
            value = parameter[i, f] - per_sign[i] * signs[i, f]
            parameter[i, f] = max(value - sparse, zero) if value > zero else min(value + sparse, zero)
