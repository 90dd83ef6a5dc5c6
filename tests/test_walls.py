"""The walls of the house: who may import whom, what an import loads, which names are not used, ruff is content."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = REPOSITORY / "shapeforge"
ROOMS = ("collection", "deformation", "generative", "synthesis", "validation", "store", "stages", "viewer")
"""From left to right: a room imports only from rooms to its left."""
FACES = ("__init__", "cli", "cli_output", "cli_results", "cli_words", "demo")
"""Modules that import any room, the viewer lazily."""
FORBIDDEN = {"utils", "helpers", "common", "base", "core", "manager", "config", "types"}
QT = {"PySide6", "qtpy", "superqt", "qtawesome", "pyqtgraph"}
WINDOW = QT | {"pyvista", "pyvistaqt", "vtk", "vtkmodules", "ipywidgets"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def room_of(module: str) -> str:
    """The room that a dotted module name belongs to: ``stages_model`` and ``workers`` are of ``stages``."""
    first = module.split(".")[1] if "." in module else "__init__"
    if first == "workers":
        return "stages"
    return next((room for room in ("store", "stages") if first.startswith(room)), first)


def name_of(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path) -> list[tuple[str, bool]]:
    """(module, whether at import time) of every import, relative ones resolved."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    lazy = {
        id(inner) for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        for inner in ast.walk(node)
    }  # fmt: skip
    package = name_of(path) if path.name == "__init__.py" else name_of(path).rpartition(".")[0]
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, id(node) not in lazy) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            found += [(f"{module}.{alias.name}", id(node) not in lazy) for alias in node.names]
    return found


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_room_imports_only_from_rooms_to_its_left(path: Path) -> None:
    here = room_of(name_of(path))
    if here in FACES:
        return
    assert here in ROOMS, f"{path} is in no room"
    allowed = ROOMS[: ROOMS.index(here) + 1]
    for module, _ in imports_of(path):
        if module.startswith("shapeforge.") and module != "shapeforge.__version__":
            assert room_of(module) in allowed, f"{name_of(path)} imports {module}, to its right"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_window_libraries_stay_in_the_viewer(path: Path) -> None:
    if room_of(name_of(path)) == "viewer":
        return
    used = {module.split(".")[0] for module, _ in imports_of(path)}
    assert used.isdisjoint(WINDOW)
    at_once = [module for module, now in imports_of(path) if now and module.startswith("shapeforge.viewer")]
    assert at_once == [], "the viewer is imported lazily"


def test_nothing_is_unpickled() -> None:
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        assert "allow_pickle=True" not in text, path
        assert not {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"} & {
            module.split(".")[0] for module, _ in imports_of(path)
        }, path


def loaded_by(statement: str) -> set[str]:
    """Top-level modules that a statement loads in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import shapeforge",
        "import shapeforge; [getattr(shapeforge, name) for name in shapeforge.__all__]",
        "import shapeforge.cli",
        "import shapeforge.stages_import, shapeforge.stages_collection, shapeforge.stages_model",
        "import shapeforge.stages_synthesis",
    ],
)
def test_no_import_loads_a_window(statement: str) -> None:
    assert loaded_by(statement).isdisjoint(WINDOW)


def test_the_public_face_is_complete() -> None:
    import shapeforge

    assert set(shapeforge.__all__) <= set(dir(shapeforge))
    for name in shapeforge.__all__:
        assert getattr(shapeforge, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        shapeforge.nonsense  # noqa: B018


def test_no_room_for_everything() -> None:
    names = {part for path in MODULES for part in path.relative_to(PACKAGE).with_suffix("").parts}
    assert names.isdisjoint(FORBIDDEN)


@pytest.mark.parametrize("path", [p for p in MODULES if p.name.startswith("_kernels")], ids=name_of)
def test_kernels_run_anywhere(path: Path) -> None:
    """Compiled kernels release the interpreter's lock and start no threads of their own (those abort in threads)."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("njit"):
            given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            assert given.get("parallel", "False") == "False", f"{path.name}:{node.lineno}"


def test_every_public_function_says_what_it_does() -> None:
    silent = []
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if path.stem != "__init__" and ast.get_docstring(tree) is None:
            silent.append(name_of(path))
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                if ast.get_docstring(node) is None and not path.name.startswith("_kernels"):
                    silent.append(f"{name_of(path)}.{node.name}")
    assert silent == []


def test_ruff_is_content() -> None:
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--output-format", "concise", str(REPOSITORY)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=REPOSITORY)
    assert done.returncode == 0, done.stdout + done.stderr
