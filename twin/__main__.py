"""Run the command line with `python -m twin`, or as `twin`; from the first moment it can be stopped."""

import sys

from twin.stopping import stoppable


def run() -> int:
    """The command of the command line; its exit code."""
    stoppable()
    try:
        from twin.cli import main

        return main()
    except KeyboardInterrupt as stop:  # before the command itself was there
        from twin.stopping import say

        say(getattr(stop, "number", 2))
        return int(getattr(stop, "code", 130))


if __name__ == "__main__":
    sys.exit(run())
