"""Drives one long iterator in a thread: run, pause, step, stop.  No Qt: whoever listens gives a callback.

The thread only iterates; it never touches the Session or a window.  What it found lies in a one-slot mailbox, newest
wins, and the listener takes it on its own thread.  The iterator cannot tell whether anybody watches.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from shapeforge.viewer.session import Session

Outcome = Literal["done", "stopped", "failed"]
ANNOUNCEMENTS = ("stale", "partial", "start")
"""Phases in which a stage only says what it is about to do: no step of its own (nor is what it says within one)."""


@dataclass(frozen=True, eq=False)
class News:
    """What the thread has to say: the newest state, all states since the last look, and how it ended.

    ``states`` holds every state since the last look (the window plots them all), ``latest`` the last of them;
    ``outcome`` is None while it runs; ``error`` is what was raised, None when nothing was.
    """

    name: str
    latest: Any | None
    states: tuple[Any, ...]
    outcome: Outcome | None
    error: BaseException | None = None
    seconds: float = 0.0


class Runner:
    """One thread at most.  All methods may be called from any thread except the one it runs; none of them waits."""

    def __init__(self, on_news: Callable[[], None] = lambda: None) -> None:
        """``on_news()`` is called from the thread when the mailbox was empty and no longer is: keep it short."""
        self.on_news = on_news
        self._thread: threading.Thread | None = None
        self._wake = threading.Condition()
        self._mode: Literal["run", "pause", "step", "stop"] = "run"
        self._news: News | None = None
        self._name = ""

    @property
    def name(self) -> str:
        """What was started last."""
        return self._name

    @property
    def running(self) -> bool:
        """Whether the thread is at work or paused."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def paused(self) -> bool:
        """Whether it waits (or will, after the present step) for `resume` or `step`."""
        return self.running and self._mode == "pause"

    def start(self, name: str, make: Callable[[], Iterator[Any]]) -> None:
        """Iterate ``make()`` in a new thread; ``ValueError`` while another is at work."""
        if self.running:
            raise ValueError(f"runner: {self._name} is still running, stop it before starting {name}")
        self._name, self._mode, self._news = name, "run", None
        self._thread = threading.Thread(target=self._work, args=(name, make), name=f"runner {name}", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Wait after the present step."""
        self._set("pause", unless="stop")

    def resume(self) -> None:
        """Go on."""
        self._set("run", unless="stop")

    def step(self) -> None:
        """Do one step, then wait."""
        self._set("step", unless="stop")

    def stop(self) -> None:
        """End after the present step; what was recorded stays, a later run goes on from there."""
        self._set("stop")

    def join(self, seconds: float | int | None = None) -> bool:
        """Wait for the thread, at most ``seconds``; True when it has ended."""
        thread = self._thread
        if thread is not None:
            thread.join(seconds)
            return not thread.is_alive()
        return True

    def take(self) -> News | None:
        """Empty the mailbox; None when nothing is new."""
        with self._wake:
            news, self._news = self._news, None
        return news

    def _set(self, mode: Literal["run", "pause", "step", "stop"], unless: str = "") -> None:
        with self._wake:
            if self._mode != unless or not unless:
                self._mode = mode
            self._wake.notify_all()

    def _work(self, name: str, make: Callable[[], Iterator[Any]]) -> None:
        begin = time.monotonic()
        outcome: Outcome = "done"
        error: BaseException | None = None
        iterator: Iterator[Any] | None = None
        try:
            iterator = make()
            while self._may_go_on():
                try:
                    state = next(iterator)
                except StopIteration:
                    break
                with self._wake:
                    announced = getattr(state, "phase", "") in ANNOUNCEMENTS or getattr(state, "within", 0.0) > 0
                    if self._mode == "step" and not announced:
                        self._mode = "pause"  # before the news of it, so that who hears them finds it waiting
                self._post(News(name, state, (state,), None, None, time.monotonic() - begin))
            else:
                outcome = "stopped"
        except BaseException as raised:  # whatever it is, it becomes a sentence in the window
            outcome, error = "failed", raised
        finally:
            # Closing the generator lets it release locks and finish its checkpoint.
            close = getattr(iterator, "close", None)
            if close is not None and outcome != "failed":
                try:
                    close()
                except Exception as raised:
                    outcome, error = "failed", raised
        self._thread_done()
        self._post(News(name, None, (), outcome, error, time.monotonic() - begin))

    def _thread_done(self) -> None:
        # The listener may start the next stage as soon as it hears of the end.
        with self._wake:
            self._thread = None

    def _may_go_on(self) -> bool:
        with self._wake:
            while self._mode == "pause":
                self._wake.wait()
            return self._mode != "stop"

    def _post(self, news: News) -> None:
        with self._wake:
            old = self._news
            if old is not None:
                latest = old.latest if news.latest is None else news.latest
                news = News(news.name, latest, old.states + news.states, news.outcome, news.error, news.seconds)
            self._news = news
        if old is None:
            self.on_news()


def sentence(error: BaseException) -> str:
    """What the user reads when a stage fails: our own errors carry their remedy, others are named."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "Not enough memory. Close other programmes, or import with fewer points per shape."
    if isinstance(error, OSError) and error.strerror:
        where = f" ({error.filename})" if error.filename else ""
        return f"{error.strerror}{where}. Check the folder and its free space, then run it again."
    if isinstance(error, ValueError | RuntimeError) and text:
        return text
    return f"{type(error).__name__}: {text or 'no message'}. The log file in the project has the details."


TOUCHES: dict[str, str] = {
    "import": "shapes", "group": "groups", "label": "labels", "cosegment": "labels", "fit": "fit", "learn": "machine",
    "refine": "machine", "synthesize": "draws",
}  # fmt: skip
"""What the data of the project change in when a stage has run."""


def deliver(news: News, session: Session) -> None:
    """Write news into the session, on the thread the session belongs to: progress, what changed, how it ended."""
    for state in news.states:
        stage = getattr(state, "stage", None)
        if stage is not None and stage != session.stage:  # one job may run several stages in turn
            finished, session.stage = session.stage, stage
            if finished is not None:
                session.touch(TOUCHES.get(finished, "shapes"))
        session.progress = state
    if news.outcome is None:
        return
    stage = session.stage or news.name
    session.running, session.is_paused = False, False
    session.touch(TOUCHES.get(stage, "shapes"))
    if news.outcome == "failed" and news.error is not None:
        project = session.project
        if project is not None and hasattr(project, "log"):
            project.log(f"{stage} failed", news.error)
        session.say(sentence(news.error), "error")
    elif news.outcome == "stopped":
        session.say(f"Stopped. Run {stage} again and it goes on from here.", "warning")
    else:
        last = session.progress
        said = getattr(last, "message", "") if last is not None else ""
        session.say(said or f"{stage} is done in {duration(news.seconds)}", "ok")


DOING: dict[str, str] = {
    "import": "Reading", "group": "Grouping", "label": "Taking labels", "cosegment": "Proposing parts",
    "fit": "Fitting", "learn": "Learning", "refine": "Refining", "synthesize": "Making shapes",
}  # fmt: skip
"""What a stage is said to be doing."""


def duration(seconds: float | int) -> str:
    """A length of time in words: "6 s", "2 min", "1 h 20 min"."""
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"
