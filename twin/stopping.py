"""Stopping a command: it ends within seconds, prints one line and leaves no process behind.

Ctrl-C and SIGTERM raise `Stopped` in the main thread, so that partial files are removed. A second thread receives the signal too and ends the process
after `GRACE_S` if the main thread is still in compiled code or waiting for workers. Workers end as soon as their parent process is gone
(`end_with_parent`).
"""

from collections.abc import Callable, Iterator
import contextlib
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType
from typing import NoReturn

from twin.system import wait_for_end

GRACE_S = 1.5
"""Time for a stopped command to clean up [s]; with it, Ctrl-C ends a command within 3 s."""
WORDS = {signal.SIGINT: "stopped by the user", signal.SIGTERM: "stopped by another process (SIGTERM)"}
PARENT = "TWIN_PARENT"
"""Environment variable with the process number of the parent, for a worker that is a program of its own."""
removals: list[Callable[[], object]] = []
"""What removes partial files and locks of this process, newest last: it also happens if the process ends without its main thread."""
_said = threading.Lock()


class Stopped(KeyboardInterrupt):
    """A signal stopped the command; its exit code `code` is 128 plus the signal number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number, self.code = number, 128 + number


def say(number: int) -> None:
    """Print the line about a signal on standard error, once per process."""
    if _said.acquire(blocking=False):
        with contextlib.suppress(OSError, ValueError):
            os.write(2, f"twin: {WORDS.get(signal.Signals(number), 'stopped')}\n".encode())


def stoppable() -> None:
    """Install the signal handlers. Call this once, before anything else, in the main thread of a command."""
    read, write = socket.socketpair()
    read.setblocking(True)
    write.setblocking(False)
    signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)
    for number in WORDS:
        signal.signal(number, _raise)
    unraisable = sys.unraisablehook  # an exception in a callback is printed and forgotten: this one must be one line
    sys.unraisablehook = lambda found: None if isinstance(found.exc_value, Stopped) else unraisable(found)
    threading.Thread(target=_end, args=(read, write), daemon=True, name="twin-stopping").start()


_received: Stopped | None = None


def received() -> Stopped | None:
    """The signal that stopped this process, if any. A library may turn the exception into one of its own, such as an ImportError."""
    return _received


def _raise(number: int, _: FrameType | None) -> None:
    for other in WORDS:
        signal.signal(other, signal.SIG_IGN)  # a second signal must not interrupt the clean-up
    global _received
    _received = Stopped(number)
    raise _received


def _end(read: socket.socket, _: socket.socket) -> None:
    """End the process `GRACE_S` after a signal, whatever the main thread is doing."""
    while True:
        number = read.recv(1)[0]
        if number in [int(known) for known in WORDS]:
            break
    time.sleep(GRACE_S)
    say(number)
    for act in (*reversed(removals), sys.stdout.flush):
        with contextlib.suppress(Exception):
            act()
    os._exit(128 + number)


@contextlib.contextmanager
def until_ctrl_c() -> Iterator[None]:
    """Context of a server, which Ctrl-C ends without an error, also where the server itself takes it. SIGTERM stops the command as usual."""
    global _received
    try:
        yield
    except KeyboardInterrupt as stop:
        if isinstance(stop, Stopped) and stop.number != signal.SIGINT:
            raise
    if _received is not None and _received.number == signal.SIGINT:
        _received = None


def ended(code: int) -> NoReturn:
    """End the process with the exit code of a finished command, without the interpreter: it takes a second to unload its modules, and waits for
    the thread of a library that will never end because the disk is full.

    A library may have swallowed the exception of a signal, for example in a callback: the command was stopped all the same.
    """
    if _received is not None and code != _received.code:
        say(_received.number)
        code = _received.code
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def end_with_parent() -> None:
    """Set up a worker process: it ignores Ctrl-C, which its parent handles, and ends when its parent is gone."""
    import logging
    import multiprocessing

    logging.getLogger().addHandler(logging.NullHandler())  # as in the command itself
    with contextlib.suppress(ValueError):  # not called in a main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # the parent may be gone already, since a worker takes a second to load: the system's answer would then be another process
    known = multiprocessing.parent_process()
    parent = (known.pid if known is not None else None) or int(os.environ.get(PARENT, os.getppid()))

    def end() -> None:
        wait_for_end(parent)
        os._exit(143)

    threading.Thread(target=end, daemon=True, name="twin-parent").start()
