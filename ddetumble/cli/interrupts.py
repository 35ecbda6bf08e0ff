"""Ctrl-C ends a command at once, also while a compilation keeps Python from noticing it.

Python raises KeyboardInterrupt in the main thread only between two of its own instructions: not before the call of a
compiled library that the thread is in returns, which may be a minute for a program that XLA compiles. The signal itself
arrives at once, and a second thread is told of it through a socket.
"""

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress


INTERRUPTED = 130  # exit code of a command that Ctrl-C ended: 128 and the number of the signal
PATIENCE = 1.0  # s, for the main thread to stop by itself, as it does wherever it runs Python
_undo: list[Callable[[], object]] = []
_arrived = threading.Event()
_wakeup: list[socket.socket] = []  # both ends, kept open as long as the process lives


@contextmanager
def undone_by(action: Callable[[], object]) -> Iterator[None]:
    """Name what has to be done where the process is ended in the middle of a block.

    Args:
        action: called from another thread, and perhaps beside the block's own clearing up: it has to bear both.
    """
    _undo.append(action)
    try:
        yield
    finally:
        _undo.remove(action)


def watch_interrupts(tell: Callable[[], object]) -> None:
    """Have Ctrl-C end this process: after `PATIENCE`, or at the second one, whatever the main thread is in.

    For a process that is a command's own; a host of several, such as a notebook, decides for itself. Does nothing
    outside of the main thread, or where it is done already.

    Args:
        tell: says that the command was stopped.
    """
    if _wakeup or threading.current_thread() is not threading.main_thread():
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    _wakeup.extend((reader, writer))
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reader, tell), name="interrupts", daemon=True).start()


def was_interrupted() -> bool:
    """Whether Ctrl-C has arrived: libraries turn it into errors of their own, as numpy does while it is imported."""
    return _arrived.is_set()


def _watch(reader: socket.socket, tell: Callable[[], object]) -> None:
    """Wait for the interrupt, and end the process, cleared up, without asking its other threads."""
    _wait_for_interrupt(reader)
    _arrived.set()
    reader.settimeout(PATIENCE)
    with suppress(TimeoutError):
        _wait_for_interrupt(reader)
    for action in (*reversed(_undo), tell):
        with suppress(Exception):
            action()
    os._exit(INTERRUPTED)


def _wait_for_interrupt(reader: socket.socket) -> None:
    while signal.SIGINT not in reader.recv(64):  # a byte for each signal
        pass
