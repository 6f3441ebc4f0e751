"""Serves the desk to a browser on this computer: the page, files below its folder, and two actions, compare and replay.

It listens on 127.0.0.1 only. A request must name this computer as its host, which prevents DNS rebinding. An action must carry the
token of the page, which prevents forged forms from other sites. Only files of the types in TYPES below the folder are served; links
that lead out of the folder are refused. No page of another site may show it in a frame.
"""

from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import os
from pathlib import Path
import re
import secrets
import shutil
import stat
from subprocess import DEVNULL, PIPE, STDOUT, Popen
import sys
import threading
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

import twin
from twin.desk.entries import MOST, Entry, entries_in, place_in
from twin.errors import InputError
from twin.system import end_tree, has_display

HOST = "127.0.0.1"
LONGEST_FORM = 100_000
"""Largest accepted form [bytes]."""
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".csv": "text/plain; charset=utf-8",
    ".toml": "text/plain; charset=utf-8",
    ".xml": "text/plain; charset=utf-8",
    ".rrd": "application/octet-stream",
}
"""Served file types: ending -> content type."""

_ADDRESS = re.compile(r"http://127\.0\.0\.1:\S+")
"""Address in the line that `twin replay --serve` prints."""
ALWAYS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'",
}
"""Header of every page and file: reports cannot run scripts, load anything from other hosts or be shown in a frame."""

Started = Callable[[Sequence[str]], "Popen[str]"]


def twin_command(words: Sequence[str]) -> Popen[str]:
    """Start a twin command as a separate process; its output and its errors can be read together."""
    command = [sys.executable, "-m", "twin", *words]
    return Popen(command, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, encoding="locale", errors="replace")


class Desk(ThreadingHTTPServer):
    """The server of one folder; `start` starts a twin command."""

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere a second desk would take the port of the first
    request_queue_size = 128  # of connections that wait; one too many is repeated by the browser after seconds

    def __init__(self, folder: Path, port: int, start: Started = twin_command) -> None:
        self.folder, self.start, self.token = folder.resolve(), start, secrets.token_urlsafe(16)
        self.viewers: dict[str, tuple[Popen[str], str]] = {}
        self.busy = threading.Lock()
        try:
            super().__init__((HOST, port), _Answer)
        except OSError as error:
            raise InputError(f"port {port}: cannot be used ({error.strerror}); give another --port") from None

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closes the connection early."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    def server_close(self) -> None:
        """Close the desk and the viewers that it started."""
        super().server_close()
        for viewer, _ in self.viewers.values():
            end_tree(viewer)

    def viewer_of(self, entry: Entry) -> tuple[str, str]:
        """(address of a viewer in the browser, "") of an entry, or ("", why there is none). With a display a window opens: ("", "")."""
        place = self.folder / entry.path
        rebuilt = entry.machine_file and not any(place.glob("*.rrd"))  # from the trace, so on the machine of the run
        words = ["replay", str(place), *(["--machine", str(entry.machine_file)] if rebuilt else [])]
        if has_display():
            started = self.start(words)
            said, _ = started.communicate()
            return "", (said or "").strip() or "The viewer failed." if started.returncode else ""
        with self.busy:
            running, address = self.viewers.get(entry.path, (None, ""))
            if running is not None and running.poll() is None:
                return address, ""
            started = self.start([*words, "--serve", "--port", "0"])
            said = ""
            assert started.stdout is not None
            for line in started.stdout:  # ends with the command
                if (found := _ADDRESS.search(line)) is not None:
                    self.viewers[entry.path] = (started, found[0])
                    return found[0], ""
                said += line
            return "", said.strip() or "The viewer failed."

    @property
    def address(self) -> str:
        """URL of the desk."""
        return f"http://{HOST}:{self.server_address[1]}/"


