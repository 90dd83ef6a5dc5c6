"""The strip of the Fit place: run, pause, step and stop, how far it is, and the scrubber over the rounds."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QWidget

from shapeforge.stages_status import Corrections
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.fit_record import FitRecord
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.fit_widgets import Scrubber
from shapeforge.viewer.qt.icons import set_icon
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.widgets import ElidedLabel, column, label, row, set_style, shortened
from shapeforge.viewer.readiness import corrected, other_quality, planned_rounds, stage_status
from shapeforge.viewer.runner import duration
from shapeforge.viewer.session import Session


class CorrectionFoot(QWidget):
    """Correct the selected shape by painting; then, as long as something changed since the fit, refit from here.

    Where a fit has to begin at the start this is offered instead, and why.
    """

    def __init__(self, session: Session, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.session = session
        self.correct = action_button(actions, "correct", binding)
        self.refit = action_button(actions, "refit", binding, kind="primary")
        self.anew = action_button(actions, "fit", binding, text="Fit from the start")
        self.words = label("", "caption", wrap=True)
        self.words.setMinimumHeight(32)
        self.words.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.setLayout(column(self.correct, self.refit, self.anew, self.words, spacing=6))

    def show_state(self, finished: bool) -> None:
        """Show what changed; ``finished``: the fit is complete, and true."""
        session = self.session
        self.correct.setText(f"Correct {shortened(session.shape, 22)}" if session.shape else "Correct by painting")
        found = corrected(session)
        changed = bool(found.names) and not session.running
        self.refit.setVisible(changed and not found.why)
        self.anew.setVisible(changed and bool(found.why))
        if session.running:
            words = "Stop the fit to correct a shape; it goes on from the correction."
        elif changed:
            words = _changes(found)
        else:
            words = "Paint what is wrong, then refit from here." if finished else ""
        self.words.setText(words)
        self.words.setVisible(bool(words))


def _changes(found: Corrections) -> str:
    """What changed since a fit, and what follows from it, in words."""
    if found.why:
        paint = f" The paint of {_few(found.painted)} counts in it." if found.painted else ""
        return f"{found.why} So it cannot be taken up from here.{paint}"
    others = [name for name in found.painted if name not in found.exemplars]
    said = [f"Corrected: {_few(others)}."] if others else []
    if found.exemplars:
        said.append(f"Repainted: {_few(found.exemplars)}. The templates are made again, and all shapes follow.")
    if found.new:
        said.append(f"New: {_few(found.new)}.")
    return " ".join(said) + ("" if found.exemplars else " The others keep what they have.")


def rounds_planned(session: Session, record: FitRecord) -> int:
    """Rounds of the fit that runs, else of the one that is shown, else of the next."""
    progress = session.progress
    if session.running and session.stage == "fit" and progress is not None and progress.phase == "fit":
        return max(progress.of, record.newest)
    return record.planned or planned_rounds(session)


def _few(names: Sequence[str]) -> str:
    """Some names, and how many more."""
    return ", ".join(shortened(name) for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


class RunStrip(QWidget):
    """Shows how the fit goes; its buttons are actions of the table."""

    def __init__(self, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.actions = actions
        self.run = action_button(actions, "fit", binding, kind="primary")
        self.run.setFixedWidth(112)
        self.step = action_button(actions, "step", binding, text="", kind="tool")
        self.stop = action_button(actions, "stop", binding, text="", kind="tool")
        self.round_text, self.left_text = label("", "heading"), label("", "text2")
        self.phase_text = ElidedLabel("", "caption")
        self.problem = label("", "caption_error", wrap=True)
        self.problem.setFixedSize(244, 30)
        left = column(
            row(self.run, self.step, self.stop, label("Space", "keycap"), None),
            4, row(self.round_text, self.left_text, None, spacing=4), self.phase_text, self.problem, None,
            spacing=0, margins=(PADDING, 12, 0, 0),
        )  # fmt: skip
        holder = QWidget()
        holder.setFixedWidth(264)
        holder.setLayout(left)
        self.scrubber = Scrubber()
        box = row(holder, spacing=8, margins=(0, 0, 8, 0))
        box.addWidget(self.scrubber, 1)
        self.setLayout(box)

    def show_run(self, session: Session, record: FitRecord) -> bool:
        """Show what runs and how far it is; whether the fit is complete."""
        progress = session.progress
        mine = session.running and session.stage == "fit"
        done = not session.running and stage_status(session).get("fit")
        finished = bool(done) and done.state == "done"
        going_on = bool(done) and done.state == "partial" and not other_quality(session)
        words = "Resume" if mine and session.is_paused else "Pause" if mine else "Go on" if going_on else "Run"
        self.run.setText(words if not finished else "Run again")
        changed = corrected(session)
        quiet = finished or (bool(changed.names) and not changed.why and not mine)  # one blue button at a time
        set_style(self.run, "kind", "" if quiet else "primary")
        set_icon(self.run, "pause" if mine and not session.is_paused else "play", "text_2" if quiet else "on_accent")
        newest = record.newest
        of = rounds_planned(session, record)
        self.round_text.setText(f"Round {max(newest, 0)} of {of}" if newest >= 0 else "Not fitted yet")
        left = progress.seconds_left if mine and progress is not None and not session.is_paused else None
        self.left_text.setText(
            f"· {duration(left)} left" if left is not None else "· paused" if mine and session.is_paused else ""
        )
        failed = not mine and session.status_kind == "error" and bool(session.status)
        self.phase_text.setText(self._phase(session, mine, finished))
        self.scrubber.set_share(progress.within if mine and progress is not None and progress.phase == "fit" else 0.0)
        self.problem.setText(session.status if failed else "")
        self.problem.setToolTip(session.status if failed else "")
        for one, shown in ((self.problem, failed), (self.phase_text, not failed)):
            one.setVisible(shown)
        return finished

    def _phase(self, session: Session, mine: bool, finished: bool) -> str:
        progress = session.progress
        if mine and session.is_paused:
            return "what is done is kept"
        if mine and progress is None:
            return "starting…"
        if mine:
            if progress.phase == "faces":
                return f"labelling faces, shape {progress.step} of {progress.of}"
            if progress.phase == "fit" and not progress.within:
                return "aligned; the first round is under way" if progress.step == 0 else "the next round is under way"
            return progress.message
        if session.status and session.status_kind in ("error", "warning"):
            return session.status
        status = stage_status(session).get("fit")
        if status is not None and status.state == "stale":
            return f"out of date: {status.reason}"
        return "done" if finished else self.actions.verdict("fit")[1] or session.status
