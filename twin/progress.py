"""What reaches a terminal: text without control characters, and progress bars, which are printed nowhere else."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import re
import threading
from typing import Any

from tqdm import tqdm

from twin.errors import plain


class Plain:
    """A stream that writes `plain` text, and progress bars as they are."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> Any:
        """Write a text."""
        begin = len(text) if re.fullmatch(r"(\n|\x1b\[A)*", text) else int(text.startswith("\r"))
        return self.stream.write(text[:begin] + plain(text[begin:]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


FIRST_S, EACH_S = 1.0, 0.5
"""Time [s] until a bar appears, and between its updates. A bar is drawn while the work reports nothing too, so that the clock in it runs."""

SHARE = "{desc} {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
COUNT = "{desc} {n_fmt} of {total_fmt} |{bar}| {elapsed} < {remaining}"
NAMED = "{desc} |{bar}| {elapsed}"
ENDLESS = "{desc} ({elapsed})"

_hushed = False


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Context without any progress bar."""
    global _hushed
    before, _hushed = _hushed, True
    try:
        yield
    finally:
        _hushed = before


class Progress:
    """A progress bar, which draws itself until it is closed. Call it with the fraction done, or with None to count one of `total` steps; 0: of unknown length."""

    def __init__(self, text: str, total: int | None = None) -> None:
        layout = SHARE if total is None else COUNT if total else ENDLESS
        hidden = True if _hushed else None
        self.bar: tqdm[Any] = tqdm(total=total or 1.0, desc=text, delay=FIRST_S, disable=hidden, bar_format=layout, leave=False)
        self._closed = threading.Event()
        self._drawing = threading.Thread(target=self._draw, daemon=True)
        if not self.bar.disable:
            self._drawing.start()

    def _draw(self) -> None:
        wait = FIRST_S
        while not self._closed.wait(wait):
            self.bar.delay = 0.0  # tqdm clears a bar at its end only where its delay is over and an update was counted since
            self.bar.refresh()
            wait = EACH_S

    def __call__(self, fraction: float | None) -> None:
        self.bar.update(1 if fraction is None else fraction - self.bar.n)

    def step(self, name: str) -> None:
        """Advance one step and show its name."""
        self.bar.bar_format = NAMED
        self.bar.set_description_str(plain(name))
        if self.bar.n < self.bar.total - 1:  # type: ignore[operator]
            self.bar.update(1)

    def say(self, text: str) -> None:
        """Show a text instead of the bar, for work of unknown length."""
        self.bar.bar_format = ENDLESS
        self.bar.set_description_str(plain(text))

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        if self._drawing.is_alive():
            self._drawing.join()  # what it draws after the bar is cleared would stand there
        self.bar.close()
