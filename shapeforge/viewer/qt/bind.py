"""Ties between the Session and widgets: what the Session says is shown, what the user does is written to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import QAbstractButton, QPushButton, QWidget

from shapeforge.store_arrays import ProjectError
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.qt.widgets import button
from shapeforge.viewer.runner import sentence
from shapeforge.viewer.session import Session


class Binding:
    """All connections of one owner, so that they end with it: a closed window hears nothing more of its Session."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._slots: list[tuple[object, Callable]] = []

    def on(self, fields: Sequence[str], show: Callable[[], None], *, now: bool = True) -> None:
        """Call ``show()`` whenever one of ``fields`` of the session changes (and once now)."""

        def slot(*_: object) -> None:
            self.safely(show)

        for name in fields:
            signal = self._session.data_changed if name == "data" else getattr(self._session.events, name)
            signal.connect(slot, check_nargs=False)
            self._slots.append((signal, slot))
        if now:
            self.safely(show)

    def safely(self, show: Callable[[], None]) -> None:
        """Call ``show()``; a damaged file of the project becomes the status, not the end of the window."""
        try:
            show()
        except (ProjectError, OSError) as error:
            self._session.say(sentence(error), "error")

    def close(self) -> None:
        """End all connections."""
        for signal, slot in self._slots:
            signal.disconnect(slot, missing_ok=True)
        self._slots.clear()


# What may change whether an action can be done.
ENABLING = (
    "project",
    "shape",
    "selected",
    "group",
    "turn",
    "place",
    "running",
    "is_paused",
    "edit_count",
    "history",
    "data",
)


def tooltip_of(actions: Actions, name: str) -> str:
    """What an action does with its shortcut and, when it cannot be done now, why not."""
    action = actions[name]
    can, why = actions.verdict(name)
    key = f"  ({native(action.shortcut)})" if action.shortcut else ""
    text = action.tooltip or action.label.rstrip("…")
    return f"{text}{key}" if can else f"{text}{key}\n{why}"


def native(shortcut: str) -> str:
    """A shortcut as the platform writes it."""
    return QKeySequence(shortcut).toString(QKeySequence.SequenceFormat.NativeText)


def action_button(
    actions: Actions, name: str, binding: Binding, *, text: str | None = None, kind: str = "", icon: bool = True
) -> QPushButton:
    """A button that does an action; when it cannot be done it is off and its tooltip says why."""
    action = actions[name]
    result = button(action.label if text is None else text, icon=action.icon if icon else "", kind=kind)
    result.setAccessibleName(action.label)
    result.clicked.connect(lambda: actions.run(name))
    keep_enabled(result, actions, name, binding)
    return result


def keep_enabled(widget: QAbstractButton | QWidget, actions: Actions, name: str, binding: Binding) -> None:
    """Keep a widget on or off, and its tooltip saying why, as the action's verdict changes."""

    def show() -> None:
        can, _ = actions.verdict(name)
        widget.setEnabled(can)
        widget.setToolTip(tooltip_of(actions, name))

    binding.on(ENABLING, show)
