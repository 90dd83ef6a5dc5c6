"""Compiled parsing of the text mesh formats: numbers, OBJ records, lists of rows.

Exact: a decimal that the quick path cannot round correctly is handed back (``hard``) for ``float()`` to read.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NEWLINE, SPACE, HASH = 10, 32, 35
POWERS = 10.0 ** np.arange(23)  # all exact in binary64
OK, BAD_NUMBER, SHORT_VERTEX, BAD_CORNER, BAD_INDEX = 0, 1, 2, 3, 4


@njit(cache=True, nogil=True)
def token_end(text, i):
    """End of the token that starts at ``i``."""
    n = len(text)
    while i < n and text[i] > SPACE:
        i += 1
    return i


@njit(cache=True, nogil=True)
def skip_blanks(text, i):
    """First position from ``i`` that is no blank of this line."""
    n = len(text)
    while i < n and text[i] <= SPACE and text[i] != NEWLINE:
        i += 1
    return i


@njit(cache=True, nogil=True)
def next_line(text, i):
    """Start of the line after the one that holds ``i``."""
    n = len(text)
    while i < n and text[i] != NEWLINE:
        i += 1
    return min(i + 1, n)


@njit(cache=True, nogil=True)
def parse_decimal(text, i, end):
    """(value, state) of the token ``text[i:end]``: state 0 exact, 1 let ``float()`` decide.

    At most 15 digits and a power of ten up to 22 give the correctly rounded value with one operation.
    """
    negative = False
    if i < end and (text[i] == 45 or text[i] == 43):
        negative = text[i] == 45
        i += 1
    mantissa = 0
    digits = 0
    scale = 0
    seen = False
    after_dot = False
    while i < end:
        c = text[i]
        if 48 <= c <= 57:
            seen = True
            if digits < 18:
                mantissa = mantissa * 10 + (c - 48)
                if mantissa > 0:
                    digits += 1
                if after_dot:
                    scale -= 1
            else:
                return 0.0, 1
        elif c == 46 and not after_dot:
            after_dot = True
        else:
            break
        i += 1
    if not seen:
        return 0.0, 1
    if i < end:
        if text[i] != 101 and text[i] != 69:
            return 0.0, 1
        i += 1
        negative_exponent = False
        if i < end and (text[i] == 45 or text[i] == 43):
            negative_exponent = text[i] == 45
            i += 1
        if i >= end or end - i > 4:
            return 0.0, 1
        exponent = 0
        while i < end:
            c = text[i]
            if c < 48 or c > 57:
                return 0.0, 1
            exponent = exponent * 10 + (c - 48)
            i += 1
        scale += -exponent if negative_exponent else exponent
    value = float(mantissa)
    if mantissa != 0:
        if digits > 15 or scale > 22 or scale < -22:
            return 0.0, 1
        value = value * POWERS[scale] if scale >= 0 else value / POWERS[-scale]
    return (-value if negative else value), 0


@njit(cache=True, nogil=True)
def parse_numbers(text, start):
    """Every token from ``start`` on as a number; ``#`` starts a comment.

    Returns values (n,), line of each value counted from 0 at ``start`` (n,), and rows (value, from, to) of the
    tokens that ``float()`` must read.
    """
    n = len(text)
    count = 0
    i = start
    while i < n:
        if text[i] <= SPACE:
            i += 1
        elif text[i] == HASH:
            i = next_line(text, i)
        else:
            count += 1
            i = token_end(text, i)
    values = np.empty(count)
    lines = np.empty(count, np.int64)
    hard = np.empty((64, 3), np.int64)
    n_hard = 0
    line = 0
    at = 0
    i = start
    while i < n:
        if text[i] == NEWLINE:
            line += 1
            i += 1
        elif text[i] <= SPACE:
            i += 1
        elif text[i] == HASH:
            i = next_line(text, i)
            line += 1
        else:
            end = token_end(text, i)
            values[at], state = parse_decimal(text, i, end)
            lines[at] = line
            if state:
                if n_hard == len(hard):
                    grown = np.empty((2 * n_hard, 3), np.int64)
                    grown[:n_hard] = hard
                    hard = grown
                hard[n_hard, 0], hard[n_hard, 1], hard[n_hard, 2] = at, i, end
                n_hard += 1
            at += 1
            i = end
    return values, lines, hard[:n_hard]


@njit(cache=True, nogil=True)
def parse_obj(text):
    """Vertices and face records of an OBJ text.

    Returns vertices (V, 3), corners (C,) as vertex indices from 0, counts (F,) of corners per record, hard tokens
    (rows value, from, to), and an error (code, line from 1).  Indices are not yet checked against V.
    """
    n = len(text)
    n_vertices = n_faces = n_corners = 0
    i = 0
    while i < n:
        i = skip_blanks(text, i)
        if i + 1 < n and text[i + 1] <= SPACE:
            if text[i] == 118:
                n_vertices += 1
            elif text[i] == 102:
                n_faces += 1
                i += 1
                while True:
                    i = skip_blanks(text, i)
                    if i >= n or text[i] == NEWLINE:
                        break
                    n_corners += 1
                    i = token_end(text, i)
        i = next_line(text, i)
    vertices = np.empty((n_vertices, 3))
    corners = np.empty(n_corners, np.int64)
    counts = np.empty(n_faces, np.int64)
    hard = np.empty((64, 3), np.int64)
    n_hard = v = f = c = line = 0
    i = 0
    while i < n:
        line += 1
        i = skip_blanks(text, i)
        if i + 1 < n and text[i + 1] <= SPACE and (text[i] == 118 or text[i] == 102):
            is_vertex = text[i] == 118
            i += 1
            if is_vertex:
                for axis in range(3):
                    i = skip_blanks(text, i)
                    if i >= n or text[i] == NEWLINE or text[i] == HASH:
                        return vertices[:v], corners[:c], counts[:f], hard[:n_hard], SHORT_VERTEX, line
                    end = token_end(text, i)
                    vertices[v, axis], state = parse_decimal(text, i, end)
                    if state:
                        if n_hard == len(hard):
                            grown = np.empty((2 * n_hard, 3), np.int64)
                            grown[:n_hard] = hard
                            hard = grown
                        hard[n_hard, 0], hard[n_hard, 1], hard[n_hard, 2] = 3 * v + axis, i, end
                        n_hard += 1
                    i = end
                v += 1
            else:
                first = c
                while True:
                    i = skip_blanks(text, i)
                    if i >= n or text[i] == NEWLINE or text[i] == HASH:
                        break
                    negative = text[i] == 45
                    if negative or text[i] == 43:
                        i += 1
                    index = 0
                    digits = 0
                    while i < n and 48 <= text[i] <= 57 and digits < 18:
                        index = index * 10 + (text[i] - 48)
                        digits += 1
                        i += 1
                    if digits == 0 or (i < n and text[i] > SPACE and text[i] != 47):
                        return vertices[:v], corners[:c], counts[:f], hard[:n_hard], BAD_CORNER, line
                    corners[c] = v - index if negative else index - 1
                    if index == 0 or corners[c] < 0:
                        return vertices[:v], corners[:c], counts[:f], hard[:n_hard], BAD_INDEX, line
                    c += 1
                    i = token_end(text, i)
                counts[f] = c - first
                f += 1
        i = next_line(text, i)
    return vertices[:v], corners[:c], counts[:f], hard[:n_hard], OK, line


@njit(cache=True, nogil=True)
def walk_lists(values, start, n_rows, is_list, wanted):
    """Rows of an ASCII element with list properties.

    ``is_list`` (n_properties,) tells lists from single numbers.  Returns where the ``wanted`` list of each row starts
    (n_rows,), its length (n_rows,), and the end; the end is -1 when the numbers run out.
    """
    begins = np.zeros(n_rows, np.int64)
    counts = np.zeros(n_rows, np.int64)
    at = start
    for row in range(n_rows):
        for k in range(len(is_list)):
            if at >= len(values):
                return begins, counts, -1
            if is_list[k]:
                if not 0 <= values[at] < len(values) - at:
                    return begins, counts, -1
                length = int(values[at])
                if k == wanted:
                    begins[row] = at + 1
                    counts[row] = length
                at += 1 + length
            else:
                at += 1
    return begins, counts, at


@njit(cache=True, nogil=True)
def walk_lists_binary(data, start, n_rows, count_size, value_size, big_endian, wanted):
    """As ``walk_lists`` in bytes: ``count_size`` (n_properties,) is 0 for single numbers of ``value_size`` bytes."""
    begins = np.zeros(n_rows, np.int64)
    counts = np.zeros(n_rows, np.int64)
    n = len(data)
    at = start
    for row in range(n_rows):
        for k in range(len(count_size)):
            if count_size[k] == 0:
                at += value_size[k]
                continue
            size = count_size[k]
            if at + size > n:
                return begins, counts, -1
            length = 0
            for b in range(size):
                byte = int(data[at + b])
                length |= byte << (8 * (size - 1 - b) if big_endian else 8 * b)
            at += size
            if length < 0 or length * value_size[k] > n - at:
                return begins, counts, -1
            if k == wanted:
                begins[row] = at
                counts[row] = length
            at += length * value_size[k]
        if at > n:
            return begins, counts, -1
    return begins, counts, at
