"""Only twin/system.py needs what not every system has, and the package works where it is missing."""

from __future__ import annotations

import ast
import os
from pathlib import Path
import re
import subprocess
import sys
import textwrap

import pytest

from twin import system

PACKAGE = Path(__file__).resolve().parents[1] / "twin"
MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog", "posix", "msvcrt", "winreg", "ctypes.wintypes"}
NAMES = {
    "fork", "forkpty", "killpg", "getpgid", "setsid", "getuid", "geteuid", "getgid", "sched_getaffinity", "mkfifo", "mknod", "pread", "pwrite",
    "symlink", "symlink_to", "readlink", "link", "hardlink_to", "chown", "chroot", "set_blocking", "sysconf", "uname", "getrlimit", "setrlimit",
    "O_NOFOLLOW", "O_DIRECTORY", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY", "SIGKILL", "SIGALRM", "SIGPROF", "SIGHUP", "SIGUSR1", "setitimer", "alarm",
    "AF_UNIX", "waitpid", "statvfs",
}  # fmt: skip
"""Attributes of os, signal, socket and pathlib that not every system has."""
OPTIONS = {"start_new_session", "preexec_fn", "process_group", "creationflags", "dir_fd", "src_dir_fd", "pass_fds"}
"""Arguments that not every system takes."""
OF_OS = {"kill", "wait", "nice", "system", "popen", "rename"}
"""Functions of os that another system lacks or does otherwise; `replace` stands for `rename`."""


def needs(file: Path) -> set[str]:
    """What a file needs that not every system has."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            found |= {str(node.module)} & MODULES
        elif isinstance(node, ast.Attribute) and (node.attr in NAMES or (ast.unparse(node.value) == "os" and node.attr in OF_OS)):
            found.add(node.attr)
        elif isinstance(node, ast.keyword) and node.arg in OPTIONS:
            found.add(str(node.arg))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(("/proc/", "/dev/", "/sys/", "/tmp")):
            found.add(node.value)
    return found


def test_only_one_module_needs_what_a_system_may_lack() -> None:
    found = {file.relative_to(PACKAGE).as_posix(): needs(file) for file in PACKAGE.rglob("*.py")}
    assert {name: what for name, what in found.items() if what and name != "system.py"} == {}
    assert {"O_NOFOLLOW", "sched_getaffinity", "dir_fd"} <= found["system.py"]


def left_to_the_system(file: Path) -> list[str]:
    """Calls that depend on the system: the text of some on code page, line ends or shell, the end of others on Ctrl-C."""
    found = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        given = {str(keyword.arg): keyword.value for keyword in node.keywords}
        mode = next((a.value for a in node.args[:2] if isinstance(a, ast.Constant) and re.fullmatch("[rwxab+t]{1,3}", str(a.value))), "r")
        opens = name in ("read_text", "write_text") or (
            (ast.unparse(node.func) == "open" or name in ("fdopen", "open")) and "b" not in str(mode)
        )
        if (opens and "path" not in given and "encoding" not in given and ast.unparse(node.func) not in OWN_OPEN) or (
            ("text" in given or "universal_newlines" in given) and name in ("run", "Popen", "check_output")
        ):
            found.append(f"{node.lineno}: {name} without encoding")
        if (name == "write_text" or (opens and "w" in str(mode) and "devnull" not in ast.unparse(node))) and "newline" not in given:
            found.append(f"{node.lineno}: {name} without newline")
        if isinstance(given.get("shell"), ast.Constant):
            found.append(f"{node.lineno}: a shell")
        if name == "wait" and not node.args and not given:
            found.append(f"{node.lineno}: a wait that Ctrl-C does not interrupt on Windows")
    return found


OWN_OPEN = {
    "os.open", "self.open", "folder.open", "webbrowser.open", "client.open", "gzip.open", "archive.open", "TdmsFile.open", "Image.open", "read_text",
}  # fmt: skip
"""Other functions called `open`, and the reader of the package, which knows its encoding."""


def test_no_text_depends_on_the_system() -> None:
    found = {file.relative_to(PACKAGE).as_posix(): left_to_the_system(file) for file in PACKAGE.rglob("*.py")}
    assert {name: what for name, what in found.items() if what} == {}


def test_careless_text_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "a.py"
    file.write_text(
        "open(p)\nopen(p, 'w', encoding='utf-8')\np.read_text()\np.write_text(t, encoding='utf-8')\np.open()\n"
        "subprocess.run(c, text=True)\nsubprocess.run(c, shell=True)\nos.fdopen(n, 'w')\nprocess.wait()\n"
        "open(p, 'rb')\np.open('wb')\nopen(p, 'w', encoding='utf-8', newline='')\nos.open(p, 0)\n",
        encoding="utf-8",
    )
    assert sorted({int(line.split(":")[0]) for line in left_to_the_system(file)}) == [1, 2, 3, 4, 5, 6, 7, 8, 9]


AS_ON_WINDOWS = Path(__file__).parent / "builders" / "as_on_windows"
COMMANDS = """
    demo --out demo
    run ROOT/examples/x_200mm.csv --effect backlash:X:clearance=15e-6 --beside --out worn
    run ROOT/examples/five_axis.mpf --out five_axis --no-recording
    interpolate ROOT/examples/five_axis.mpf --out setpoints.csv
    compare demo/x_200mm_off.parquet worn --out compare
    gap ROOT/examples/campaign --json gap.json --html gap.html
    iso 230-2 ROOT/examples/iso230/positions.csv --json positions.json
    import ROOT/examples/traces/x_feedforward_off.csv --out imported
    regress ROOT/examples/regression --jobs 2 --only viscous_friction --out regress
    machine check
