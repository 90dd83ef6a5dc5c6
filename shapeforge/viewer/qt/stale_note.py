"""A note that what is shown is out of date, why, and the button that leads on."""

from __future__ import annotations

from PySide6.QtWidgets import QFrame

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.qt.bind import Binding, keep_enabled
from shapeforge.viewer.qt.widgets import button, column, framed, icon_label, label, row
from shapeforge.viewer.readiness import stage_status

FOLLOWS = {"fit": "What is shown is still the old fit.", "learn": "What is shown is still the old model."}


def stale_note(actions: Actions, binding: Binding, stage: str, then: str, text: str, rather: str = "") -> QFrame:
    """A frame that is there only while the results of ``stage`` are out of date; ``then`` is the action offered.

    Where the action ``rather`` can be done it is offered instead: it does the same for less.
    """
    why = label("", "caption", wrap=True)
    go = button(text, kind="link")

    def offered() -> str:
        return rather if rather and actions.verdict(rather)[0] else then

    go.clicked.connect(lambda: actions.run(offered()))
    keep_enabled(go, actions, then, binding)
    words = column(row(label("Out of date", "heading"), None, go), why, spacing=2)
    sign = column(6, icon_label("warning", "warning"), None)  # beside the words: the button is higher than they
    note = framed(row(sign, words, margins=(12, 4, 12, 10)), "note")
    holder = framed(column(note, margins=(16, 12, 16, 0)), "stale")
    session = actions.session

    def show() -> None:
        found = stage_status(session).get(stage)
        stale = found is not None and found.state == "stale"
        reason = found.reason if stale else ""
        why.setText(f"{reason[:1].upper()}{reason[1:].rstrip('.')}. {FOLLOWS[stage]}" if stale else "")
        go.setText(text if offered() == then else actions[rather].label)
        holder.setVisible(stale)

    binding.on(("project", "data", "running", "place"), show)
    return holder
