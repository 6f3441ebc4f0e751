"""Progress on a terminal, nothing elsewhere."""

from __future__ import annotations

from tqdm import tqdm


class Progress:
    """A progress bar on a terminal for work above a second.

    Call it with the done fraction, or with None for one more of `total` steps; `say` shows what is being tried.
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
        """Show what is being done, where the end is not known beforehand."""
        self.bar.bar_format = "{desc} ({elapsed})"
        self.bar.set_description_str(text)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()


class Steps:
    """A bar on a terminal that goes one step with each report, with its name."""

    def __init__(self, text: str, total: int) -> None:
        from tqdm import tqdm

        self.bar = tqdm(total=total, desc=text, delay=1.0, disable=None, leave=False, bar_format="{desc} |{bar}| {elapsed}")

    def __call__(self, name: str) -> None:
        self.bar.set_description_str(name)
        if self.bar.n < self.bar.total - 1:  # type: ignore[operator]
            self.bar.update(1)

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()
