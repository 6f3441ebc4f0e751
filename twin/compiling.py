"""One line on a terminal before functions are compiled: it takes up to a minute, after an installation or an update only.

numba reports a compilation once it has looked in its cache, so the cache decides whether anything is said.
"""

from __future__ import annotations

import os
import sys
from typing import Any

from numba.core import event

_SAID = "TWIN_SAID_COMPILING"
"""Environment variable: set once the line is printed, so that workers do not repeat it."""


class _SayOnce(event.Listener):
    """Prints the line at the first compilation."""

    def on_start(self, _event: Any) -> None:
        """A compilation begins."""
        if not os.environ.get(_SAID) and sys.stderr is not None and sys.stderr.isatty():
            from tqdm import tqdm  # writes above a bar

            os.environ[_SAID] = "1"
            tqdm.write("twin: compiling, once after an installation or an update (up to a minute)", file=sys.stderr)

    def on_end(self, _event: Any) -> None:
        """A compilation ends."""


event.register("numba:compile", _SayOnce())
