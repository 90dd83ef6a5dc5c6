"""The verbs of the command line that change nothing in a project: they write or show what is there, or make a demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from shapeforge.cli_output import PartlyDone, escaped, follow, print_json
from shapeforge.cli_words import Jobs, Json, Out, ProjectPath, Seed

__all__ = ["VERBS", "write_report"]


def apply(
    path: ProjectPath,
    meshes: Annotated[list[Path], typer.Argument(metavar="MESHES...", help="Mesh files and folders of them.")],
    out: Out,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Label, correspond and describe new shapes with the fitted family, without refitting."""
    from shapeforge import stages_outputs
    from shapeforge.store import Project

    project = Project.open(path)
    latest = follow(project, stages_outputs.apply(project, meshes, out, jobs=jobs), "apply")
    typer.echo(f"apply: {latest.message}")
    if as_json:
        print_json({"verb": "apply", "project": str(path), "out": str(out), "shapes": latest.of})


def export(
    path: ProjectPath,
    out: Out,
    probabilities: Annotated[
        bool,
        typer.Option("--probabilities", help="Also probabilities/<name>.npz, as they are before labels are smoothed."),
    ] = False,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Write labels, corresponding points, groups and descriptors of every shape."""
    from shapeforge import stages_outputs
    from shapeforge.store import Project

    project = Project.open(path)
    steps = stages_outputs.export(project, out, probabilities=probabilities, jobs=jobs)
    latest = follow(project, steps, "export")
    typer.echo(f"export: {latest.message}")
    if as_json:
        print_json({"verb": "export", "project": str(path), "out": str(out), "shapes": latest.of})


def validate(
    path: ProjectPath,
    labels: Annotated[Path | None, typer.Option(help="Folder of true .seg files and labels.json.")] = None,
    landmarks: Annotated[Path | None, typer.Option(help="landmarks.json: {shape: {landmark: \\[x, y, z]}}.")] = None,
    classes: Annotated[Path | None, typer.Option(help="classes.csv: name,class.")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Measure against truth, beside plain affine transfer; shapes that gave evidence are left out."""
    from shapeforge import stages_validation
    from shapeforge.store import Project

    project = Project.open(path)
    steps = stages_validation.validate(
        project, labels=labels, landmarks=landmarks, classes=classes, seed=seed or 0, jobs=jobs
    )
    found = follow(project, steps, "validate").state
    typer.echo(stages_validation.table(found))
    summary = {"verb": "validate", "project": str(path), **found}
    if found.get("undone"):
        raise PartlyDone(found["undone"], summary)
    if as_json:
        print_json(summary)


def report(
    path: ProjectPath,
    out: Annotated[Path, typer.Option(help="HTML file to write.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Write one self-contained page of pictures, plots and figures."""
    from shapeforge.store import Project

    project = Project.open(path)
    written = write_report(project, out)
    typer.echo(f"report: {written}")
    if as_json:
        print_json({"verb": "report", "project": str(path), "out": str(written)})


def write_report(project: Any, out: Path, measures: dict[str, Any] | None = None) -> Path:
    """The report of a project at ``out``, with what ``validate`` measured; errors go to the project's log."""
    from shapeforge.viewer.report import write_report as write

    if out.is_dir():
        raise ValueError(f"{out}: is a folder. Name the file to write: --out {out / 'report.html'}")
    try:
        out.absolute().parent.mkdir(parents=True, exist_ok=True)
        write(project, out, measures=measures)
    except Exception as error:
        project.log(f"report: {error}", error)
        raise
    return out


def info(path: ProjectPath, as_json: Json = False) -> None:
    """Show what is there, what is done or stale, and what comes next."""
    from rich.console import Console
    from rich.table import Table

    from shapeforge import stages
    from shapeforge.collection.counts import counted
    from shapeforge.store import Project

    project = Project.open(path)
    states = stages.status(project)
    problems, groups, parts = project.problems, project.groups, project.part_names
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{project.name}: {counted(len(project.names), 'shape')}", markup=False)
    if groups is not None:
        console.print(f"exemplars: {', '.join(project.names[t] for t in groups.exemplars)}", markup=False)
    if parts is not None:
        console.print(f"parts: {', '.join(parts.names)}", markup=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("stage", "state", "why"):
        table.add_column(column, overflow="fold")
    for stage, status in states.items():
        table.add_row(stage, status.state, escaped(status.reason))
    console.print(table)
    for problem in problems:
        console.print(f"{problem.kind}: {problem}", markup=False)
    console.print(f"next: {stages.next_step(project)}", markup=False)
    if as_json:
        print_json({
            "verb": "info", "project": str(path), "shapes": list(project.names),
            "exemplars": [project.names[t] for t in groups.exemplars] if groups is not None else [],
            "parts": list(parts.names) if parts else [],
            "stages": {stage: {"state": status.state, "reason": status.reason} for stage, status in states.items()},
            "problems": [vars(problem) for problem in problems], "next": stages.next_step(project),
        })  # fmt: skip


def view(path: Annotated[Path | None, typer.Argument(metavar="[PROJECT]", help="Project to open.")] = None) -> None:
    """Open the window."""
    from shapeforge.viewer import open_window

    raise typer.Exit(open_window(path))


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="Folder for the demo's files.")] = Path("demo"),
    family: Annotated[str, typer.Option(help="chairs or airplanes.")] = "chairs",
    count: Annotated[int, typer.Option(min=6, help="How many shapes to generate.")] = 40,
    points: Annotated[int, typer.Option(min=100, help="Samples per shape.")] = 1500,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    jobs: Jobs = None,
    window: Annotated[bool, typer.Option(help="Open the window at the end, if there is a screen.")] = True,
    as_json: Json = False,
) -> None:
    """Run the whole pipeline on a bundled family, then open the window (pictures only without a screen)."""
    from shapeforge.demo import run_demo

    summary = run_demo(folder, family=family, count=count, points=points, seed=seed, jobs=jobs)
    if as_json:
        print_json({"verb": "demo", **summary})
    from shapeforge.viewer import missing_graphics, open_window

    problem = missing_graphics()
    if window and not problem:
        raise typer.Exit(open_window(Path(summary["project"])))
    if window:
        typer.echo(f"No window: {problem}", err=True)


VERBS = (apply, export, validate, report, info, view, demo)
"""In the order of the help."""
