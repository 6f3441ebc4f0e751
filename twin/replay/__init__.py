"""Interactive replay: write a run as a recording, open it in the viewer, or render it without a display.

trace + machine -> scene, poses, tool paths, curves, events -> recording (.rrd) -> window, browser or picture

recording      write a run, several overlaid runs, or the motion of any model     side_by_side   two designs
cut            a cut surface                                                      viewer         window, page in the browser, picture
"""

import os

# the library logs write errors itself; `recording_to` checks each recording instead
os.environ.setdefault("RUST_LOG", "error,re_log_encoding=off,re_sdk=off")
