"""Numbers of things are written one way everywhere."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import shapeforge
from shapeforge.collection.counts import counted, grouped
from shapeforge.collection.meshes import repair_notes
from shapeforge.collection.shape import Mesh

THINGS = ("face", "triangle", "point", "shape", "file", "corresponding point", "new shape")
"""What there may be thousands of."""


@pytest.mark.parametrize(
    ("number", "words"), [(1, "1 face"), (0, "0 faces"), (999, "999 faces"), (6360, "6\u202f360 faces")]
)
def test_things_are_counted_with_a_thin_space_every_three_digits(number: int, words: str) -> None:
    assert counted(number, "face") == counted(np.int64(number), "face") == words
    assert grouped(1234567) == "1\u202f234\u202f567"


def test_notes_on_a_mesh_count_so() -> None:
    count = 1404
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    triangles = np.array([[0, 1, 2], *[[0, 1, 3]] * count], np.int32)
    mesh = Mesh(vertices, triangles, np.arange(count + 1, dtype=np.int32), count + 1, "")
    assert repair_notes(mesh) == (
        "1\u202f404 faces without area, ignored", "1\u202f403 triangles drawn twice, counted twice"
    )  # fmt: skip


def plain_counts(tree: ast.AST) -> Iterator[int]:
    """Lines of texts that name a number of THINGS without ``counted``: not those of errors, whose readers compare."""
    raised = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Raise) for part in ast.walk(node)}
    for text in (node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) and id(node) not in raised):
        for value, after in zip(text.values, text.values[1:], strict=False):
            plain = isinstance(value, ast.FormattedValue) and "grouped" not in ast.unparse(value.value)
            if (
                plain
                and isinstance(after, ast.Constant)
                and after.value.startswith(tuple(f" {one}s" for one in THINGS))
            ):
                yield text.lineno


def test_no_text_of_the_program_counts_otherwise() -> None:
    root, found = Path(shapeforge.__file__).parent, []
    for path in [*root.glob("*.py"), *root.glob("viewer/**/*.py")]:
        source = path.read_text()
        found += [f"{path.relative_to(root)}:{line}" for line in plain_counts(ast.parse(source))]
        found += [
            f"{path.relative_to(root)}: {one!r}"
            for one in (":,}", ":,.0f}", "\\u2009", "\\u202f", "NO-BREAK SPACE")
            if one in source
        ]
    assert not found
    assert list(plain_counts(ast.parse('f"{n} faces"'))) == [1], "a text that does is found"
