"""How a command ends when it is stopped: within seconds, in one line, and with every process that it began.

Ctrl-C and SIGTERM raise in the main thread, so that what is half written is removed. A thread that waits for the signal itself ends the process
`GRACE_S` later where the main thread is still in compiled code or waits for its workers. Workers end when the process that began them is gone,
however that came about (`end_with_parent`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType

GRACE_S = 1.5
"""What a stopped command may take to put things in order [s]; Ctrl-C ends it within 3 s."""
_LOOK_S = 0.5
WORDS = {signal.SIGINT: "stopped by the user", signal.SIGTERM: "stopped by another process (SIGTERM)"}
_said = threading.Lock()


class Stopped(KeyboardInterrupt):
    """A signal stopped the command; `code` is its exit code, 128 and the number of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number, self.code = number, 128 + number


def say(number: int) -> None:
    """The one line on standard error, once."""
    if _said.acquire(blocking=False):
        with contextlib.suppress(OSError, ValueError):
            os.write(2, f"twin: {WORDS.get(signal.Signals(number), 'stopped')}\n".encode())


def stoppable() -> None:
    """Arm this process, which must be that of a command: called once, first of all, in its main thread."""
    if os.name == "nt":
        return
    read, write = socket.socketpair()
    read.setblocking(True)
    write.setblocking(False)
    signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)
    for number in WORDS:
        signal.signal(number, _raise)
    threading.Thread(target=_end, args=(read, write), daemon=True, name="twin-stopping").start()


def _raise(number: int, _: FrameType | None) -> None:
    for other in WORDS:
        signal.signal(other, signal.SIG_IGN)  # once is enough: what is put in order now is not disturbed
    raise Stopped(number)


def _end(read: socket.socket, _: socket.socket) -> None:
    """End the process a while after a signal, whatever its main thread does."""
    while True:
        number = read.recv(1)[0]
        if number in [int(known) for known in WORDS]:
            break
    time.sleep(GRACE_S)
    say(number)
    with contextlib.suppress(Exception):
        sys.stdout.flush()
    os._exit(128 + number)


_left_behind = False


def leave_behind() -> None:
    """A thread of a library waits for ever (a disk is full): the command must not wait for it when it ends."""
    global _left_behind
    _left_behind = True


def ended(code: int) -> int:
    """The exit code of a command that is done; where something was left behind, the process ends here."""
    if _left_behind:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code


def end_with_parent() -> None:
    """A worker leaves Ctrl-C to the process that began it, and ends when that process is gone."""
    with contextlib.suppress(ValueError):  # not in a main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        os._exit(143)

    threading.Thread(target=look, daemon=True, name="twin-parent").start()
