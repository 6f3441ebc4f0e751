"""Serves the desk to a browser on this computer: the page, files below its folder, and two actions, compare and replay.

It listens on 127.0.0.1 only. A request must name this computer as its host, which prevents DNS rebinding. An action must carry the
token of the page, which prevents forged forms from other sites. Only files of the types in TYPES below the folder are served; links
that lead out of the folder are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
import secrets
import subprocess
import sys
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

import twin
from twin.desk.entries import MOST, Entry, entries_in
from twin.errors import InputError

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
}
"""Served file types: ending -> content type."""

Started = Callable[[Sequence[str]], "subprocess.Popen[str]"]


def twin_command(words: Sequence[str]) -> subprocess.Popen[str]:
    """Start a twin command as a separate process."""
    return subprocess.Popen(
        [sys.executable, "-m", "twin", *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


class Desk(ThreadingHTTPServer):
    """The server of one folder; `start` starts a twin command."""

    daemon_threads = True

    def __init__(self, folder: Path, port: int, start: Started = twin_command) -> None:
        self.folder, self.start, self.token = folder.resolve(), start, secrets.token_urlsafe(16)
        try:
            super().__init__((HOST, port), _Answer)
        except OSError as error:
            raise InputError(f"port {port}: cannot be used ({error.strerror}); give another --port") from None

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closes the connection early."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """URL of the desk."""
        return f"http://{HOST}:{self.server_address[1]}/"


class _Answer(BaseHTTPRequestHandler):
    server: Desk

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
        if not length.isdigit() or int(length) > LONGEST_FORM:
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
        _, said = started.communicate()
        if started.returncode:
            self._page(said.strip() or "The comparison failed.", HTTPStatus.UNPROCESSABLE_ENTITY)
        else:
            self._to(f"/file/{quote(out.relative_to(self.server.folder).as_posix())}/report.html")

    def _replay(self, entry: Entry) -> None:
        folder = self.server.folder / entry.path
        rebuilt = entry.machine_file and not any(folder.glob("*.rrd"))  # from the trace, so on the machine of the run
        self.server.start(["replay", str(folder), *(["--machine", str(entry.machine_file)] if rebuilt else [])])
        self._to("/")

    def _from_here(self) -> bool:
        """Whether the request names this computer as its host; refuses it otherwise."""
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if host in (HOST, "localhost"):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, f"open {self.server.address}")
        return False

    def _page(self, message: str = "", status: HTTPStatus = HTTPStatus.OK) -> None:
        environment = Environment(
            loader=PackageLoader("twin.desk", "."), autoescape=select_autoescape(["html"], default=True), undefined=StrictUndefined
        )
        shown: Mapping[str, object] = {
            "folder": self.server.folder.name or str(self.server.folder),
            "entries": entries_in(self.server.folder),
            "most": MOST,
            "version": twin.__version__,
            "token": self.server.token,
            "message": message,
        }
        self._send(status, "text/html; charset=utf-8", environment.get_template("desk.html").render(shown).encode())

    def _file(self, name: str) -> None:
        try:
            file = (self.server.folder / name).resolve()
            if not file.is_relative_to(self.server.folder) or file.suffix.lower() not in TYPES or not file.is_file():
                raise FileNotFoundError
            content = file.read_bytes()
        except (OSError, ValueError):
            self._refuse(HTTPStatus.NOT_FOUND, "no such file on this desk")
            return
        self._send(HTTPStatus.OK, TYPES[file.suffix.lower()], content)

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        # reports cannot run scripts or load anything from other hosts
        self.send_header(
            "Content-Security-Policy", "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; form-action 'self'"
        )
        self.end_headers()
        self.wfile.write(content)

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{text}\n".encode())

    def _to(self, place: str) -> None:
        self.send_response(HTTPStatus.SEE_OTHER)
        self.send_header("Location", place)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Do not log requests on the terminal."""
