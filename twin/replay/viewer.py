"""The viewer: a window, a page in the browser, or a picture without a display. It listens on this computer only."""

from collections.abc import Callable, Iterator, Sequence
import contextlib
import io
import os
from pathlib import Path
import socket
import subprocess
import sys
import tempfile
import time
from typing import Any
import urllib.parse

from twin.errors import InputError
from twin.files import beside
from twin.replay.names import TIMELINE
from twin.replay.source import check_recording
from twin.stopping import until_ctrl_c
from twin.system import end_tree, has_display, start_apart

LOCAL = "127.0.0.1"
START_SECONDS = 30.0
"""Longest start of the viewer [s]."""
COMPLETE_SECONDS = 60.0
"""Longest wait for a complete picture [s]."""
NO_TIMELINE_SECONDS = 5.0
"""Wait for the timeline of a recording, which may have none [s]."""
SETTLE_SECONDS = 0.4
"""Time between two pictures [s]; two equal ones are complete."""
TOP_BAR = 37
"""Height of the viewer's menu [pixels], cropped from pictures."""
_NO_DRIVER = "no Vulkan driver was found, so the viewer cannot draw; on Debian and Ubuntu: apt-get install mesa-vulkan-drivers"


def open_viewer(paths: str | Path | Sequence[str | Path]) -> None:
    """Open recordings in a viewer window; returns at once."""
    files = _checked(paths)
    if not has_display():
        raise InputError("no display to open the viewer on; use --serve for the browser or --screenshot FILE for a picture")
    command = [*_executable(), *map(str, files), "--bind", LOCAL, "--port", "auto"]
    start_apart(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def serve(paths: str | Path | Sequence[str | Path], port: int) -> None:
    """Serve recordings to browsers on this computer until Ctrl-C. Port 0 is a free one."""
    files = _checked(paths)
    port, data = free_port(port), free_port()
    arguments = ["--serve-web", "--web-viewer-port", str(port), "--port", str(data), "--bind", LOCAL, *map(str, files)]
    with _viewer(arguments) as process:
        _answered(process, lambda: socket.create_connection((LOCAL, port), 1.0).close())
        source = urllib.parse.quote(f"rerun+http://{LOCAL}:{data}/proxy", safe="")
        print(f"open http://{LOCAL}:{port}/?url={source} in a browser; Ctrl-C ends", flush=True)
        with until_ctrl_c():
            while process.poll() is None:
                time.sleep(SETTLE_SECONDS)  # Ctrl-C does not interrupt a wait for a process on Windows
            raise InputError(f"the web viewer stopped with code {process.returncode}; try another --port")


def screenshot(
    paths: str | Path | Sequence[str | Path], out: str | Path, at_s: float | None = None, size: tuple[int, int] = (1920, 1080)
) -> Path:
    """Render the view of recordings at a time (default: their end) to a PNG, without a display.

    The first pictures of a viewer are incomplete; they are repeated until two are equal.
    """
    from PIL import Image
    from rerun.experimental import ViewerClient

    files, out = _checked(paths), Path(out)
    width, height = size
    port, window = free_port(), f"{width}x{height + TOP_BAR}"

    def connected() -> ViewerClient:
        viewer = ViewerClient.connect(f"rerun+http://{LOCAL}:{port}/proxy")
        viewer.get_state()
        return viewer

    with _viewer(["--headless", "--port", str(port), "--bind", LOCAL, "--hide-welcome-screen", "--window-size", window]) as process:
        client = _answered(process, connected)
        if client is None:
            raise InputError(_NO_DRIVER)
        try:
            client.open([str(file.resolve()) for file in files])
            picture = _complete_picture(client, at_s)
        except (OSError, RuntimeError) as error:
            # a viewer without a driver answers for a moment before it exits
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(2.0)
                raise InputError(_NO_DRIVER) from None
            raise InputError(f"the viewer failed: {' '.join(str(error).split())[:200]}; try again, or --serve") from None
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    bar = round(TOP_BAR * image.height / (height + TOP_BAR))
    with beside(out) as partial:
        image.crop((0, bar, image.width, image.height)).save(partial)
    return out


def free_port(port: int = 0) -> int:
    """This port of this computer, or a free one (0)."""
    with socket.socket() as probe:
        try:
            probe.bind((LOCAL, port))
        except (OSError, OverflowError):
            raise InputError(f"--port {port}: cannot be used on this computer; choose another") from None
        return int(probe.getsockname()[1])


def _answered(process: subprocess.Popen[bytes], ask: Callable[[], Any]) -> Any:
    """What a starting viewer answers; None if it ends or does not start."""
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(Exception):
            return ask()
        time.sleep(0.1)
    return None


def _complete_picture(client: Any, at_s: float | None) -> bytes:
    deadline = time.monotonic() + COMPLETE_SECONDS
    state, without_time = client.get_state(), time.monotonic() + NO_TIMELINE_SECONDS
    while state.loading or (not any(recording.timelines for recording in state.recordings) and time.monotonic() < without_time):
        _wait(deadline)
        state = client.get_state()
    # a recording without this timeline is drawn as it opens
    timeline = next((t for recording in state.recordings for t in recording.timelines if t.name == TIMELINE), None)
    start, end = (timeline.start * 1e-9, timeline.end * 1e-9) if timeline is not None else (0.0, 0.0)
    if at_s is not None and not start <= at_s <= end:
        raise InputError(f"--at {at_s:g} is outside the recording; give a time from {start:g} to {end:.6g} s")
    last = b""
    while True:
        if timeline is not None:
            client.set_time(TIMELINE, duration=end if at_s is None else at_s, play_state="paused")
        picture = client.take_screenshot()
        if picture == last:
            return picture
        last = picture
        _wait(deadline)


def _wait(deadline: float) -> None:
    if time.monotonic() > deadline:
        raise InputError(f"the viewer did not complete its picture within {COMPLETE_SECONDS:g} s; try a shorter recording")
    time.sleep(SETTLE_SECONDS)


@contextlib.contextmanager
def _viewer(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A viewer process that ends with the block."""
    # CI=1: send no usage statistics
    environment = {**os.environ, "CI": "1", "XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", tempfile.gettempdir())}
    silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    process = start_apart([*_executable(), *arguments], **silent, env=environment)
    try:
        yield process
    finally:
        if process.poll() is None:
            end_tree(process)


def _executable() -> list[str]:
    """The viewer of the installed package, not another one on the path."""
    import rerun_cli

    binary = Path(rerun_cli.__file__).parent / ("rerun.exe" if os.name == "nt" else "rerun")
    return [str(binary)] if binary.is_file() else [sys.executable, "-m", "rerun_cli"]


def _checked(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    return [check_recording(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
