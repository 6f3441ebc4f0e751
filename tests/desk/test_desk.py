"""The desk: what it lists, what it serves, what it refuses; two ticked runs are compared."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import contextlib
from contextlib import contextmanager
import html
import http.client
import io
import json
import os
from pathlib import Path
import re
import socket
import subprocess
import sys
import threading
from urllib.parse import urlencode
import urllib.request

import numpy as np
import pytest

from tests.builders.browser import browser, page
from twin.cli import main
from twin.desk.entries import entries_in
from twin.desk.server import Desk, Started, twin_command
from twin.files import write_json
from twin.recordings.trace import Trace, write_trace

TIME = np.arange(400) * 1e-3


def write_run(folder: Path, error: float, name: str = "x.csv") -> None:
    """A run as `twin run` leaves it: trace and summary."""
    setpoint = 0.01 * np.sin(8.0 * TIME)
    signals = {("X", "setpoint"): setpoint, ("X", "position"): setpoint - error * np.sign(np.cos(8.0 * TIME))}
    folder.mkdir(parents=True)
    write_trace(Trace(TIME, signals, {"X": "linear"}), folder / "trace.parquet")
    axis = {"error_without_delay_max": error * 1e6, "following_error_unit": "um"}
    document = {"input": name, "machine": "Mikron", "machine_file": None, "effects": [], "axes": {"X": axis}}
    write_json(document, folder / "summary.json", "summary")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run(tmp_path / "out" / "first", 2e-6, "<b>x.csv")
    write_run(tmp_path / "out" / "worn & old", 5e-6)
    (tmp_path / "out" / "first" / "run.png").write_bytes(b"\x89PNG picture")
    found = {"verdict": "effect", "effects": [{"effect": "backlash", "axis": "X"}]}
    (tmp_path / "out" / "diagnosis").mkdir()
    write_json(found, tmp_path / "out" / "diagnosis" / "diagnosis.json", "diagnosis")
    lead = '<title>Diagnosis</title>\n<meta name="description" content="Backlash on X &amp; more.">the report'
    (tmp_path / "out" / "diagnosis" / "report.html").write_text(lead)
    (tmp_path / "out" / "exam" / "cases" / "0000").mkdir(parents=True)
    write_json({"seed": 1}, tmp_path / "out" / "exam" / "exam.json", "exam")
    (tmp_path / "out" / "exam" / "cases" / "0000" / "campaign.toml").write_text("machine = 'x'")
    (tmp_path / "out" / "broken").mkdir()
    (tmp_path / "out" / "broken" / "study.json").write_text('{"a": ')
    (tmp_path / "out" / "gap.html").write_text("<title>Gap of a &amp; b</title>")
    write_json({"standard": "ISO 230-2", "verdict": "axis X: A 18.74 um"}, tmp_path / "out" / "positions.json", "iso230")
    (tmp_path / "out" / "positions.png").write_bytes(b"\x89PNG picture")
    write_json({"verdict": "as it should be"}, tmp_path / "out" / "gap.json", "gap")  # its page stands beside it
    (tmp_path / "secret.html").write_text("secret")
    return tmp_path / "out"


@contextmanager
def served(folder: Path, start: Started = twin_command) -> Iterator[Desk]:
    with Desk(folder, 0, start) as desk:
        thread = threading.Thread(target=desk.serve_forever)
        thread.start()
        try:
            yield desk
        finally:
            desk.shutdown()
            thread.join()


def ask(desk: Desk, path: str, form: list[tuple[str, str]] | None = None, host: str | None = None) -> tuple[int, str, str]:
    """Status, text, and where a redirection leads."""
    connection = http.client.HTTPConnection("127.0.0.1", desk.server_address[1], timeout=300)
    headers = {"Host": host} if host else {}
    if form is None:
        connection.request("GET", path, headers=headers)
    else:
        connection.request("POST", path, urlencode(form), {"Content-Type": "application/x-www-form-urlencoded", **headers})
    answer = connection.getresponse()
    text = answer.read().decode("utf-8", "replace")
    connection.close()
    return answer.status, text, answer.headers.get("Location", "")


def test_results_in_a_folder_are_recognised(folder: Path) -> None:
    found = {entry.path: entry for entry in entries_in(folder)}
    assert {path: entry.kind for path, entry in found.items()} == {
        "first": "run", "worn & old": "run", "diagnosis": "diagnosis", "broken": "study", "gap.html": "report", "exam": "examination",
        "positions.json": "ISO 230-2",
    }  # fmt: skip
    assert found["first"].summary == "<b>x.csv on Mikron, no effects: error of X 2.00 um"
    assert found["diagnosis"].summary == "Diagnosis. Backlash on X & more."  # title and lead of its report
    assert found["gap.html"].summary == "Gap of a & b."
    assert (found["positions.json"].summary, found["positions.json"].picture) == ("axis X: A 18.74 um", "positions.png")
    assert found["broken"].summary.startswith("cannot be read:")
    assert (found["first"].picture, found["diagnosis"].report) == ("first/run.png", "diagnosis/report.html")
    assert found["first"].compared
    assert not found["diagnosis"].compared


def test_page_and_files(folder: Path) -> None:
    with served(folder) as desk:
        status, page, _ = ask(desk, "/")
        assert status == 200
        assert "&lt;b&gt;x.csv" in page
        assert 'value="worn &amp; old"' in page
        assert ask(desk, "/file/diagnosis/report.html")[1].endswith("the report")
        assert ask(desk, "/file/first/run.png")[0] == 200


def test_nothing_outside_is_served(folder: Path) -> None:
    (folder / "link.html").symlink_to(folder.parent / "secret.html")
    (folder / "round.html").symlink_to("round.html")
    (folder / "linked").mkdir()
    (folder / "linked" / "summary.json").symlink_to(folder.parent / "secret.html")
    os.mkfifo(folder / "pipe.html")
    assert not {"link.html", "round.html", "linked", "pipe.html"} & {entry.path for entry in entries_in(folder)}
    with served(folder) as desk:
        for name in ("round.html", "pipe.html", "linked/summary.json", "x" * 3000 + ".html"):
            assert ask(desk, f"/file/{name}")[0] == 404
        for path in ("/file/../secret.html", "/file/%2e%2e/secret.html", "/file/link.html", f"/file/{folder.parent}/secret.html"):
            status, text, _ = ask(desk, path)
            assert (status, "secret" in text.replace("secret.html", "")) == (404, False), path
        assert ask(desk, "/file/first/trace.parquet")[0] == 404  # no kind that a report is made of
        assert ask(desk, "/file/%00")[0] == 404
        assert ask(desk, "/", host="evil.example")[0] == 403
        assert desk.server_address[0] == "127.0.0.1"


def test_an_action_needs_the_token_of_the_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []

    def start(words: list[str]) -> subprocess.Popen[str]:
        started.append(words)
        said = "note: a note\nopen http://127.0.0.1:9/?url=x in a browser" if "--serve" in words else ""
        return subprocess.Popen([sys.executable, "-c", f"print({said!r})"], stdout=subprocess.PIPE, text=True)

    monkeypatch.setenv("DISPLAY", ":0")
    with served(folder, start) as desk:
        ticked = [("compare", "first"), ("compare", "worn & old")]
        assert ask(desk, "/compare", [("token", "guessed"), *ticked])[0] == 403
        assert ask(desk, "/replay", [("path", "first")])[0] == 403
        assert started == []
        assert ask(desk, "/replay", [("token", desk.token), ("path", "../..")])[0] == 404
        assert ask(desk, "/replay", [("token", desk.token), ("path", "first")])[0] == 303
        assert started == [["replay", str(folder / "first")]]
        own = json.loads((folder / "first" / "summary.json").read_text(encoding="utf-8")) | {"machine_file": "mine.toml"}
        (folder / "first" / "summary.json").write_text(json.dumps(own), encoding="utf-8")
        ask(desk, "/replay", [("token", desk.token), ("path", "first")])
        assert started[-1] == ["replay", str(folder / "first"), "--machine", "mine.toml"]
        if sys.platform.startswith("linux"):
            monkeypatch.delenv("DISPLAY")
            monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
            status, page, _ = ask(desk, "/replay", [("token", desk.token), ("path", "worn & old")])
            assert started[-1] == ["replay", str(folder / "worn & old"), "--serve", "--port", "0"]
            assert (status, '<a href="http://127.0.0.1:9/?url=x"' in page) == (200, True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="without a display: a Linux server")
def test_without_a_display_the_viewer_button_leads_to_the_web_viewer(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the real command: it serves a page, says in one line why it cannot, and ends with the desk."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with served(folder) as desk:
        token = ("token", desk.token)
        status, page, _ = ask(desk, "/replay", [token, ("path", "first")])
        (address,) = set(re.findall(r'href="(http://127[^"]*)"', page))
        assert status == 200
        with urllib.request.urlopen(html.unescape(address), timeout=120) as answer:
            assert b"<html" in answer.read(2000).lower()
        assert address in ask(desk, "/replay", [token, ("path", "first")])[1]  # the same viewer again
        (folder / "worn & old" / "trace.parquet").write_bytes(b"no trace")
        status, page, _ = ask(desk, "/replay", [token, ("path", "worn & old")])
        assert (status, "trace.parquet: not a readable Parquet file" in html.unescape(page)) == (422, True)
    with pytest.raises(OSError):
        urllib.request.urlopen(html.unescape(address), timeout=5)


class InThisProcess:
    """A command carried out at once; what it says on standard error is kept."""

    def __init__(self, words: list[str]) -> None:
        said = io.StringIO()
        with contextlib.redirect_stderr(said):
            self.returncode = main(words)
        self.said = said.getvalue()

    def communicate(self) -> tuple[None, str]:
        return None, self.said


def test_two_runs_are_compared_by_ticking_them(folder: Path) -> None:
    with served(folder, InThisProcess) as desk:
        token = ("token", desk.token)
        status, page, _ = ask(desk, "/compare", [token, ("compare", "first")])
        assert (status, "Tick two runs, or two campaigns." in page) == (400, True)
        status, _, report = ask(desk, "/compare", [token, ("compare", "first"), ("compare", "worn & old")])
        assert status == 303
        status, page, _ = ask(desk, report)
        assert status == 200
        assert "differ on" in page
    assert json.loads((folder / "compared" / "first-worn & old" / "compare.json").read_text())["errors"]


@pytest.mark.skipif(browser() is None, reason="no Chromium on this computer")
def test_the_desk_in_a_real_browser(folder: Path, tmp_path: Path) -> None:
    """Two runs ticked and compared with the mouse: what the page's own policy forbids, or a redirection, is seen in a browser only."""
    with served(folder, InThisProcess) as desk, page(tmp_path / "profile") as here:
        here.open(desk.address)
        assert here.ask("document.querySelectorAll('.card').length") == 7
        assert here.ask("document.querySelectorAll('script').length") == 0
        assert "<b>x.csv" in here.ask("document.body.innerText")  # as text, not as a tag
        here.click("button:not(.plain)", leaves=True)
        assert here.ask("document.querySelector('[role=alert]').innerText") == "Tick two runs, or two campaigns."
        for path in ("first", "worn & old"):
            here.click(f'input[value="{path}"]')
        assert here.ask("document.querySelectorAll('input:checked').length") == 2
        here.click("button:not(.plain)", leaves=True)
        assert here.ask("location.pathname") == "/file/compared/first-worn%20%26%20old/report.html"
        assert "differ on" in here.ask("document.body.innerText")
        drawn = "[...document.querySelectorAll('svg, img')].map(e => e.getBoundingClientRect().width)"
        assert max(here.ask(drawn)) > 300.0
        here.open(desk.address)
        assert here.ask("document.querySelector('.name').innerText") == "compared/first-worn & old"


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["desk", str(tmp_path / "nowhere")]) == 2
    assert "no such folder" in capsys.readouterr().err
    with Desk(tmp_path, 0) as other:
        assert main(["desk", str(tmp_path), "--port", str(other.server_address[1])]) == 2
        assert "give another --port" in capsys.readouterr().err


