"""What can be done now and why not, and how far each place is: read from the Session's project, no Qt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from shapeforge.viewer.session import Session

if TYPE_CHECKING:
    from shapeforge.stages_status import Corrections

Verdict = tuple[bool, str]
YES: Verdict = (True, "")

_status_read: WeakKeyDictionary[Any, tuple[int, dict[str, Any]]] = WeakKeyDictionary()
_corrections_read: WeakKeyDictionary[Any, tuple[int, Any]] = WeakKeyDictionary()


def stage_status(session: Session) -> Mapping[str, Any]:
    """``stages.status`` of the project, asked again only when its data changed; empty without a project."""
    project = session.project
    if project is None:
        return {}
    kept = _status_read.get(project)
    if kept is None or kept[0] != session.revision:
        from shapeforge import stages

        kept = _status_read[project] = (session.revision, dict(stages.status(project)))
    return kept[1]


def needs_project(session: Session) -> Verdict:
    """A project is open."""
    return YES if session.project is not None else (False, "Open a project first.")


def needs_rest(session: Session) -> Verdict:
    """A project is open and nothing runs."""
    if session.project is None:
        return needs_project(session)
    if session.running:
        return False, f"Wait until {session.stage or 'the present stage'} is done, or stop it."
    return YES


QUALITIES: dict[str, dict[str, int]] = {
    "draft": {"rounds": 4, "inner": 2}, "normal": {"rounds": 10, "inner": 3}, "fine": {"rounds": 20, "inner": 3}
}  # fmt: skip
"""How well a fit is done: its options."""


def fit_options(session: Session) -> dict[str, int]:
    """Options of the next fit: those of the quality chosen, else none (then those of the last run count)."""
    return dict(QUALITIES.get(session.quality, {}))


def chosen_quality(session: Session) -> str:
    """The quality of the next fit: the one chosen, else that of the last run; "" when its options are of none."""
    if session.quality or session.project is None:
        return session.quality
    record = session.project.stage_record("fit")
    if record is None:
        return "normal"
    last = record.get("options", {})
    return next((name for name, options in QUALITIES.items() if options.items() <= last.items()), "")


def other_quality(session: Session) -> bool:
    """Whether the next fit is to be done otherwise than the last one was."""
    record = session.project.stage_record("fit") if session.project is not None else None
    return record is not None and not fit_options(session).items() <= record.get("options", {}).items()


def painted_exemplars(session: Session) -> int:
    """How many exemplars a fit has templates from: those painted, or all while the parts are proposed ones."""
    groups = groups_of(session)
    if groups is None:
        return 0
    if starts_from_proposal(session):
        return len(groups.exemplars)
    return len(groups.exemplars) - len(unpainted_exemplars(session))


def planned_rounds(session: Session, rounds: int | None = None) -> int:
    """Rounds that the next fit will have (``rounds``: its option; None: as chosen, or as the last fit had it).

    The family's own templates get theirs after those of several exemplars.
    """
    from shapeforge.deformation import fit

    if rounds is None:
        record = session.project.stage_record("fit") or {}
        last = record.get("options", {}).get("rounds", QUALITIES["normal"]["rounds"])
        rounds = fit_options(session).get("rounds", last)
    return fit.planned_rounds(rounds, painted_exemplars(session))


def rounds_text(session: Session, rounds: int) -> str:
    """Rounds of a fit with the option ``rounds``, and whose they are."""
    from shapeforge.deformation import fit

    whole, first = planned_rounds(session, rounds), fit.exemplar_rounds(rounds)
    if painted_exemplars(session) < 2 or whole == first:
        return f"{whole} rounds"
    return f"{whole} rounds ({first} of the exemplars' templates, {whole - first} of the family's)"


def corrected(session: Session) -> Corrections:
    """The shapes that changed since the fit, and why it cannot be taken up again with them ("": it can).

    Asked again only when the project's data changed: exemplars that were painted otherwise are read for it.
    """
    from shapeforge import stages_status

    project = session.project
    kept = _corrections_read.get(project)
    if kept is None or kept[0] != session.revision:
        kept = _corrections_read[project] = (session.revision, stages_status.corrections(project))
    return kept[1]


_groups_read: WeakKeyDictionary[Any, tuple[Any, Any]] = WeakKeyDictionary()


def groups_of(session: Session) -> Any:
    """The project's groups (None without), read from disk only when they changed."""
    project = session.project
    if project is None:
        return None
    stamp = (project.groups_key, project.names, session.revision)  # a name is no part of the key
    kept = _groups_read.get(project)
    if kept is None or kept[0] != stamp:
        kept = _groups_read[project] = (stamp, project.groups)
    return kept[1]


