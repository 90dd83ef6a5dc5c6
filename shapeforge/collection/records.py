"""Polygon records of OBJ, OFF and PLY files, in the order of the file.

General mesh readers split and reorder faces; labels refer to face records, so these readers keep every record, the
degenerate ones too.  Formats: OBJ (Wavefront, appendix B), OFF (Geomview manual 4.2.5), PLY (Turk 1994).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from shapeforge.collection import _kernels_text as kernels
from shapeforge.collection.materials import as_colours


class MeshError(ValueError):
    """A mesh file that cannot be used: which file, what is wrong, what to do about it."""

    def __init__(self, path: str | Path, problem: str, remedy: str):
        self.path = Path(path)
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{self.path.name or self.path}: {problem}. {remedy}")

    def __reduce__(self):
        # the default would call MeshError(message): errors must survive the way back from a worker process
        return MeshError, (self.path, self.problem, self.remedy)


EXPORT_AGAIN = "Export it again from the program that made it"
CUT_SHORT = "The file was probably cut short: copy or download it again"


@dataclass(frozen=True, eq=False)
class Records:
    """Vertices and face records of a file: record k has ``counts[k]`` corners, one after the other in ``corners``.

    Colours (red, green, blue) are those of the faces and of the vertices, where the file has any.
    """

    vertices: Float[np.ndarray, "V 3"]
    corners: Int[np.ndarray, " C"]
    counts: Int[np.ndarray, " F"]
    face_colours: UInt8[np.ndarray, "F 3"] | None = None
    vertex_colours: UInt8[np.ndarray, "V 3"] | None = None


TOKEN = re.compile(rb"[^\0- ]+")


def _settle(path: Path, data: bytes, values: np.ndarray, hard: np.ndarray) -> None:
    """Fill ``values`` where the quick parser passed on the token at ``hard``; not a number at all is an error."""
    for index in np.flatnonzero(hard >= 0):
        found = TOKEN.match(data, int(hard[index]))
        token = found.group() if found else b""
        try:
            if b"_" in token:  # float() would take 1_000
                raise ValueError
            values[index] = float(token)
        except ValueError:
            word = token[:40].decode("latin-1")
            line = data.count(b"\n", 0, int(hard[index])) + 1
            comma = "Write decimals with a dot, not a comma" if "," in word else EXPORT_AGAIN
            raise MeshError(path, f"line {line} has {word!r} where a number should be", comma) from None


def _numbers(path: Path, data: bytes, start: int) -> tuple[np.ndarray, np.ndarray]:
    """Every number from ``start`` on (n,), and the line of each (n,), from 0."""
    text = np.frombuffer(data, np.uint8)
    n = kernels.count_tokens(text, start)
    values, lines, hard = np.empty(n), np.empty(n, np.int64), np.empty(n, np.int64)
    kernels.parse_numbers(text, start, values, lines, hard)
    _settle(path, data, values, hard)
    return values, lines


def _plain_text(path: Path, data: bytes) -> bytes:
    """The text as bytes of ASCII or a superset of it, without byte order mark."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):  # UTF-16, as some Windows programs write
        data = data.decode("utf-16", "replace").encode()
    if b"\0" in data:  # it would pass for a blank and cut numbers in two
        raise MeshError(path, "it is no text", f"Check that the ending {path.suffix} is right")
    return data.removeprefix(b"\xef\xbb\xbf")


