"""What differs between Linux, macOS and Windows: folders by descriptor, limits of a process, memory, cores. No other module asks the system for these.

Where a system lacks something, the function here does the next best thing: Windows has no descriptors of folders, so its files are named by path.
"""

from __future__ import annotations

import contextlib
import glob
import os
from pathlib import Path
import shlex
import stat
import subprocess
import sys
import time
from typing import Any

BY_DESCRIPTOR = os.open in os.supports_dir_fd and hasattr(os, "O_NOFOLLOW") and hasattr(os, "O_DIRECTORY")
"""Whether files can be opened relative to an open folder."""
_SAFE = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


class Folder:
    """An open folder. Its names are opened, replaced and removed through its descriptor; no link in the place of a name is followed.

    The descriptor stays with the folder that was opened, also if somebody puts another folder or a link in its place.
    """

    def __init__(self, path: Path, parent: Folder | None = None) -> None:
        """Open a folder by its path, or by its name in a `parent`; a link is followed only by path. Raises OSError."""
        self.path = path
        self._descriptor: int | None = None
        if BY_DESCRIPTOR:
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
            if parent is None:
                self._descriptor = os.open(path, flags)
            else:
                self._descriptor = os.open(path.name, flags | os.O_NOFOLLOW, dir_fd=parent._descriptor)

    def __enter__(self) -> Folder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the descriptor."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _of(self, name: str) -> str | Path:
        return name if self._descriptor is not None else self.path / name

    def below(self, name: str) -> Folder:
        """The open folder `name` in this one, which is created if it is missing. A link is refused (OSError)."""
        with contextlib.suppress(FileExistsError):
            os.mkdir(self._of(name), dir_fd=self._descriptor)
        return Folder(self.path / name, self)

    def look(self, name: str) -> os.stat_result | None:
        """What stands under a name, links not followed; None if nothing does."""
        try:
            return os.stat(self._of(name), dir_fd=self._descriptor, follow_symlinks=False)
        except FileNotFoundError:
            return None

    def open(self, name: str, create: bool = False) -> int:
        """Descriptor of a regular file for reading and writing. Raises OSError for a link, FileExistsError for any other kind of file."""
        descriptor = os.open(self._of(name), os.O_RDWR | _SAFE | (os.O_CREAT if create else 0), 0o666, dir_fd=self._descriptor)
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise FileExistsError(17, "is no regular file", name)
        return descriptor

    def replace(self, name: str, by: str) -> None:
        """Put the file `by` in the place of `name`."""
        os.replace(self._of(by), self._of(name), src_dir_fd=self._descriptor, dst_dir_fd=self._descriptor)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there and the system allows it."""
        with contextlib.suppress(OSError):
            os.unlink(self._of(name), dir_fd=self._descriptor)


def pours_into(path: Path) -> bool:
    """Whether an output is written into `path` instead of replacing it: a device such as /dev/null, a pipe, or this command's own output."""
    try:
        found = os.stat(path)
    except OSError:
        return False
    return stat.S_ISCHR(found.st_mode) or stat.S_ISFIFO(found.st_mode) or any(_is_stream(found, number) for number in (1, 2))


def pour(file: Path, path: Path) -> None:
    """Write the content of a file into a device, a pipe or a stream. Raises OSError, also for a pipe that nobody reads."""
    import shutil

    found = os.stat(path)
    own = next((number for number in (1, 2) if _is_stream(found, number)), None)
    descriptor = os.dup(own) if own is not None else os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))
    if own is None and hasattr(os, "set_blocking"):
        os.set_blocking(descriptor, True)
    with file.open("rb") as source, os.fdopen(descriptor, "wb") as target:
        shutil.copyfileobj(source, target)


def _is_stream(found: os.stat_result, number: int) -> bool:
    with contextlib.suppress(OSError):
        return os.path.samestat(found, os.fstat(number))
    return False


