"""The ``shapeforge`` command: one verb per stage, and a few that show or write what is there.

Progress goes to standard error, results to standard output.  The exit status is 0 only when a verb did what it says;
errors are one line, their traceback goes to the project's log.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from shapeforge.cli_output import follow, one_line, print_json, speak_plainly
from shapeforge.cli_results import VERBS
from shapeforge.cli_words import (
    Jobs,
    Json,
    Out,
    ProjectPath,
    Restart,
    Seed,
    named_after_option,
    names_in,
    two_names,
)

app = typer.Typer(
    name="shapeforge", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Understand a family of 3D shapes: groups, parts, correspondences, a generative model, new shapes.",
)  # fmt: skip


def main() -> None:
    """Entry point of the command; ends the process with its exit status."""
    speak_plainly()
    sys.exit(run_command(sys.argv[1:]))


def run_command(arguments: list[str]) -> int:
    """Run one command line (without the program's name); its exit status."""
    status, reason, found = 0, "", {}
    try:
        app(arguments, prog_name="shapeforge")
    except SystemExit as done:
        status = done.code if isinstance(done.code, int) else 0
        reason = {2: "wrong usage: see the help of the verb", 130: "stopped from the keyboard"}.get(status, "failed")
    except KeyboardInterrupt:  # between two steps; those of a stage are caught where they are followed
        print("Stopped. Run the same command again and it goes on.", file=sys.stderr)
        status, reason = 130, "stopped from the keyboard"
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    except Exception as error:  # every failure becomes one line that says what to do
        status, reason, found = 1, one_line(error), getattr(error, "summary", {})
        print(f"error: {reason}", file=sys.stderr)
    if status and "--json" in arguments:
        verb = next((word for word in arguments if not word.startswith("-")), None)
        print_json({"verb": verb, **found, "error": reason})
    return status


def run_stage(
    path: Path, stage: str, as_json: bool, *, create: bool = False, jobs: int | None = None, restart: bool = False,
    **options: Any,
) -> None:  # fmt: skip
    """Run one stage of the project at ``path`` and print what came out."""
    from shapeforge import stages
    from shapeforge.store import Project

    project = Project.open_or_create(path) if create else Project.open(path)
    steps = stages.run(project, stage, jobs=jobs, restart=restart, **options)
    latest = follow(project, steps, stage)
    record = project.stage_record(stage) or {}
    summary = dict(record.get("summary") or {})
    typer.echo(f"{stage}: {latest.message if latest else summary.get('text', 'done')}")
    stale = [name for name, now in stages.status(project).items() if now.state == "stale"]
    redone = [name for name in stale if name != "import"]  # files are read again when that is asked for
    if redone:
        typer.echo(f"stale now, redone when needed: {', '.join(redone)}", err=True)
    typer.echo(f"next: {stages.next_step(project)}", err=True)
    if as_json:
        print_json({
            "verb": stage, "project": str(path), "seconds": record.get("seconds"), **summary, "stale": stale,
        })  # fmt: skip


# -- the stages ------------------------------------------------------------------------------------------------------


@app.command("import")
def import_(
    path: ProjectPath,
    meshes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="MESHES...",
            help="Mesh files and folders of them (obj, off, ply, stl, glb, gltf); none: changed ones anew.",
        ),
    ] = None,
    points: Annotated[int | None, typer.Option(min=100, help="Samples per shape (first run: 5000).")] = None,
    up: Annotated[str | None, typer.Option(help="Which axis is up: auto, x, y, z or keep (first run: auto).")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Read meshes into PROJECT (made if absent): check, orient, sample, describe. Bad files are named and skipped."""
    if up is not None and up not in ("auto", "x", "y", "z", "keep"):
        raise typer.BadParameter(f"--up: wanted auto, x, y, z or keep, got {up!r}")
    run_stage(
        path, "import", as_json, create=True, jobs=jobs, restart=restart, meshes=meshes or None, points=points, up=up,
        seed=seed,
    )  # fmt: skip


@app.command()
def group(
    path: ProjectPath,
    exemplars: Annotated[
        list[str] | None,
        typer.Option(
            "--exemplars", metavar="NAME...", help="Shapes that shall stand for the groups, by hand; auto: found again."
        ),
    ] = None,
    more: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", hidden=True)] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Find groups of similar shapes and an exemplar for each."""
    chosen = named_after_option(exemplars, more, "--exemplars")
    run_stage(path, "group", as_json, jobs=jobs, restart=restart, exemplars=chosen, seed=seed)


@app.command()
def label(
    path: ProjectPath,
    labels: Annotated[Path, typer.Argument(metavar="LABELS", help="Folder with <shape name>.seg and labels.json.")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="exemplars|NAME...", help="Only the exemplars, or only these shapes."),
    ] = None,
    more: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", hidden=True)] = None,
    as_json: Json = False,
) -> None:
    """Take part labels of faces from LABELS, for any shapes or only some."""
    run_stage(path, "label", as_json, labels=labels, only=named_after_option(only, more, "--only"))


