"""Python as on Windows, as far as another system can play it: put this folder first on PYTHONPATH.

A file that is open or mapped is neither replaced, renamed nor removed, nor is the folder that a process works in. `os.rename` replaces nothing. Names
with `:`, `?`, `*`, `"`, `<`, `>`, `|`, or with a dot or a blank at the end, names of devices, and two names that differ in upper and lower case only
are refused. What the system lacks is missing, and processes are spawned. It counts for all processes that are started from here.

    PYTHONPATH=tests/builders/as_on_windows:. python -m pytest tests/cli
"""

import multiprocessing
import os
from pathlib import Path
import shutil
import stat
import subprocess
import sys
import tempfile

import filelock
import psutil

assert shutil, subprocess
assert tempfile, filelock  # these know the system that they were installed on
assert psutil

LACKING = (
    "O_NOFOLLOW",
    "O_DIRECTORY",
    "O_CLOEXEC",
    "O_NONBLOCK",
    "O_NOCTTY",
    "sched_getaffinity",
    "set_blocking",
    "pread",
    "killpg",
    "getuid",
)
RESERVED = {"con", "prn", "aux", "nul", *(f"{kind}{n}" for kind in ("com", "lpt") for n in range(1, 10))}
FORBIDDEN = set('<>:"|?*')
replaced_by_os = os.rename


def in_use(path: object) -> bool:
    """Whether this process has the file open or mapped."""
    try:
        found = os.stat(path, follow_symlinks=False)  # type: ignore[arg-type]
    except (OSError, TypeError, ValueError):
        return False
    if not stat.S_ISREG(found.st_mode):
        return stat.S_ISDIR(found.st_mode) and Path(os.getcwd()).is_relative_to(os.path.realpath(path))  # type: ignore[arg-type, type-var]
    for number in os.listdir("/proc/self/fd"):
        try:
            if os.path.samestat(found, os.stat(f"/proc/self/fd/{number}")):
                return True
        except OSError:
            continue
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
        return any(f" {found.st_ino} " in line for line in maps if len(line) > 70)


def refuse_name(path: object) -> None:
    """Raise OSError for a new file that Windows would not create, or would take for another one."""
    if isinstance(path, int):
        return
    path = Path(os.fsdecode(path))  # type: ignore[arg-type]
    name = path.name
    if FORBIDDEN & set(name) or any(ord(sign) < 32 for sign in name) or name.endswith((" ", ".")) or name.split(".")[0].lower() in RESERVED:
        raise OSError(22, "as on Windows: this name is not allowed", str(path))
    if not path.exists() and path.parent.is_dir():
        alike = [other for other in os.listdir(path.parent) if other.lower() == name.lower() and other != name]
        if alike:
            raise OSError(22, f"as on Windows: this is the file {alike[0]}", str(path))


def judge(event: str, arguments: tuple) -> None:
    """Audit hook of everything that Python asks the system for."""
    if event in ("os.rename", "os.remove", "os.rmdir"):
        if sys._getframe(1).f_code.co_name == "TemporaryFile":
            return  # Windows removes it when it is closed
        for path in arguments[: 2 if event == "os.rename" else 1]:
            if in_use(path):
                raise PermissionError(13, "as on Windows: the file is in use", os.fsdecode(path))
        if event == "os.rename":
            refuse_name(arguments[1])
    elif event == "os.mkdir" or (event == "open" and isinstance(arguments[2], int) and arguments[2] & os.O_CREAT):
        refuse_name(arguments[0])


def rename(source: object, target: object, **options: object) -> None:
    """`os.rename`, which replaces nothing."""
    if os.path.lexists(target):  # type: ignore[arg-type]
        raise FileExistsError(17, "as on Windows: rename replaces nothing", os.fsdecode(target))  # type: ignore[arg-type]
    replaced_by_os(source, target, **options)  # type: ignore[arg-type]


os.rename = rename  # type: ignore[assignment]
os.supports_dir_fd = set()  # type: ignore[assignment]
for lacking in LACKING:
    vars(os).pop(lacking, None)
for module in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[module] = None  # type: ignore[assignment]
multiprocessing.set_start_method("spawn", force=True)
sys.addaudithook(judge)
