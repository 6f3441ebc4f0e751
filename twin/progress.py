"""Progress bars on a terminal; nothing is printed elsewhere."""

from __future__ import annotations

from tqdm import tqdm


class Progress:
    """A progress bar that appears after one second.

    Call it with the fraction done, or with None to count one of `total` steps.
    """

    def __init__(self, text: str, total: int | None = None) -> None:
        if total is None:
            layout = "{desc} {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
            self.bar = tqdm(total=1.0, desc=text, delay=1.0, disable=None, bar_format=layout, leave=False)
        else:
            self.bar = tqdm(total=total, desc=text, delay=1.0, disable=None, leave=False)

    def __call__(self, fraction: float | None) -> None:
        self.bar.update(1 if fraction is None else fraction - self.bar.n)

    def say(self, text: str) -> None:
        """Show a text instead of the bar, for work of unknown length."""
        self.bar.bar_format = "{desc} ({elapsed})"
        self.bar.set_description_str(text)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()


class Steps:
    """A progress bar that advances one step per call and shows the name of the step."""

    def __init__(self, text: str, total: int) -> None:
        self.bar = tqdm(total=total, desc=text, delay=1.0, disable=None, leave=False, bar_format="{desc} |{bar}| {elapsed}")

    def __call__(self, name: str) -> None:
        self.bar.set_description_str(name)
        if self.bar.n < self.bar.total - 1:  # type: ignore[operator]
            self.bar.update(1)

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()