def unpainted_exemplars(session: Session) -> tuple[str, ...]:
    """Names of the exemplars without any labels."""
    project = session.project
    groups = groups_of(session)
    if groups is None:
        return ()
    labelled = set(project.labelled)
    return tuple(project.names[i] for i in groups.exemplars if project.names[i] not in labelled)


def next_to_paint(session: Session) -> str | None:
    """The first exemplar without labels, None when all are painted."""
    names = unpainted_exemplars(session)
    return names[0] if names else None


def starts_from_proposal(session: Session) -> bool:
    """Whether the next fit starts from proposed parts: then no exemplar has to be painted."""
    from shapeforge import stages_status

    return session.project is not None and stages_status.starts_from_proposal(session.project)


def next_step(session: Session) -> tuple[str, str]:
    """The action that brings the family on from where it is, and what a button for it says."""
    status = stage_status(session)

    def is_done(stage: str) -> bool:
        return stage in status and status[stage].state == "done"

    if not session.project.names:
        return "import_files", "Import shapes…"
    if groups_of(session) is None:
        return "group", "Group the shapes"
    upcoming = None if starts_from_proposal(session) else next_to_paint(session)
    if upcoming is not None:
        return "paint_next", f"Paint {upcoming}"
    if not is_done("fit"):
        return "go_fit", "Fit the family"
    if is_done("learn"):
        return "go_synthesize", "Make new shapes"
    return (
        ("learn", "Learn the family") if session.place == "correspondence" else ("go_correspondence", "Compare points")
    )


def stage_verdict(session: Session, stage: str) -> Verdict:
    """Whether a stage can be run now and, when not, why not."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    status = stage_status(session).get(stage)
    if status is not None and status.state == "locked":
        return False, status.reason
    return YES


def place_verdict(session: Session, place: str) -> Verdict:
    """Whether a place can be entered and, when not, why not."""
    if session.project is None:
        return needs_project(session)
    status = stage_status(session)
    if place == "collection":
        return YES
    if place == "paint":
        return YES if session.project.names else (False, "Import shapes first.")
    if place == "fit":
        found = status.get("fit")
        return (False, found.reason) if found is not None and found.state == "locked" else YES
    needed = {"correspondence": ("fit", "Fit the family first."), "synthesize": ("learn", "Learn the family first.")}
    stage, why = needed[place]
    found = status.get(stage)
    if place == "synthesize" and session.project.machine() is None and (found is None or found.state == "locked"):
        return False, (found.reason if found else why)
    if place == "correspondence" and not session.project.fit_names:
        return False, why
    return YES


def place_mark(session: Session, place: str) -> tuple[str, str]:
    """Mark of a place in the rail ("done", "running", "stale", "locked" or ""), and the sentence that explains it."""
    own = {"collection": ("import", "group"), "paint": ("label", "cosegment"), "fit": ("fit",),
           "correspondence": (), "synthesize": ("learn", "refine", "synthesize")}[place]  # fmt: skip
    if session.running and session.stage in own:
        return "running", f"{session.stage} is running"
    can, why = place_verdict(session, place)
    if not can:
        return "locked", why
    status = stage_status(session)
    if place == "paint":
        groups = groups_of(session)
        left = unpainted_exemplars(session)
        if groups is None:
            return "", ""
        return ("done", "Every exemplar is painted") if not left else ("", f"{len(left)} exemplars to paint")
    stage = {"collection": "group", "fit": "fit", "correspondence": "fit", "synthesize": "learn"}[place]
    found = status.get(stage)
    if found is None:
        return "", ""
    if found.state == "done":
        return "done", "Done"
    if found.state == "stale":
        return "stale", found.reason
    return "", found.reason


def group_of(session: Session, name: str | None) -> int:
    """Number of the group of a shape; -1 when it has none (left out, or nothing is grouped)."""
    groups = groups_of(session)
    if groups is None or name not in session.project.names:
        return -1
    return int(groups.group[session.project.names.index(name)])