def test_a_disconnected_browser_is_not_an_error(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Desk(folder, 0) as desk:
        for fault, said in ((BrokenPipeError, False), (ConnectionResetError, False), (ValueError, True)):
            try:
                raise fault
            except fault:
                desk.handle_error(None, ("127.0.0.1", 1))
            assert bool(capsys.readouterr().err) == said


def test_a_link_that_leads_nowhere_and_a_hidden_file_are_left_out(folder: Path) -> None:
    (folder / "old.html").symlink_to(folder / "gone.html")
    (folder / ".report.html").write_text("<title>half</title>", encoding="utf-8")
    try:
        assert not {"old.html", ".report.html"} & {entry.path for entry in entries_in(folder)}
    finally:
        (folder / "old.html").unlink()
        (folder / ".report.html").unlink()


DOCUMENTS = ["null", "true", "1", "[]", '"x"', "1e999", '{"axes": null}', '{"axes": {}}', '{"axes": {"X": {"error_without_delay_max": 1e308}}}',
             '{"verdict": null, "effects": [null]}', '{"verdict": [], "effects": {}}', "[" * 100_000, "\xff"]  # fmt: skip
"""Contents that a document of a result can have and should not."""


def test_no_document_below_it_stops_the_desk(folder: Path) -> None:
    kinds = ("summary.json", "diagnosis.json", "exam.json")
    for i, (text, name) in enumerate((text, name) for text in DOCUMENTS for name in kinds):
        (folder / f"odd{i}").mkdir()
        (folder / f"odd{i}" / name).write_bytes(text.encode("latin-1"))
    with served(folder) as desk:
        status, page, _ = ask(desk, "/")
        assert status == 200
        assert all(f'"name">odd{i}<' in page for i in range(len(DOCUMENTS) * len(kinds)))
        assert "summary.json: not a valid JSON file: the content is not an object" in page


def raw(desk: Desk, request: str) -> bytes:
    """The answer to a request that no browser makes."""
    with socket.create_connection(("127.0.0.1", desk.server_address[1]), timeout=120) as connection:
        connection.sendall(request.encode())
        return b"".join(iter(lambda: connection.recv(1 << 16), b""))


@pytest.mark.parametrize("length", ["\u00b2", "9" * 5000, "-1", "1e3", "", "999999999"])
def test_a_length_that_is_no_number_is_refused(length: str, folder: Path) -> None:
    with served(folder) as desk:
        answer = raw(desk, f"POST /replay HTTP/1.0\r\nHost: 127.0.0.1\r\nContent-Length: {length}\r\n\r\n")
        assert answer.startswith(b"HTTP/1.0 400 "), answer[:80]


def test_no_other_site_can_frame_it_and_many_requests_at_once_are_answered(folder: Path) -> None:
    with served(folder) as desk:
        assert b"frame-ancestors 'none'" in raw(desk, "GET / HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n")
        # a connection that the queue of the socket drops is repeated after 1, 3, 7 and 15 s
        assert desk.request_queue_size >= 60
        with ThreadPoolExecutor(60) as pool:
            assert list(pool.map(lambda _: ask(desk, "/file/gap.html")[0], range(60))) == [200] * 60


SERVES_AND_MEASURES = """
import sys, threading
from twin.desk.server import *
desk = Desk(Path(sys.argv[1]), 0)
print(desk.address, flush=True)
threading.Thread(target=desk.serve_forever, daemon=True).start()
sys.stdin.read()
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="measures the memory as Linux does")
def test_a_large_page_is_not_held_in_memory(folder: Path) -> None:
    """Three downloads of 300 MB each at once."""
    with (folder / "big.html").open("wb") as file:
        file.truncate(300_000_000)
    script = SERVES_AND_MEASURES
    process = subprocess.Popen([sys.executable, "-c", script, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    address = process.stdout.readline().strip()

    def download() -> None:
        with urllib.request.urlopen(f"{address}file/big.html") as answer:
            while answer.read(1 << 20):
                pass

    threads = [threading.Thread(target=download) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    said, _ = process.communicate("")
    assert int(said) < 250_000  # kB


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
@pytest.mark.parametrize(("number", "code"), [(2, 0), (15, 143)])
def test_ctrl_c_ends_the_desk_and_sigterm_stops_it(number: int, code: int, folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "desk", str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert "until Ctrl-C" in process.stdout.readline()
    process.send_signal(number)
    _, said = process.communicate(timeout=120)
    assert (process.returncode, said.count("\n")) == (code, int(code > 0)), said