def read_obj(path: Path, data: bytes) -> Records:
    """Records of an OBJ file: vertices ``v``, faces ``f``; everything else (points, lines, groups, ...) is ignored."""
    data = _plain_text(path, data)
    if b"\n" not in data and b"\r" in data:  # line ends of old Macintosh programs
        data = data.replace(b"\r", b"\n")
    if b"\\" in data:  # a line goes on in the next
        data = data.replace(b"\\\r\n", b"  ").replace(b"\\\n", b"  ")
    text = np.frombuffer(data, np.uint8)
    n_vertices, n_faces, n_corners = kernels.count_obj(text)
    if n_vertices == 0 and n_faces == 0:
        raise MeshError(path, "no vertices and no faces: this is no OBJ text", "Check that the ending .obj is right")
    vertices, hard = np.empty(3 * n_vertices), np.full(3 * n_vertices, -1)
    corners, counts = np.empty(n_corners, np.int64), np.empty(n_faces, np.int64)
    error, line, n_corners = kernels.parse_obj(text, vertices, hard, corners, counts)
    if error == kernels.SHORT_VERTEX:
        raise MeshError(path, f"line {line}: a vertex with fewer than 3 coordinates", CUT_SHORT)
    if error == kernels.BAD_CORNER:
        raise MeshError(path, f"line {line}: a face corner that is no vertex number", EXPORT_AGAIN)
    if error == kernels.BAD_INDEX:
        raise MeshError(path, f"line {line}: a face uses a vertex that does not exist", EXPORT_AGAIN)
    _settle(path, data, vertices, hard)
    last = data[data.rfind(b"\n") + 1 :].split()
    if last[:1] == [b"f"] and len(last) < 4:  # a whole file ends its last line; elsewhere such faces keep their number
        line = data.count(b"\n") + 1
        raise MeshError(path, f"line {line}: a face with fewer than 3 corners, where the file ends", CUT_SHORT)
    return Records(vertices.reshape(-1, 3), corners[:n_corners], counts)


# comments and blank lines, then the keyword; counts may follow on the same line, even without a blank (ModelNet)
OFF_KEYWORD = re.compile(rb"(?:\s|#[^\n]*\n)*(?P<prefix>(?:ST)?C?N?)(?P<four>4?)OFF(?P<binary>[ \t]+BINARY)?")
OFF_WITHOUT_KEYWORD = re.compile(rb"(?:\s|#[^\n]*\n)*\d")


def read_off(path: Path, data: bytes) -> Records:
    """Records of a text OFF file: prefixes ST, C, N, 4 are understood, and what they add but colours is skipped."""
    keyword = OFF_KEYWORD.match(data)
    if keyword and keyword["binary"]:
        raise MeshError(path, "binary OFF is not read", "Save it as a text OFF, a PLY or an OBJ file")
    data = _plain_text(path, data)
    keyword = OFF_KEYWORD.match(data)
    if keyword is None and not OFF_WITHOUT_KEYWORD.match(data):
        raise MeshError(path, "it does not begin with OFF", "Check that the ending .off is right")
    values, lines = _numbers(path, data, keyword.end() if keyword else 0)
    if len(values) < 2:
        raise MeshError(path, "the numbers of vertices and faces are missing", CUT_SHORT)
    n_vertices, n_faces = _count(path, values[0]), _count(path, values[1])
    if 3 * n_vertices + n_faces > len(values):
        raise _off_too_short(path, n_vertices, n_faces)
    # rows of numbers after the line of the counts, whose third (of edges) is often left out
    rows = np.flatnonzero(np.diff(lines, prepend=-1) > 0)
    rows = rows[lines[rows] > lines[1]]
    if len(rows) < n_vertices + n_faces or lines[0] != lines[1]:
        return _off_stream(path, values, n_vertices, n_faces, 4 if keyword and keyword["four"] else 3)
    width = np.diff(np.append(rows, len(values)))
    if n_vertices and width[:n_vertices].min() < 3:
        raise MeshError(path, "a vertex with fewer than 3 coordinates", CUT_SHORT)
    vertices = values[rows[:n_vertices, None] + np.arange(3)]
    shades = None
    if keyword and keyword["prefix"] == b"C" and n_vertices and width[:n_vertices].min() >= 6:
        shades = as_colours(values[rows[:n_vertices, None] + np.arange(3, 6)])
    rows, width = rows[n_vertices : n_vertices + n_faces], width[n_vertices : n_vertices + n_faces]
    counts = _whole(path, values[rows])
    if (counts < 0).any() or (counts + 1 > width).any():
        raise MeshError(path, "a face names fewer corners than it announces", CUT_SHORT)
    found = None
    if n_faces and (width - 1 - counts).min() >= 3:
        found = as_colours(values[(rows + 1 + counts)[:, None] + np.arange(3)])
    return Records(vertices, _whole(path, values[_runs(rows + 1, counts)]), counts, found, shades)


