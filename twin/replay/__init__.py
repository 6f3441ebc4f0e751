"""Interactive replay: write a run as a recording, open it in the viewer, or render it without a display.

trace + machine -> scene, poses, tool paths, curves, events -> recording (.rrd) -> window, browser or picture
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.replay.recording import Written, write_motion, write_recording
    from twin.replay.side_by_side import write_side_by_side
    from twin.replay.viewer import open_viewer, screenshot, serve

__all__ = ["Written", "open_viewer", "screenshot", "serve", "write_motion", "write_recording", "write_side_by_side"]

_HOMES = {
    **dict.fromkeys(("Written", "write_motion", "write_recording"), "recording"),
    "write_side_by_side": "side_by_side",
    **dict.fromkeys(("open_viewer", "screenshot", "serve"), "viewer"),
}


# the library logs write errors itself; `recording_to` checks each recording instead
os.environ.setdefault("RUST_LOG", "error,re_log_encoding=off,re_sdk=off")


def __getattr__(name: str) -> Any:
    """Load a public name on first use; importing the viewer's library takes time."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
