"""Python's cyclic garbage is collected on the thread of the window, and on no other, while a window is open.

A Qt object belongs to the thread that made it.  A closed window is full of reference cycles, so what is left of it is
freed by the cyclic collector, which Python runs on whichever thread happens to allocate: mostly the one that fits.
That thread would destroy widgets, timers and VTK's windows while the event loop, which does not hold the
interpreter's lock, walks through the same tables of Qt: a crash far from its cause.
"""

from __future__ import annotations

import gc

from PySide6.QtCore import QObject, QTimer

EVERY_MS = 500
_holders = 0
_was_enabled = True


class Collector(QObject):
    """From its making to :meth:`close` nothing but its timer collects garbage.  Several may be open at once."""

    def __init__(self, parent: QObject) -> None:
        global _holders, _was_enabled
        super().__init__(parent)
        if _holders == 0:
            _was_enabled = gc.isenabled()
            gc.disable()
        _holders += 1
        self._timer = QTimer(self)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self.collect_due)
        self._timer.start()

    def collect_due(self) -> None:
        """Collect the oldest generation that Python would have collected by now."""
        due = [count > limit > 0 for count, limit in zip(gc.get_count(), gc.get_threshold(), strict=True)]
        if due[0]:
            gc.collect(2 if all(due) else 1 if due[1] else 0)

    def close(self) -> None:
        """Leave the garbage to Python again, when no other window is open."""
        global _holders
        if not self._timer.isActive():
            return
        self._timer.stop()
        _holders -= 1
        if _holders == 0 and _was_enabled:
            gc.enable()
