"""The demonstration: a generated family through the whole pipeline, with truth to measure against."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

SYNTHESIZED = 24
ROUNDS = 8


def run_demo(
    folder: Path, *, family: str, count: int, points: int, seed: int, jobs: int | None = None
) -> dict[str, Any]:
    """Generate a family in ``folder/family``, analyse it in ``folder/project``, write results beside them.

    Labels are given for the exemplars only; everything else is measured against the truth.  Run again, it goes on.
    """
    from shapeforge import stages, stages_outputs, stages_validation
    from shapeforge.cli_output import follow, one_line
    from shapeforge.cli_results import write_report
    from shapeforge.collection.families import write_family
    from shapeforge.store import Project

    begin = time.monotonic()
    truth = folder / "family"
    if not (truth / "classes.csv").is_file():
        write_family(truth, family, count, seed=seed)
    typer.echo(f"{family}: {len(list(truth.glob('*.obj')))} generated shapes with labels and landmarks in {truth}")
    project = Project.open_or_create(folder / "project")

    def step(stage: str, **options: Any) -> None:
        latest = follow(project, stages.run(project, stage, jobs=jobs, **options), stage)
        typer.echo(f"{stage}: {latest.message}")

    step("import", meshes=[truth], points=points, up="keep", seed=seed)
    step("group", seed=seed)
    step("label", labels=truth, only="exemplars")
    step("fit", rounds=ROUNDS, seed=seed)
    step("learn", seed=seed)
    step("synthesize", count=SYNTHESIZED, out=str((folder / "synthesized").absolute()), seed=seed)

    def follow_output(steps: Iterator[Any], what: str) -> Any:
        latest = follow(project, steps, what)
        typer.echo(f"{what}: {latest.message}")
        return latest.state

    follow_output(stages_outputs.export(project, folder / "export", jobs=jobs), "export")
    measured = follow_output(
        stages_validation.validate(
            project, labels=truth, landmarks=truth / "landmarks.json", classes=truth / "classes.csv", seed=seed,
            jobs=jobs,
        ),
        "validate",
    )  # fmt: skip
    typer.echo(stages_validation.table(measured))
    summary = {"folder": str(folder), "project": str(project.path), "validation": measured}
    try:
        summary["report"] = str(write_report(project, folder / "report.html", measured))
        typer.echo(f"report: {summary['report']}")
    except Exception as error:  # pictures need GL; all the rest is there without them
        typer.echo(f"report: not written: {one_line(error)}", err=True)
        summary["report"] = None
    summary["seconds"] = round(time.monotonic() - begin, 1)
    typer.echo(f"Done in {summary['seconds']:.0f} s. Look at it: shapeforge view {project.path}")
    return summary
