"""A real browser without a window, driven over a pipe by its own protocol (Chrome DevTools); tests that need one skip where there is none."""

from __future__ import annotations

import base64
from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
import select
import shutil
import subprocess
import time
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WAITS_S = 60.0


def browser() -> str | None:
    """The browser of this computer, None where there is none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One page: opened, asked and clicked."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._out, self._in, self._rest, self._number, self._session = to_browser, from_browser, b"", 0, ""
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._call("Page.enable")

    def open(self, address: str) -> None:
        """Go to an address and wait until it is loaded."""
        self._call("Page.navigate", url=address)
        self._until(lambda message: message.get("method") == "Page.loadEventFired")

    def ask(self, expression: str) -> Any:
        """Value of a JavaScript expression on the page."""
        answer = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def click(self, selector: str, *, leaves: bool = False) -> None:
        """Click with the mouse in the middle of an element; `leaves` waits for the page that comes then."""
        at = self.ask(
            f"(e => (e.scrollIntoView({{block: 'center'}}), e.getBoundingClientRect().toJSON()))(document.querySelector({selector!r}))"
        )
        x, y = at["x"] + at["width"] / 2, at["y"] + at["height"] / 2
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        if leaves:
            self._until(lambda message: message.get("method") == "Page.loadEventFired")

    def picture(self, path: Path) -> None:
        """The whole page as a PNG."""
        shot = self._call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters} | ({"sessionId": self._session} if self._session else {})
        os.write(self._out, json.dumps(message).encode() + b"\0")
        answer = self._until(lambda message: message.get("id") == number)
        assert "error" not in answer, answer
        return answer["result"]

    def _until(self, wanted: Any) -> dict[str, Any]:
        end = time.monotonic() + WAITS_S
        while time.monotonic() < end:
            while b"\0" in self._rest:
                text, self._rest = self._rest.split(b"\0", 1)
                if wanted(message := json.loads(text)):
                    return message
            if select.select([self._in], [], [], 1.0)[0]:
                read = os.read(self._in, 1 << 20)
                assert read, "the browser ended"
                self._rest += read
        raise TimeoutError("the browser does not answer")


@contextlib.contextmanager
def page(profile: Path) -> Iterator[Page]:
    """A page of a browser that ends with the test; `profile` is a folder of its own."""
    import fcntl  # not on Windows

    ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (*os.pipe(), *os.pipe())]
    read_there, write_here, read_here, write_there = ends

    def connect() -> None:  # the protocol's pipe is 3 and 4 in the browser
        os.dup2(read_there, 3)
        os.dup2(write_there, 4)

    command = [str(browser()), "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--disable-gpu", "--window-size=1280,900"]
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    process = subprocess.Popen(
        [*command, *sandbox, f"--user-data-dir={profile}"],
        preexec_fn=connect,
        pass_fds=(3, 4),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield Page(write_here, read_here)
    finally:
        process.terminate()
        process.wait(timeout=WAITS_S)
        for end in ends:
            os.close(end)
