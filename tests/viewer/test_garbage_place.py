"""What a closed window leaves behind is freed on the thread of the window, never on one that works."""

from __future__ import annotations

import gc
import threading
import weakref
from collections import Counter

import shiboken6
from PySide6.QtCore import QCoreApplication, QEvent, QObject

from shapeforge.viewer.qt.window import Window
from shapeforge.viewer.session import PLACES


class Knot:
    """Something that only the cyclic collector can free."""

    def __init__(self) -> None:
        self.me = self


def test_a_working_thread_frees_nothing_of_the_window(open_window, qtbot, grouped):
    """Cycles made on the window's thread are not collected by the thread that fits, however much that allocates."""
    window = open_window(grouped)
    freed: list[str] = []
    gc.collect()

    def work():
        for _ in range(3):
            heap = [Knot() for _ in range(20_000)]
            del heap
            yield None

    knot = Knot()
    weakref.finalize(knot, lambda: freed.append(threading.current_thread().name))
    del knot
    window.runner.start("group", work)
    assert window.runner.join(20.0)
    assert freed == []
    qtbot.waitUntil(lambda: bool(freed))  # the window's own timer comes round to it
    assert freed == [threading.main_thread().name]


def test_python_collects_again_after_the_last_window(open_window, grouped):
    assert gc.isenabled()
    first, second = open_window(grouped), open_window(grouped)
    first.close()
    assert not gc.isenabled()
    first.close()
    assert not gc.isenabled(), "closed twice, counted once"
    second.close()
    assert gc.isenabled()


def test_a_closed_window_leaves_no_living_widget_to_the_collector(qtbot, fitted):
    """Every Qt object has a parent, so it goes with its window and not at some time on some thread."""
    window = Window()
    window.session.open(fitted)
    window.show()
    qtbot.waitExposed(window)
    for place in PLACES[:4]:
        window.session.place = place
        qtbot.wait(50)
    window.close()
    assert not window.runner.running
    window.deleteLater()
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
    assert not shiboken6.isValid(window)
    found: Counter[str] = Counter()
    for thing in gc.get_objects():
        if not issubclass(type(thing), QObject) or not shiboken6.isValid(thing):
            continue
        if shiboken6.ownedByPython(thing) and thing.parent() is None:
            found[type(thing).__name__] += 1
    assert not found, found