def _off_stream(path: Path, values: np.ndarray, n_vertices: int, n_faces: int, width: int) -> Records:
    """OFF whose rows do not each have a line of their own: nothing but the numbers that must be there."""
    start = 3 + width * n_vertices
    if start > len(values):
        raise _off_too_short(path, n_vertices, n_faces)
    begins, counts, end = kernels.walk_lists(values, start, n_faces, np.array([True]), 0)
    if end < 0:
        raise _off_too_short(path, n_vertices, n_faces)
    vertices = values[3:start].reshape(n_vertices, width)[:, :3].copy()
    return Records(vertices, _whole(path, values[_runs(begins, counts)]), counts)


def _off_too_short(path: Path, n_vertices: int, n_faces: int) -> MeshError:
    return MeshError(path, f"it announces {n_vertices} vertices and {n_faces} faces, but has fewer", CUT_SHORT)


def _whole(path: Path, values: np.ndarray) -> np.ndarray:
    """Numbers that must be whole, as integers."""
    bad = ~(np.abs(values) < 2**53) | (values != np.floor(values))
    if bad.any():
        raise MeshError(path, f"a face has {values[bad][0]:g} where a vertex number should be", EXPORT_AGAIN)
    return values.astype(np.int64)


def _count(path: Path, value: float) -> int:
    if not (0 <= value < 2**31 and value == int(value)):
        raise MeshError(path, f"its header announces {value:g} elements", EXPORT_AGAIN)
    return int(value)


