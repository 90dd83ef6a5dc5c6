"""The notebook's desk: the thread of long work, and buttons built from the table of actions."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import ipywidgets

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.runner import Runner, deliver
from shapeforge.viewer.session import Session


class NotebookDesk:
    """What actions ask of a notebook: a thread for long work.  It has no dialogs: files are named in code."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.runner = Runner(self._news)
        self._loop: asyncio.AbstractEventLoop | None = None

    def choose_folder(self, title: str) -> Path | None:
        """No dialog here."""
        return None

    def choose_files(self, title: str, endings: tuple[str, ...]) -> tuple[Path, ...]:
        """No dialog here."""
        return ()

    def choose_save(self, title: str, name: str) -> Path | None:
        """No dialog here."""
        return None

    def picture(self, path: Path) -> None:
        """Pictures of a notebook are its own outputs."""

    def show(self, what: str) -> None:
        """Nothing to show besides the notebook."""

    def start(self, name: str, make: Callable[[], Iterator[Any]]) -> None:
        """Run something long in the background; in a notebook the views follow it by themselves."""
        try:
            self._loop = asyncio.get_running_loop()
        except RuntimeError:
            self._loop = None  # plain Python: whoever wants to see something calls `wait`
        self.runner.start(name, make)
        self.session.stage, self.session.is_paused, self.session.progress = name, False, None
        self.session.running = True

    def control(self, what: str) -> None:
        """Pause, resume, step or stop what runs."""
        if self.runner.running:
            getattr(self.runner, what)()
            self.session.is_paused = what == "pause"

    def wait(self, seconds: float | int | None = None) -> bool:
        """Stay until what runs has ended (or paused), showing what it does; False when ``seconds`` were not enough."""
        end = None if seconds is None else time.monotonic() + seconds
        while self.runner.running and not self.runner.paused:
            self.runner.join(0.05)
            self.read_news()
            if end is not None and time.monotonic() > end:
                return False
        self.runner.join(0.05)
        self.read_news()
        return True

    def read_news(self) -> None:
        """Bring what the thread has found into the session; call it on the kernel's thread."""
        news = self.runner.take()
        if news is not None:
            deliver(news, self.session)

    def _news(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.read_news)


def action_button(actions: Actions, name: str) -> ipywidgets.Button:
    """A button for an action of the table; what it cannot do now it says as its tooltip."""
    button = ipywidgets.Button(description=actions[name].label, tooltip=actions[name].tooltip)
    button.on_click(lambda _: actions.run(name))
    show_verdict(button, actions, name)
    return button


def show_verdict(button: ipywidgets.Button, actions: Actions, name: str) -> None:
    """Enable or disable a button, and say why."""
    can, why = actions.verdict(name)
    button.disabled = not can
    button.tooltip = actions[name].tooltip if can else why