@app.command()
def cosegment(
    path: ProjectPath,
    parts: Annotated[int | None, typer.Option(min=2, help="Number of parts (default: found).")] = None,
    merge: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Part B becomes part A (repeatable).")] = None,
    split: Annotated[list[str] | None, typer.Option(metavar="A", help="Part A falls into two (repeatable).")] = None,
    rename: Annotated[list[str] | None, typer.Option(metavar="A=B", help="Call part A B (repeatable).")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Propose first parts automatically, instead of labels; or merge, split and rename (in this order) those there are.

    Edits add to those of earlier runs; another number of parts, another seed or --restart forgets these.
    """
    from shapeforge.stages_collection import edits_of
    from shapeforge.store import Project

    edits = [["merge", *two_names(text, ",", "--merge")] for text in merge or ()]
    edits += [["split", text.strip()] for text in split or ()]
    edits += [["rename", *two_names(text, "=", "--rename")] for text in rename or ()]
    if edits and not restart:
        given = {"parts": parts, "seed": seed}
        edits = edits_of(Project.open(path), *edits, **{name: v for name, v in given.items() if v is not None})
    run_stage(
        path, "cosegment", as_json, jobs=jobs, restart=restart, parts=parts, seed=seed,
        edits=edits if edits or restart else None,
    )  # fmt: skip


@app.command()
def fit(
    path: ProjectPath,
    rounds: Annotated[
        int | None,
        typer.Option(min=1, help="Outer rounds; of several exemplars 7 of 10, then 8 of the family's (first run: 10)."),
    ] = None,
    inner: Annotated[int | None, typer.Option(min=1, help="Inner rounds (first run: 3).")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    warm: Annotated[
        bool, typer.Option("--warm", help="Go on from the present fit with shapes painted otherwise, and new ones.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Fit templates, correspondences and segmentations to all shapes, then the high-level templates."""
    run_stage(
        path, "fit", as_json, jobs=jobs, restart=restart, rounds=rounds, inner=inner, seed=seed, warm=warm or None
    )


@app.command()
def learn(
    path: ProjectPath,
    epochs: Annotated[int | None, typer.Option(min=1, help="Epochs of fine-tuning (default: by size).")] = None,
    train: Annotated[
        list[str] | None, typer.Option(metavar="NAME|FILE", help="Learn from these only; auto: all.")
    ] = None,
    test: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|FILE", help="Judge by these (files: a name a line); auto: a tenth."),
    ] = None,
    curve: Annotated[bool, typer.Option("--curve", help="Also say whether more shapes would help.")] = False,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Learn the Beta Shape Machine of the fitted family."""
    run_stage(
        path, "learn", as_json and not curve, jobs=jobs, restart=restart, epochs=epochs, seed=seed,
        train=names_in(train), test=names_in(test),
    )  # fmt: skip
    if curve:
        from shapeforge import stages_model
        from shapeforge.store import Project

        project = Project.open(path)
        latest = follow(project, stages_model.curve(project, seed=seed or 0, jobs=jobs), "learn")
        typer.echo(latest.message)
        if as_json:
            summary = dict((project.stage_record("learn") or {}).get("summary") or {})
            points = [vars(point) for point in latest.state]
            print_json({"verb": "learn", "project": str(path), **summary, "curve": points, "verdict": latest.message})


@app.command()
def refine(
    path: ProjectPath,
    alternations: Annotated[int | None, typer.Option(min=1, help="Alternations (first run: 3).")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Joint analysis and synthesis: the machine guides the fit, the fit teaches the machine."""
    run_stage(path, "refine", as_json, jobs=jobs, restart=restart, alternations=alternations, seed=seed)


@app.command()
def synthesize(
    path: ProjectPath,
    out: Out,
    count: Annotated[int | None, typer.Option(min=1, help="How many (first run: 20).")] = None,
    format: Annotated[str | None, typer.Option(help="glb, ply, obj or stl (first run: glb).")] = None,
    temperature: Annotated[float | None, typer.Option(help="Below 1 typical shapes, above 1 unusual ones.")] = None,
    route: Annotated[
        str | None,
        typer.Option(help="parts: of training shapes, bent; surface: a new closed one from the points (first: parts)."),
    ] = None,
    union: Annotated[
        bool | None, typer.Option("--union/--no-union", help="Make all parts one closed solid (needs manifold3d).")
    ] = None,
    colours: Annotated[
        str | None, typer.Option(help="parts: one for each; sources: those of the shapes' files (first: parts).")
    ] = None,
    take: Annotated[
        list[str] | None,
        typer.Option(metavar="PART=SHAPE", help="Take this part from that shape (repeatable)."),
    ] = None,
    having: Annotated[
        list[str] | None, typer.Option("--with", metavar="PART", help="All have it (repeatable).")
    ] = None,
    lacking: Annotated[
        list[str] | None, typer.Option("--without", metavar="PART", help="None has it; repeatable.")
    ] = None,
    like: Annotated[str | None, typer.Option(metavar="SHAPE", help="Near this one; temperature says how near.")] = None,
    between: Annotated[str | None, typer.Option(metavar="A,B", help="On the way from one shape to another.")] = None,
    hold: Annotated[
        list[str] | None,
        typer.Option(metavar="LAYER:UNIT=VALUE", help="Hold a unit in 0..1; both count from 1; repeatable."),
    ] = None,
    recipe: Annotated[list[Path] | None, typer.Option(help="Make these again: .recipe.json beside a mesh.")] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    restart: Restart = False,
    as_json: Json = False,
) -> None:
    """Make new labelled meshes.

    What the shapes are to be like (--with, --without, --like, --between, --hold, --take) holds for this run only; all
    other options that are not given stay as in the last run.
    """
    if recipe:
        from shapeforge.collection.counts import counted
        from shapeforge.stages_recipes import remake_files
        from shapeforge.store import Project

        files = remake_files(Project.open(path), recipe, out, format or "glb")
        typer.echo(f"synthesize: {counted(len(files), 'shape')} made again in {out}")
        if as_json:
            names = [str(file) for file in files]
            print_json({"verb": "synthesize", "project": str(path), "out": str(out), "files": names})
        return
    run_stage(
        path, "synthesize", as_json, jobs=jobs, restart=restart, out=str(out.absolute()), count=count, format=format,
        temperature=temperature, having=names_in(having), lacking=names_in(lacking), hold=hold, like=like,
        between=None if between is None else two_names(between, ",", "--between"), take=take, route=route, union=union,
        colours=colours, seed=seed,
    )  # fmt: skip


for verb in VERBS:
    app.command()(verb)


if __name__ == "__main__":
    main()