def memory_bytes() -> float:
    """Memory of this computer, or of the container that this process runs in [bytes]."""
    import psutil

    found = [float(psutil.virtual_memory().total)]
    for file in _CONTAINER_LIMITS:
        with contextlib.suppress(OSError, ValueError):
            found.append(float(Path(file).read_text(encoding="ascii")))  # "max": no limit
    return min(found)


def return_memory() -> None:
    """Have the GNU C library use freed arrays again for those of any thread, and return them to the system where they are many.

    By default each thread has an arena of its own whose gaps no other thread fills: a diagnosis held twice the memory that it used. Arrays as blocks
    of their own would be returned at once, but then the system clears every page again, which took a third of the processor time of a quick diagnosis.
    Called again after a step that needed much memory, it returns the gaps, too.
    """
    import ctypes

    with contextlib.suppress(OSError, AttributeError, TypeError):
        for option, value in _MALLOC.items():
            ctypes.CDLL(None).mallopt(option, value)
        ctypes.CDLL(None).malloc_trim(0)


_MALLOC = {-8: 1, -3: 1 << 25, -1: 1 << 27}
"""M_ARENA_MAX, M_MMAP_THRESHOLD [byte] and M_TRIM_THRESHOLD [byte] of malloc.h."""


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_LIMITED = """
import sys
most, seconds = int(sys.argv.pop(1)), int(sys.argv.pop(1))
try:
    import resource
    for kind, limit in ((resource.RLIMIT_AS, most), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
        try:
            resource.setrlimit(kind, (limit, limit))
        except (ValueError, OSError):
            pass  # macOS refuses some
except ImportError:
    pass  # Windows has no such limits
"""


def tried(
    code: str, *arguments: str, most_bytes: float, seconds: int, cwd: Path | None = None
) -> subprocess.CompletedProcess[bytes] | None:
    """Python code run in a process of its own with limits on memory and processor time; None if it does not end.

    For files that can crash their library or fill the memory. `code` finds its `arguments` in sys.argv[1:].
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-c", _LIMITED + code, str(int(most_bytes)), str(seconds), *arguments]
    try:
        return subprocess.run(command, capture_output=True, check=False, timeout=4 * seconds, env={**os.environ, **threads}, cwd=cwd)
    except subprocess.TimeoutExpired:
        return None


def start_apart(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
    """Start a program that the terminal's Ctrl-C does not reach."""
    if os.name == "nt":
        options["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP  # type: ignore[attr-defined, unused-ignore]
    else:
        options["start_new_session"] = True
    return subprocess.Popen(command, **options)


def end_tree(process: subprocess.Popen[Any], patience_s: float = 5.0) -> None:
    """End a program and all that it started: asked first, killed after `patience_s`."""
    import psutil

    with contextlib.suppress(psutil.Error):
        parent = psutil.Process(process.pid)
        tree = [*parent.children(recursive=True), parent]
        for one in tree:
            with contextlib.suppress(psutil.Error):
                one.terminate()
        for one in psutil.wait_procs(tree, patience_s)[1]:
            with contextlib.suppress(psutil.Error):
                one.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience_s)


def wait_for_end(number: int, look_s: float = 0.5) -> None:
    """Return when the process with this number has ended, at once if there is none; `look_s` is the time between two looks [s]."""
    import psutil

    with contextlib.suppress(psutil.Error):
        process = psutil.Process(number)
        while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
            time.sleep(look_s)


def command_line() -> list[str]:
    """Arguments of this command. The shells of Windows leave wildcards to the program."""
    return with_wildcards(sys.argv[1:]) if os.name == "nt" else sys.argv[1:]


def with_wildcards(arguments: list[str]) -> list[str]:
    """Arguments in which files stand for the `*` and `?` that match them, as in a shell of Unix; `[` stays itself."""
    return [name for given in arguments for name in (set(given) & set("*?") and sorted(glob.glob(given.replace("[", "[[]")))) or [given]]


def shell_word(path: Path) -> str:
    """A path as one word of a command that the user types in; Windows knows no single quotes."""
    return subprocess.list2cmdline([str(path)]) if os.name == "nt" else shlex.quote(str(path))


def has_display() -> bool:
    """Whether a window can be opened."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
