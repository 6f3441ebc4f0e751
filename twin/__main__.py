"""Run the command line with `python -m twin`, or as `twin`; from the first moment it can be stopped."""

from io import TextIOWrapper
import os
import sys
import warnings

# One BLAS thread, set before numpy loads: the commands use the cores with workers of their own, more threads only wait for each other,
# and the last bits of a result must not depend on the number of cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from twin.stopping import ended, stoppable


def run() -> int:
    """The command of the command line; its exit code."""
    stoppable()
    if not sys.warnoptions:  # those of libraries, for who writes Python: a message of a command is one line
        warnings.simplefilter("ignore")
    for stream in (sys.stdout, sys.stderr):  # a name of a file may hold bytes that are no text, a terminal may know ASCII alone
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        from twin.cli import main

        return ended(main())
    except KeyboardInterrupt as stop:  # before the command itself was there
        from twin.stopping import say

        say(getattr(stop, "number", 2))
        return int(getattr(stop, "code", 130))


if __name__ == "__main__":
    sys.exit(run())
