"""Entry point of the command line (`python -m twin` and `twin`). Signals stop it from the start."""

import gc
from io import TextIOWrapper
import os
import sys
import warnings

# One BLAS thread, set before numpy loads: the commands use the cores with workers of their own, more threads only wait for each other,
# and the last bits of a result must not depend on the number of cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# MuJoCo draws nothing here, and importing its window library starts a process
os.environ.setdefault("MUJOCO_GL", "disable")

from twin.stopping import ended, received, say, stoppable
from twin.system import return_memory


def run() -> int:
    """The command of the command line; its exit code."""
    try:
        stoppable()
        gc.set_threshold(20_000)  # imports make hardly any cycles: looking for them every 700 objects takes a tenth of their time
        return_memory()
        import logging  # after the signal handlers

        if not sys.warnoptions:  # warnings of libraries are for those who write Python; worker processes inherit the variable
            warnings.simplefilter("ignore")
            os.environ["PYTHONWARNINGS"] = "ignore"
        logging.getLogger().addHandler(logging.NullHandler())  # log records of libraries, such as that of matplotlib about a missing home
        for stream in (sys.stdout, sys.stderr):  # a name of a file may hold bytes that are no text, a terminal may know ASCII alone
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        from twin.cli import main

        return ended(main())
    except KeyboardInterrupt as stop:  # before the command itself was there
        say(getattr(stop, "number", 2))
        return ended(int(getattr(stop, "code", 130)))
    except Exception as error:
        from twin.errors import TRACEBACK, defect

        if received() is None:
            if os.environ.get(TRACEBACK):
                raise
            print(f"twin: {defect(error)}", file=sys.stderr)
        return ended(2)


if __name__ == "__main__":
    sys.exit(run())