def _runs(begins: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """begins[0], begins[0]+1, ... (counts[0] of them), then begins[1], ..."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(begins - (ends - counts), counts)


PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass(frozen=True)
class _Property:
    name: str
    value: str  # numpy code without byte order
    count: str | None  # of a list's length; None: a single number


@dataclass(frozen=True)
class _Element:
    name: str
    rows: int
    properties: tuple[_Property, ...]

    def find(self, *names: str) -> int:
        for i, p in enumerate(self.properties):
            if p.name in names:
                return i
        return -1


def read_ply(path: Path, data: bytes) -> Records:
    """Records of a PLY file: text or binary of either byte order, any properties, any further elements.

    Colours are the properties red, green and blue of its faces or vertices.
    """
    layout, elements, start = _ply_header(path, data)
    if layout == "ascii":
        numbers, start = _numbers(path, data, start)[0], 0
    else:
        numbers = np.frombuffer(data, np.uint8)
    vertices, corners, counts = np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64)
    shades: dict[str, np.ndarray | None] = {}
    read = _ascii_element if layout == "ascii" else _binary_element
    for element in elements:
        wanted = element.find("vertex_indices", "vertex_index") if element.name == "face" else -1
        if element.name == "face" and wanted < 0:
            raise MeshError(path, "its faces have no vertex_indices", EXPORT_AGAIN)
        columns, lists, start = read(path, numbers, start, element, wanted, layout == "binary_big_endian")
        shades[element.name] = _ply_colours(element, columns)
        if element.name == "vertex":
            axes = [element.find(axis) for axis in "xyz"]
            if min(axes) < 0:
                raise MeshError(path, "its vertices have no x, y, z", EXPORT_AGAIN)
            vertices = np.stack([columns[axis] for axis in axes], axis=1).astype(np.float64)
        elif element.name == "face" and lists is not None:
            corners, counts = lists
    return Records(vertices, corners, counts, shades.get("face"), shades.get("vertex"))


def _ply_colours(element: _Element, columns: Mapping[int, np.ndarray]) -> np.ndarray | None:
    """Colours of the rows of an element; None where it has none."""
    found = [element.find(name, f"diffuse_{name}") for name in ("red", "green", "blue")]
    if element.rows == 0 or any(k not in columns for k in found):
        return None
    return as_colours(np.stack([columns[k] for k in found], axis=1), element.properties[found[0]].value)


def _ply_header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    """(layout, elements in order, where the body starts)."""
    if not data.startswith(b"ply"):
        raise MeshError(path, "it does not begin with ply", "Check that the ending .ply is right")
    end = data.find(b"end_header")
    if end < 0:
        raise MeshError(path, "its header has no end", CUT_SHORT)
    # the body begins after this line; line ends may be \n, \r\n or, in old files, \r
    line_end = data.find(b"\n" if b"\n" in data[:end] else b"\r", end)
    start = len(data) if line_end < 0 else line_end + 1
    layout, elements = "", []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        try:
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format":
                layout = words[1]
            elif words[0] == "element":
                elements.append(_Element(words[1], _count(path, float(words[2])), ()))
            elif words[0] == "property":
                if words[1] == "list":
                    new = _Property(words[4], PLY_TYPES[words[3]], PLY_TYPES[words[2]])
                else:
                    new = _Property(words[2], PLY_TYPES[words[1]], None)
                last = elements[-1]
                elements[-1] = _Element(last.name, last.rows, (*last.properties, new))
        except (IndexError, KeyError, ValueError) as error:
            if isinstance(error, MeshError):
                raise
            raise MeshError(path, f"its header has the line {line.strip()[:60]!r}", EXPORT_AGAIN) from None
    if layout not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise MeshError(path, f"its header names the unknown format {layout!r}", EXPORT_AGAIN)
    return layout, elements, start


def _too_short(path: Path, element: _Element) -> MeshError:
    return MeshError(path, f"it announces {element.rows} rows of {element.name}, but has fewer", CUT_SHORT)


def _ascii_element(path: Path, values: np.ndarray, start: int, element: _Element, wanted: int, _: bool):
    """({property: column} of single numbers, (corners, counts) of the wanted list, start of the next element)."""
    is_list = np.array([p.count is not None for p in element.properties], bool)
    width = len(is_list)
    if element.rows == 0 or width == 0:
        return dict.fromkeys(range(width), np.empty(0)), None, start
    if element.rows > len(values) - start:  # before room is made for them
        raise _too_short(path, element)
    if not is_list.any():
        end = start + element.rows * width
        if end > len(values):
            raise _too_short(path, element)
        return dict(enumerate(values[start:end].reshape(element.rows, width).T)), None, end
    begins, counts, end = kernels.walk_lists(values, start, element.rows, is_list, wanted)
    if end < 0:
        raise _too_short(path, element)
    _no_lists_at_vertices(path, element)
    columns = {}
    if wanted >= 0 and is_list.sum() == 1:
        columns = {k: values[begins - 1 - (wanted - k) if k < wanted else begins + counts + k - wanted - 1]
                   for k in range(width) if k != wanted}  # fmt: skip
    return columns, (_whole(path, values[_runs(begins, counts)]), counts) if wanted >= 0 else None, end


def _binary_element(path: Path, data: np.ndarray, start: int, element: _Element, wanted: int, big: bool):
    """As ``_ascii_element`` for bytes."""
    order = ">" if big else "<"
    properties = element.properties
    if element.rows == 0 or not properties:
        return dict.fromkeys(range(len(properties)), np.empty(0)), None, start
    if element.rows > len(data) - start:  # before room is made for them
        raise _too_short(path, element)
    if all(p.count is None for p in properties):
        row = np.dtype([(str(i), order + p.value) for i, p in enumerate(properties)])
        end = start + element.rows * row.itemsize
        if end > len(data):
            raise _too_short(path, element)
        table = data[start:end].view(row)
        return {i: table[str(i)] for i in range(len(properties))}, None, end
    if any(p.count is not None and p.count[0] == "f" for p in properties):
        raise MeshError(path, "a list whose length is not an integer", EXPORT_AGAIN)
    count_size = np.array([int(p.count[1]) if p.count else 0 for p in properties])
    value_size = np.array([int(p.value[1]) for p in properties])
    begins, counts, end = kernels.walk_lists_binary(data, start, element.rows, count_size, value_size, big, wanted)
    if end < 0:
        raise _too_short(path, element)
    _no_lists_at_vertices(path, element)
    if wanted < 0:
        return {}, None, end
    corners = data[_runs(begins, counts * value_size[wanted])].view(order + properties[wanted].value)
    columns = {}
    if np.count_nonzero(count_size) == 1:
        ends = begins + counts * value_size[wanted]
        for k in (k for k in range(len(properties)) if k != wanted):
            before = begins - count_size[wanted] - value_size[k:wanted].sum()
            place = before if k < wanted else ends + value_size[wanted + 1 : k].sum()
            columns[k] = data[place[:, None] + np.arange(value_size[k])].view(order + properties[k].value)[:, 0]
    return columns, (_whole(path, corners), counts), end


def _no_lists_at_vertices(path: Path, element: _Element) -> None:
    if element.name == "vertex":
        raise MeshError(path, "its vertices have list properties", "Save it without lists at the vertices")