"""


ONE_AFTER_THE_OTHER = """
    import sys
    from twin.cli import main
    for line in 2 * sys.argv[1].strip().splitlines():
        assert main(line.split()) == 0, line
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="this system has no list of open files")
def test_the_commands_work_as_on_windows(tmp_path: Path) -> None:
    """Again into the same folders, so that files are replaced by the process that made them; printed to an old code page; one as a process of its own."""
    place = {**os.environ, "PYTHONPATH": os.pathsep.join([str(AS_ON_WINDOWS), str(PACKAGE.parent)]), "PYTHONIOENCODING": "cp1252"}
    one_after_the_other = ["-c", textwrap.dedent(ONE_AFTER_THE_OTHER), COMMANDS.replace("ROOT", str(PACKAGE.parent))]
    for words in (one_after_the_other, ["-m", "twin", "machine", "check"]):
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, env=place, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        assert b"unusual: axis Z" in done.stdout  # of the last command
    files = [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")]
    assert not [name for name in files if ".twin" in name or "/." in name]


OPEN_WHEN_REPLACED = """
    import sys
    from pathlib import Path
    from twin.files import beside
    place = Path(sys.argv[1])
    place.write_text("old")
    kept = place.open()
    with beside(place) as partial:
        partial.write_text("new")
"""


def test_a_file_in_use_is_noticed(tmp_path: Path) -> None:
    """What plays Windows here refuses what Windows refuses."""
    place = {**os.environ, "PYTHONPATH": os.pathsep.join([str(AS_ON_WINDOWS), str(PACKAGE.parent)])}
    for code, words in (
        (OPEN_WHEN_REPLACED, "as on Windows: the file is in use"),
        ("open('a:b', 'w')", "not allowed"),
        ("open('a', 'w'); open('A', 'w')", "this is the file a"),
        ("import os; open('a', 'w').close(); open('b', 'w').close(); os.rename('a', 'b')", "rename replaces nothing"),
    ):
        command = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "c.txt")]
        done = subprocess.run(command, cwd=tmp_path, env=place, capture_output=True, text=True, check=False)
        assert done.returncode, words
        assert words in done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="plays Windows where it is not")
def test_every_test_is_found_where_the_modules_of_unix_are_missing() -> None:
    """A tool that needs one of them where it is imported would stop all tests. The scheduler's lock looks for Windows itself."""
    place = {**os.environ, "PYTHONPATH": os.pathsep.join([str(AS_ON_WINDOWS), str(PACKAGE.parent)])}
    words = ["-m", "pytest", "--collect-only", "-qq", "-p", "no:cacheprovider", "--ignore", "tests/study/test_cluster.py", "tests"]
    done = subprocess.run([sys.executable, *words], cwd=PACKAGE.parent, env=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


def test_the_memory_of_a_container_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = system.memory_bytes()
    for text, expected in (("max\n", whole), ("1000000\n", 1e6), ("9e99\n", whole)):
        (tmp_path / "memory.max").write_text(text)
        monkeypatch.setattr(system, "_CONTAINER_LIMITS", (str(tmp_path / "memory.max"),))
        assert system.memory_bytes() == expected


def test_wildcards_stand_for_the_files_that_they_match(tmp_path: Path) -> None:
    """The shells of Windows leave them to the program. What matches nothing stays, and so do brackets."""
    for name in ("x_2.csv", "x_1.csv", "x[1].csv"):
        (tmp_path / name).touch()
    found = system.with_wildcards(["import", f"{tmp_path}/x_*.csv", f"{tmp_path}/x[1].cs?", "--columns", "time [ms],-", "*.xml"])
    assert [Path(name).name for name in found] == ["import", "x_1.csv", "x_2.csv", "x[1].csv", "--columns", "time [ms],-", "*.xml"]
