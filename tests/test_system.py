"""Only twin/system.py needs what not every system has, and the package works where it is missing."""

from __future__ import annotations

import ast
from pathlib import Path
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
    "AF_UNIX",
}  # fmt: skip
"""Attributes of os, signal, socket and pathlib that not every system has."""
OPTIONS = {"start_new_session", "preexec_fn", "process_group", "creationflags", "dir_fd", "src_dir_fd"}
"""Arguments that not every system takes."""


def needs(file: Path) -> set[str]:
    """What a file needs that not every system has."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            found |= {str(node.module)} & MODULES
        elif isinstance(node, ast.Attribute) and node.attr in NAMES:
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


ELSEWHERE = """
    import os, sys
    import filelock, numpy, psutil, subprocess, tempfile  # they know the system that they were installed on
    filelock.lock_descriptor
    for name in ("fcntl", "resource", "pwd", "grp", "termios"):
        sys.modules[name] = None
    for name in ("O_NOFOLLOW", "O_DIRECTORY", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY", "sched_getaffinity", "set_blocking", "pread", "killpg", "getuid"):
        vars(os).pop(name, None)
    os.supports_dir_fd = set()
    from twin import system
    from twin.files import beside, hold_folders, output_file, output_folder, release_folders, write_whole
    from pathlib import Path
    assert not system.BY_DESCRIPTOR and system.cores() > 0 and system.memory_bytes() > 1e8
    place = Path(sys.argv[1])
    hold_folders()
    out = output_folder(place / "out")
    write_whole(out / "below" / "a.json", "first")
    write_whole(out / "below" / "a.json", "second")
    write_whole(output_file(place / "b.json"), "third")
    release_folders()
    done = system.tried("import sys; print(sys.argv[1])", "x", most_bytes=4e9, seconds=20)
    assert done.stdout.split() == [b"x"], done
    from twin.cli import main
    (place / "p.mpf").write_text("G1 X1 F1000\\nM30\\n")
    assert main(["check", str(place / "p.mpf"), "--json", str(place / "check.json")]) == 0
    assert main(["run", str(place / "p.mpf"), "--out", str(place / "run"), "--no-recording"]) == 0
"""


def test_the_package_works_on_a_system_that_lacks_it_all(tmp_path: Path) -> None:
    """Files by path, no limits of a process: as on a system that none of us has at hand."""
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(ELSEWHERE), str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "out" / "below" / "a.json").read_text() == "second"
    files = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert {"b.json", "check.json", "run/summary.json", "run/trace.parquet"} <= files
    assert not [name for name in files if ".twin" in name or "/." in name]


def test_the_memory_of_a_container_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = system.memory_bytes()
    for text, expected in (("max\n", whole), ("1000000\n", 1e6), ("9e99\n", whole)):
        (tmp_path / "memory.max").write_text(text)
        monkeypatch.setattr(system, "_CONTAINER_LIMITS", (str(tmp_path / "memory.max"),))
        assert system.memory_bytes() == expected
