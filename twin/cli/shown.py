"""A command of twin as an example carries it out: shown first, and the end of the example where it fails."""

from __future__ import annotations

from twin.cli.parser import main


def command(*arguments: object) -> None:
    """A command of twin, shown and carried out."""
    words = [str(a) for a in arguments]
    print(f"\n$ twin {' '.join(words)}", flush=True)
    if code := main(words):
        raise SystemExit(code)
