"""Compiled parsing of the text mesh formats: numbers, OBJ records, lists of rows.

Exact: a decimal that the quick path cannot round correctly is handed back (``hard``) for ``float()`` to read.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NEWLINE, SPACE, HASH, LETTER_F, LETTER_V = 10, 32, 35, 102, 118
POWERS = 10.0 ** np.arange(23)  # all exact in binary64
OK, SHORT_VERTEX, BAD_CORNER, BAD_INDEX = 0, 1, 2, 3


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
def count_tokens(text, start):
    """Number of tokens from ``start`` on; ``#`` starts a comment."""
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
    return count


@njit(cache=True, nogil=True)
def parse_numbers(text, start, values, lines, hard):
    """Every token from ``start`` on as a number into ``values`` (n,), n = ``count_tokens``.

    ``lines`` (n,) is the line of each, counted from 0 at ``start``; ``hard`` (n,) where a token begins that ``float()``
    must read, else -1.
    """
    n = len(text)
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
            hard[at] = i if state else -1
            at += 1
            i = end


@njit(cache=True, nogil=True)
def count_obj(text):
    """(vertices, faces, corners) that the lines of an OBJ text announce."""
    n = len(text)
    n_vertices = n_faces = n_corners = 0
    i = 0
    while i < n:
        i = skip_blanks(text, i)
        if i + 1 < n and text[i + 1] <= SPACE:
            if text[i] == LETTER_V:
                n_vertices += 1
            elif text[i] == LETTER_F:
                n_faces += 1
                i = skip_blanks(text, i + 1)
                while i < n and text[i] != NEWLINE:
                    n_corners += 1
                    i = skip_blanks(text, token_end(text, i))
        i = next_line(text, i)
    return n_vertices, n_faces, n_corners


@njit(cache=True, nogil=True)
def parse_obj(text, vertices, hard, corners, counts):
    """Fill vertices (3 V,), corners (C,) as vertex numbers from 0 and counts (F,) of corners per record.

    ``hard`` (3 V,) as in ``parse_numbers``.  Returns an error code and its line (from 1), and how many corners there
    are: comments at the end of a line make it fewer than announced.  Indices are not yet checked against V.
    """
    n = len(text)
    v = f = c = line = i = 0
    error = OK
    while i < n and error == OK:
        line += 1
        i = skip_blanks(text, i)
        letter = text[i] if i + 1 < n and text[i + 1] <= SPACE else 0
        if letter == LETTER_V:
            i += 1
            for _ in range(3):
                i = skip_blanks(text, i)
                if i >= n or text[i] == NEWLINE or text[i] == HASH:
                    error = SHORT_VERTEX
                    break
                end = token_end(text, i)
                vertices[v], state = parse_decimal(text, i, end)
                hard[v] = i if state else -1
                v += 1
                i = end
        elif letter == LETTER_F:
            first = c
            i = skip_blanks(text, i + 1)
            while i < n and text[i] != NEWLINE and text[i] != HASH:
                sign = -1 if text[i] == 45 else 1
                if text[i] == 45 or text[i] == 43:
                    i += 1
                index = 0
                digits = 0
                while i < n and 48 <= text[i] <= 57 and digits < 18:
                    index = index * 10 + (text[i] - 48)
                    digits += 1
                    i += 1
                corners[c] = v // 3 - index if sign < 0 else index - 1
                if digits == 0 or (i < n and text[i] > SPACE and text[i] != 47):
                    error = BAD_CORNER
                    break
                if index == 0 or corners[c] < 0:
                    error = BAD_INDEX
                    break
                c += 1
                i = skip_blanks(text, token_end(text, i))
            counts[f] = c - first
            f += 1
        i = next_line(text, i)
    return error, line, c


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
