"""One writer per project: a lock that a killed process cannot leave behind."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from shapeforge.store_arrays import ProjectError, clear_disk_errors

try:
    import fcntl
except ImportError:  # not a POSIX system: the process id in the file alone decides
    fcntl = None


class WriterLock:
    """Re-entrant for all threads that share this object; shut to every other process and object.

    The kernel drops the lock when its holder dies, so a kill -9 leaves only a file with a dead process id in it,
    which the next writer takes over.  Where files cannot be locked (some network disks) that id alone decides.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._mutex = threading.RLock()
        self._depth = 0
        self._file: int | None = None

    def acquire(self) -> bool:
        """Take the lock; True when it was not held before.  :class:`ProjectError` names the process that has it."""
        with self._mutex:
            if self._depth == 0:
                self._file = self._open()
            self._depth += 1
            return self._depth == 1

    def release(self) -> None:
        """Give the lock back once for every :meth:`acquire`."""
        with self._mutex:
            self._depth -= 1
            if self._depth == 0 and self._file is not None:
                os.ftruncate(self._file, 0)
                os.close(self._file)  # which also unlocks
                self._file = None

    def _open(self) -> int:
        with clear_disk_errors(self.path):
            file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            holder = _holder(file)
            if not self._try_lock(file, holder):
                who = f"process {holder}" if holder else "another process"
                raise ProjectError(
                    self.path.parent, f"is being written by {who}", "Wait until it has finished, or stop it"
                )
            with clear_disk_errors(self.path):
                os.ftruncate(file, 0)
                os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        except BaseException:
            os.close(file)
            raise
        return file

    @staticmethod
    def _try_lock(file: int, holder: int | None) -> bool:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
            except BlockingIOError:
                return False
            except OSError:
                pass  # this disk cannot lock files
        return holder is None or holder == os.getpid() or not _alive(holder)


def _holder(file: int) -> int | None:
    text = os.pread(file, 32, 0).split()
    return int(text[0]) if text and text[0].isdigit() else None


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