class _Answer(BaseHTTPRequestHandler):
    server: Desk
    timeout = 60  # of a browser that opens a connection and says nothing [s]

    def do_GET(self) -> None:
        """Serve the desk or a file below its folder."""
        if not self._from_here():
            return
        path = unquote(urlsplit(self.path).path)
        if path == "/":
            self._page()
        elif path.startswith("/file/"):
            self._file(path.removeprefix("/file/"))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")

    def do_POST(self) -> None:
        """Compare two entries, or open one in the viewer."""
        if not self._from_here():
            return
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]{1,9}", length) or int(length) > LONGEST_FORM:
            self._refuse(HTTPStatus.BAD_REQUEST, "this is not a form of the desk")
            return
        form = parse_qs(self.rfile.read(int(length)).decode("utf-8", "replace"))
        if not secrets.compare_digest(form.get("token", [""])[0].encode(), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "this form is out of date; reload the desk")
            return
        known = {entry.path: entry for entry in entries_in(self.server.folder)}
        if self.path == "/compare":
            self._compare([known[path] for path in form.get("compare", []) if path in known])
        elif self.path == "/replay" and (path := form.get("path", [""])[0]) in known:
            self._replay(known[path])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such entry; reload the desk")

    def _compare(self, ticked: Sequence[Entry]) -> None:
        if len(ticked) != 2 or ticked[0].kind != ticked[1].kind:
            self._page("Tick two runs, or two campaigns.", HTTPStatus.BAD_REQUEST)
            return
        first, second = sorted(ticked, key=lambda entry: entry.written)
        name = "-".join(entry.path.replace("/", "_").strip(".") or "all" for entry in (first, second))
        out = self.server.folder / "compared" / name
        words = ["compare", str(self.server.folder / first.path), str(self.server.folder / second.path), "--out", str(out), "--quiet"]
        if first.machine_file:
            words += ["--machine", first.machine_file]
        started = self.server.start(words)
        said, _ = started.communicate()
        if started.returncode:
            self._page((said or "").strip() or "The comparison failed.", HTTPStatus.UNPROCESSABLE_ENTITY)
        else:
            self._to(f"/file/{quote(out.relative_to(self.server.folder).as_posix())}/report.html")

    def _replay(self, entry: Entry) -> None:
        address, wrong = self.server.viewer_of(entry)
        if address or wrong:
            self._page(wrong, HTTPStatus.UNPROCESSABLE_ENTITY if wrong else HTTPStatus.OK, viewer=address, shown=entry.path)
        else:
            self._to("/")

    def _from_here(self) -> bool:
        """Whether the request names this computer as its host; refuses it otherwise."""
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if host in (HOST, "localhost"):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, f"open {self.server.address}")
        return False

    def _page(self, message: str = "", status: HTTPStatus = HTTPStatus.OK, viewer: str = "", shown: str = "") -> None:
        environment = Environment(
            loader=PackageLoader("twin.desk", "."), autoescape=select_autoescape(["html"], default=True), undefined=StrictUndefined
        )
        page = environment.get_template("desk.html").render(
            folder=self.server.folder.name or str(self.server.folder), entries=entries_in(self.server.folder), most=MOST,
            version=twin.__version__, token=self.server.token, message=message, viewer=viewer, shown=shown,
        )  # fmt: skip
        self._send(status, "text/html; charset=utf-8", page.encode("utf-8", "replace"))

    def _file(self, name: str) -> None:
        file = place_in(self.server.folder, name)
        if file is None or file.suffix.lower() not in TYPES:
            self._refuse(HTTPStatus.NOT_FOUND, "no such file on this desk")
            return
        try:
            content = file.open("rb")
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND, "this file cannot be read")
            return
        with content:
            found = os.fstat(content.fileno())
            if not stat.S_ISREG(found.st_mode):
                self._refuse(HTTPStatus.NOT_FOUND, "no such file on this desk")
                return
            self._head(HTTPStatus.OK, found.st_size, {"Content-Type": TYPES[file.suffix.lower()], **ALWAYS})
            shutil.copyfileobj(content, self.wfile)

    def _head(self, status: HTTPStatus, length: int, fields: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {**fields, "Content-Length": str(length)}.items():
            self.send_header(name, value)
        self.end_headers()

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._head(status, len(content), {"Content-Type": kind, **ALWAYS})
        self.wfile.write(content)

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{text}\n".encode())

    def _to(self, place: str) -> None:
        self._head(HTTPStatus.SEE_OTHER, 0, {"Location": place})

    def log_message(self, format: str, *args: object) -> None:
        """Do not log requests on the terminal."""
