"""One thread, one mailbox: run, pause, step, stop; what goes wrong becomes a sentence."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import pytest

from shapeforge.viewer.runner import Runner, deliver, duration, sentence
from shapeforge.viewer.session import Session


@dataclass(frozen=True)
class Step:
    stage: str
    step: int
    message: str = ""


def until(condition, seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.002)


def collect(runner: Runner) -> tuple[list, object]:
    """Everything the runner says until it ends."""
    states, outcome = [], None
    end = time.monotonic() + 5
    while outcome is None:
        assert time.monotonic() < end, "it took too long"
        news = runner.take()
        if news is not None:
            states += news.states
            outcome = news.outcome
        else:
            time.sleep(0.002)
    return states, news


def test_every_state_arrives_in_order_and_then_the_end():
    runner = Runner()
    runner.start("count", lambda: iter(range(500)))
    states, news = collect(runner)
    assert states == list(range(500))
    assert (news.outcome, news.error) == ("done", None)
    assert not runner.running


def test_the_mailbox_rings_once_however_much_falls_into_it():
    rings = []
    runner = Runner(lambda: rings.append(threading.current_thread()))
    runner.start("count", lambda: iter(range(100)))
    assert runner.join(5.0)
    assert len(rings) == 1
    news = runner.take()
    assert (news.latest, len(news.states), news.outcome) == (99, 100, "done")
    assert runner.take() is None


def slowly(seen: list):
    for i in range(1000):
        seen.append(i)
        yield i
        time.sleep(0.002)


def test_pause_step_resume():
    runner, seen = Runner(), []
    runner.start("count", lambda: slowly(seen))
    until(lambda: len(seen) > 3)
    runner.pause()
    time.sleep(0.05)
    here = len(seen)
    time.sleep(0.05)
    assert len(seen) == here
    assert runner.paused
    runner.step()
    until(lambda: len(seen) == here + 1)
    until(lambda: runner.paused)
    time.sleep(0.03)
    assert len(seen) == here + 1, "one step is one step"
    runner.resume()
    until(lambda: len(seen) > here + 3)
    runner.stop()
    assert runner.join(5.0)
    assert runner.take().outcome == "stopped"


def test_stopping_a_paused_run_closes_its_iterator():
    closed = []

    def forever():
        try:
            while True:
                yield 0
                time.sleep(0.001)
        finally:
            closed.append(threading.current_thread().name)

    runner = Runner()
    runner.start("forever", forever)
    runner.pause()
    runner.stop()
    runner.pause()  # too late: stop is final
    assert runner.join(5.0)
    assert closed == ["runner forever"], "locks are released in the thread that took them"


def test_what_is_raised_comes_as_news():
    def broken():
        yield 1
        raise ValueError("points: wanted 10, got 3. Import again.")

    runner = Runner()
    runner.start("broken", broken)
    states, news = collect(runner)
    assert states == [1]
    assert news.outcome == "failed"
    assert sentence(news.error) == "points: wanted 10, got 3. Import again."


def test_what_is_raised_when_making_the_iterator_comes_as_news_too():
    runner = Runner()

    def make():
        raise RuntimeError("no")

    runner.start("nothing", make)
    assert collect(runner)[1].outcome == "failed"


def test_one_at_a_time():
    runner = Runner()
    runner.start("first", lambda: slowly([]))
    with pytest.raises(ValueError, match="first is still running"):
        runner.start("second", lambda: iter(()))
    runner.stop()
    assert runner.join(5.0)
    runner.start("second", lambda: iter((1,)))
    assert collect(runner)[0] == [1]


def test_the_listener_may_start_the_next_from_the_news_of_the_end():
    runner = Runner()
    order = []

    def listen() -> None:
        news = runner.take()
        if news is not None and news.outcome is not None:
            order.append(news.name)
            if len(order) < 3:
                runner.start(f"run {len(order)}", lambda: iter(()))

    runner.on_news = listen
    runner.start("run 0", lambda: iter(()))
    until(lambda: len(order) == 3)
    assert order == ["run 0", "run 1", "run 2"]


def test_delivered_news_are_in_the_session():
    session, heard = Session(running=True, stage="import"), []
    session.data_changed.connect(heard.append)
    runner = Runner()
    steps = [Step("import", 1), Step("import", 2), Step("group", 1, "3 groups")]
    runner.start("import", lambda: iter(steps))
    assert runner.join(5.0)
    deliver(runner.take(), session)
    assert heard == ["shapes", "groups"], "each stage that ran is said to have changed its data"
    assert session.progress is steps[-1]
    assert (session.running, session.stage, session.status, session.status_kind) == (False, "group", "3 groups", "ok")


def test_a_failure_is_said_with_its_remedy():
    session, runner = Session(running=True, stage="fit"), Runner()

    def full():
        raise OSError(28, "No space left on device", "/data/x.zarr")
        yield

    runner.start("fit", full)
    assert runner.join(5.0)
    deliver(runner.take(), session)
    assert session.status_kind == "error"
    assert "No space left" in session.status and "free space" in session.status
    assert not session.running


def test_lengths_of_time_in_words():
    assert [duration(s) for s in (0.2, 6.4, 89, 120, 3600, 7260)] == [
        "1 s",
        "6 s",
        "89 s",
        "2 min",
        "60 min",
        "2 h 1 min",
    ]


@dataclass(frozen=True)
class Said:
    stage: str
    phase: str


def test_a_step_is_not_spent_on_an_announcement():
    go = threading.Event()

    def work():
        go.wait(5)
        yield Said("fit", "stale")
        yield Said("fit", "round 0")
        yield Said("fit", "round 1")

    runner, seen = Runner(), []
    runner.start("fit", work)
    runner.step()
    go.set()
    until(lambda: runner.paused)
    news = runner.take()
    seen += news.states
    assert [one.phase for one in seen] == ["stale", "round 0"]
    runner.stop()
    assert runner.join(5)
