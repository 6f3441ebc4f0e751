"""Commands on a full disk, under signals, beside a second command in the same folder, without a parent, and with a defect."""

from __future__ import annotations

import contextlib
import json
import math
import os
from pathlib import Path
import re
import signal
import socket
import stat
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from tests.builders.refused import refused
from tests.builders.small_machine import MJCF, TOML
from twin.cli import main
from twin.errors import InputError
from twin.files import LOCK, beside, hold_folders, output_file, output_folder, release_folders, write_whole
from twin.recordings.trace import Trace, write_trace
from twin.stopping import PARENT

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals, locks and limits of Unix")
WORKS_S = 60  # the work of a script that is stopped


@contextlib.contextmanager
def full_disk(size: int = 4096):
    """Limit the size of files of this process, which behaves like a full disk."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def long_trace() -> Trace:
    rng = np.random.default_rng(0)
    return Trace(np.arange(20_000) * 1e-3, {("X", "setpoint"): rng.standard_normal(20_000)}, {"X": "linear"})


WRITERS = {
    "a.json": lambda path: write_whole(path, "x" * 100_000),
    "a.parquet": lambda path: write_trace(long_trace(), path),
    "a.csv": lambda path: write_trace(long_trace(), path),
}


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file_or_none(name: str, old: bool, tmp_path: Path) -> None:
    path = tmp_path / name
    if old:
        path.write_text("old")
    with full_disk(), pytest.raises(InputError, match=f"{name}: cannot be written"):
        WRITERS[name](path)
    assert [p.name for p in tmp_path.iterdir()] == ([name] if old else [])
    assert not old or path.read_text() == "old"
    WRITERS[name](path)
    assert path.stat().st_size > 4096


ON_A_FULL_DISK = """
    import resource, signal, sys
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, resource.RLIM_INFINITY))
    from twin.cli import main
    sys.exit(main(["replay", *sys.argv[1:]]))
"""


def test_a_recording_on_a_full_disk_is_removed(tmp_path: Path) -> None:
    """The library that writes recordings reports no error on a full disk, only lines of its own."""
    write_trace(long_trace(), tmp_path / "a.csv")
    (tmp_path / "out").mkdir()
    command = [sys.executable, "-c", textwrap.dedent(ON_A_FULL_DISK), str(tmp_path / "a.csv"), "--out", str(tmp_path / "out" / "a.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "TQDM_DISABLE": "1"}, check=False)
    said = [line for line in done.stderr.splitlines() if "compiled functions" not in line]  # the cache cannot be written either
    assert (done.returncode, len(said)) == (2, 1), done.stderr
    assert "a.rrd: is incomplete (is the disk full?)" in said[0]
    assert list((tmp_path / "out").iterdir()) == []


def test_a_stopped_write_leaves_no_file(tmp_path: Path) -> None:
    def stopped() -> None:
        with beside(tmp_path / "a.txt") as partial:
            partial.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_output_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.identify.plan.plan_campaign", lambda *_: pytest.fail("the work began"))
    (tmp_path / "file").write_text("x")
    for place in (tmp_path / "file" / "out.toml", tmp_path, Path("."), Path("/"), Path("..")):
        for write in (output_file, lambda path: write_whole(path, "text")):
            with pytest.raises(InputError, match=r"cannot be written|is a folder"):
                write(place)
    assert "file" in refused(capsys, "plan", "--out", str(tmp_path / "file" / "plan"))
    assert "is a folder" in refused(capsys, "iso", "230-2", "examples/x_200mm.csv", "--json", ".")


def is_root() -> bool:
    return os.name == "posix" and os.geteuid() == 0


def link_to_a_file(path: Path) -> None:
    (path.parent / "kept").write_text("kept")
    path.symlink_to("kept")


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        before = os.getcwd()
        os.chdir(path.parent)  # the name of a socket is short
        try:
            one.bind(path.name)
        finally:
            os.chdir(before)


OTHER_KINDS = {
    "a link": link_to_a_file,
    "a link that leads nowhere": lambda path: path.symlink_to("nowhere"),
    "a loop of links": lambda path: path.symlink_to(path.name),
    "a folder": lambda path: path.mkdir(),
    "a socket": a_socket,
}


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_only_a_regular_file_is_replaced(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    OTHER_KINDS[kind](path)
    before = {p.name: (p.lstat().st_mode, p.lstat().st_ino) for p in tmp_path.iterdir()}
    with pytest.raises(InputError, match=r"d.json: (is .* not replaced|cannot be written)"):
        output_file(path)
    with pytest.raises(InputError, match=r"d.json: (is .* not replaced|cannot be written)"):
        write_whole(path, "text")
    assert {p.name: (p.lstat().st_mode, p.lstat().st_ino) for p in tmp_path.iterdir()} == before
    assert not (tmp_path / "kept").exists() or (tmp_path / "kept").read_text() == "kept"


@contextlib.contextmanager
def read_end(path: Path):
    """The reading end of a pipe, as another program has it open."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def test_devices_and_pipes_are_written_into(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.json"
    os.mkfifo(path)
    with pytest.raises(InputError, match=r"d.json: cannot be written"):
        write_whole(path, "nobody reads")
    with read_end(path) as reader:
        write_whole(output_file(path), "text\n")
        assert os.read(reader, 100) == b"text\n"
    assert path.is_fifo()
    program = tmp_path / "p.mpf"
    program.write_text("G1 X1 F1000\nM30\n")
    null = Path(os.devnull)
    if is_root():  # who could replace the device of this computer
        os.mknod(null := tmp_path / "null", 0o666 | stat.S_IFCHR, os.makedev(1, 3))
    assert main(["check", str(program), "--json", str(null)]) == 0
    assert null.is_char_device()
    done = subprocess.run(
        [sys.executable, "-m", "twin", "check", str(program), "--quiet", "--json", "/dev/stdout"], capture_output=True, check=False
    )
    assert json.loads(done.stdout)["schema"] == "programs/1"
    capsys.readouterr()


@pytest.mark.skipif(not is_root(), reason="only root makes devices")
def test_a_device_that_root_names_stays_a_device(tmp_path: Path) -> None:
    """In a container without protection, --json /dev/null must not replace the device."""
    for name, minor in (("null", 3), ("full", 7)):
        os.mknod(tmp_path / name, 0o666 | stat.S_IFCHR, os.makedev(1, minor))
    os.mknod(tmp_path / "disk", 0o600 | stat.S_IFBLK, os.makedev(7, 250))
    write_whole(tmp_path / "null", "text")
    with pytest.raises(InputError, match="full: cannot be written"):
        write_whole(tmp_path / "full", "text" * 100_000)
    with pytest.raises(InputError, match="disk: is a device or socket and is not replaced"):
        write_whole(tmp_path / "disk", "text")
    assert [stat.S_IFMT(p.lstat().st_mode) for p in sorted(tmp_path.iterdir())] == [stat.S_IFBLK, stat.S_IFCHR, stat.S_IFCHR]


def test_a_folder_that_is_swapped_for_a_link_is_not_written_to(tmp_path: Path) -> None:
    """Neither the files of the link's target nor its folders change, whenever the swap happens; the folder itself keeps what was written."""
    for when in ("before", "during"):
        place = tmp_path / when
        for name in ("out/below", "target/below"):
            (place / name).mkdir(parents=True)
        for name in ("a.json", "below/b.json"):
            (place / "target" / name).write_text("kept")

        def swap(place: Path = place) -> None:
            (place / "out").rename(place / "moved")
            (place / "out").symlink_to("target")

        hold_folders()
        try:
            out = output_folder(place / "out")
            if when == "before":
                swap()
            for name in ("a.json", "below/b.json"):
                with contextlib.suppress(InputError), beside(out / name) as partial:
                    if when == "during" and not (place / "moved").exists():
                        swap()
                    partial.write_text("written")
        finally:
            release_folders()
        kept = {p.relative_to(place / "target").as_posix(): p.read_text() for p in (place / "target").rglob("*") if p.is_file()}
        assert kept == {"a.json": "kept", "below/b.json": "kept"}


def test_a_link_below_the_output_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").mkdir()
    hold_folders()
    try:
        out = output_folder(tmp_path / "out")
        (out / "plots").symlink_to(tmp_path / "target")
        with pytest.raises(InputError, match=r"a.json: cannot be written"):
            write_whole(out / "plots" / "a.json", "text")
    finally:
        release_folders()
    assert list((tmp_path / "target").iterdir()) == []


@pytest.mark.parametrize("kind", [k for k in OTHER_KINDS if k != "a socket"] + ["a pipe"])
def test_a_lock_that_is_no_file_is_refused(kind: str, tmp_path: Path) -> None:
    {**OTHER_KINDS, "a pipe": os.mkfifo}[kind](tmp_path / LOCK)
    hold_folders()
    try:
        with pytest.raises(InputError, match=re.escape(f"{LOCK}: ")):
            output_folder(tmp_path)
    finally:
        release_folders()
    assert not (tmp_path / "kept").exists() or (tmp_path / "kept").read_text() == "kept"
    assert not (tmp_path / "nowhere").exists()


def test_a_second_command_in_one_folder_is_refused(tmp_path: Path) -> None:
    other = "import sys; from twin.files import *; hold_folders(); output_folder(sys.argv[1])"
    command = [sys.executable, "-c", other, str(tmp_path)]
    hold_folders()
    try:
        output_folder(tmp_path)
        output_folder(tmp_path)  # the same command may lock it again
        second = subprocess.run(command, capture_output=True, text=True, check=False)
        assert "another twin command is writing here" in second.stderr
        assert str(os.getpid()) in second.stderr
    finally:
        release_folders()
    assert not (tmp_path / LOCK).exists()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0


def ended(script: str, number: int, after: float) -> tuple[int, str, float]:
    """(exit code, standard error, seconds from signal to end) of a script that gets a signal."""
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(after)
    begun = time.monotonic()
    process.send_signal(number)
    _, error = process.communicate(timeout=120)
    return process.returncode, error, time.monotonic() - begun


IN_C = """
    from twin.__main__ import run
    import twin.cli.effects, hashlib, sys
    def carry_out(args):
        print("ready", flush=True)
        hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)  # like compiled code: no Python signal handler runs meanwhile
    twin.cli.effects.carry_out = carry_out
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""
IN_THREADS = """
    from twin.__main__ import run
    import twin.cli.effects, time
    from concurrent.futures import ThreadPoolExecutor
    def carry_out(args):
        with ThreadPoolExecutor(2) as pool:
            work = pool.submit(time.sleep, 60)
            print("ready", flush=True)
            work.result()
    twin.cli.effects.carry_out = carry_out
    import sys
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""


WRITING = """
    import os, sys
    from twin.__main__ import run
    from twin.files import beside, output_folder
    import twin.cli.effects, hashlib
    def carry_out(args):
        with beside(output_folder(os.environ["OUT"]) / "a.txt") as partial:
            partial.write_text("half")
            print("ready", flush=True)
            hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
    twin.cli.effects.carry_out = carry_out
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""


def test_a_command_that_ends_in_compiled_code_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As while functions are compiled for the first time: the main thread cannot clean up."""
    monkeypatch.setenv("OUT", str(tmp_path))
    code, error, _ = ended(WRITING, signal.SIGINT, 0.2)
    assert (code, error) == (130, "twin: stopped by the user\n")
    assert list(tmp_path.iterdir()) == []


IN_AN_IMPORT = """
    from twin.__main__ import run
    import twin.cli.effects, sys, time
    def carry_out(args):
        try:
            print("ready", flush=True)
            time.sleep(60)
        except BaseException:
            raise ImportError("initialization failed") from None
    twin.cli.effects.carry_out = carry_out
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""


@pytest.mark.parametrize("script", [IN_C, IN_THREADS, IN_AN_IMPORT])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command_before_its_work_is_done(script: str, number: int) -> None:
    code, error, seconds = ended(script, number, 0.2)
    assert code == 128 + number
    assert error.count("\n") == 1
    assert error.startswith("twin: stopped by")
    assert seconds < WORKS_S / 3.0  # at once, but a loaded computer takes its time


SWALLOWED = """
    from twin.__main__ import run
    import twin.cli.effects, time, weakref
    class Held: pass
    def carry_out(args):
        held = Held()
        def swallows(_):
            print("ready", flush=True)
            time.sleep(60)
        kept = weakref.ref(held, swallows)  # an exception in a callback is printed and forgotten
        del held
    twin.cli.effects.carry_out = carry_out
    import sys
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_a_callback_swallows_stops_the_command_all_the_same(number: int) -> None:
    code, error, seconds = ended(SWALLOWED, number, 0.2)
    assert code == 128 + number
    assert error.startswith("twin: stopped by")
    assert error.count("\n") == 1
    assert seconds < WORKS_S / 3.0  # at once, but a loaded computer takes its time


IN_THE_FIRST_MOMENT = """
    import os, signal, sys
    import twin.__main__ as command
    command.return_memory = lambda: os.kill(os.getpid(), signal.{})
    sys.exit(command.run())
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_first_moment_is_one_line(number: signal.Signals) -> None:
    """Before the command itself is loaded."""
    script = textwrap.dedent(IN_THE_FIRST_MOMENT.format(number.name))
    done = subprocess.run([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (128 + number, 1)
    assert done.stderr.startswith("twin: stopped by")


def test_a_worker_ends_with_its_parent() -> None:
    worker = "from twin.stopping import end_with_parent; end_with_parent(); import time; print('ready', flush=True); time.sleep(300)"
    parent = f"import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', {worker!r}]); print(p.pid, flush=True); p.wait()"
    process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    assert process.stdout.readline() == "ready\n"
    process.kill()
    process.wait()
    for _ in range(600):
        if not _runs(child):
            break
        time.sleep(0.1)
    assert not _runs(child)


ORPHAN = """
    import multiprocessing, os, time
    def work(pipe):
        while os.getppid() == parent:
            time.sleep(0.05)
        from twin.stopping import end_with_parent
        end_with_parent()
        time.sleep(300)
    parent = os.getpid()
    worker = multiprocessing.get_context("fork").Process(target=work, args=(None,))
    worker.start()
    print(worker.pid, flush=True)
    os._exit(0)
"""


def test_a_worker_whose_parent_is_gone_before_it_looks_ends_too() -> None:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(ORPHAN)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        timeout=120,
        check=False,
    )
    child = int(done.stdout)
    for _ in range(600):
        if not _runs(child):
            break
        time.sleep(0.1)
    assert not _runs(child)


def test_a_program_whose_parent_is_gone_before_it_looks_ends_too() -> None:
    script = "from twin.stopping import end_with_parent; end_with_parent(); import time; time.sleep(300)"
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], stdout=subprocess.PIPE, text=True, check=True)
    done = subprocess.run([sys.executable, "-c", script], env={**os.environ, PARENT: gone.stdout.strip()}, timeout=120, check=False)
    assert done.returncode == 143


UNEXPECTED = """
    from twin.__main__ import run
    import twin.cli.effects, sys
    def carry_out(args):
        raise {error}
    twin.cli.effects.carry_out = carry_out
    sys.argv = ["twin", "effects"]
    sys.exit(run())
"""


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            "KeyError('a' + chr(10) + 'b')",
            ("defect in twin", "not in your input: KeyError", "at twin/cli/parser.py:", "TWIN_TRACEBACK=1"),
        ),
        ("MemoryError", ("not enough memory",)),
    ],
)
def test_an_unexpected_error_is_one_line_that_names_it_a_defect(error: str, words: tuple[str, ...]) -> None:
    script = textwrap.dedent(UNEXPECTED.format(error=error))
    without = {k: v for k, v in os.environ.items() if k != "TWIN_TRACEBACK"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=without, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith("twin: ")
    for word in words:
        assert word in done.stderr
    in_full = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env={**without, "TWIN_TRACEBACK": "1"}, check=False
    )
    assert "Traceback" in in_full.stderr


WARNS_IN_A_WORKER = """
    from twin.__main__ import run
    import twin.cli.effects, logging, multiprocessing, sys, warnings
    from concurrent.futures import ProcessPoolExecutor
    from twin.stopping import end_with_parent
    def carry_out(args):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent) as pool:
            pool.submit(warnings.warn, "a library says so", RuntimeWarning).result()
            pool.submit(say).result()
        say()
    def say():
        logging.getLogger("library").warning("a library says so")
    if __name__ == "__main__":
        twin.cli.effects.carry_out = carry_out
        sys.argv = ["twin", "effects"]
        sys.exit(run())
"""


def test_warnings_and_log_records_of_libraries_are_not_printed(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(textwrap.dedent(WARNS_IN_A_WORKER))
    without = {k: v for k, v in os.environ.items() if k != "PYTHONWARNINGS"}
    done = subprocess.run([sys.executable, str(tmp_path / "script.py")], capture_output=True, text=True, env=without, check=False)
    assert (done.returncode, done.stderr) == (0, "")


NAMES = {"bytes": b"a\xff$x_{", "letters": "<b>&\n\u00e9\u2028".encode(), "signs": b"-x %s {0} #"}


@pytest.mark.parametrize("kind", NAMES)
def test_names_of_any_bytes_and_a_terminal_of_ascii(kind: str, tmp_path: Path) -> None:
    """A run in a folder of such a name works; a name with bytes that are not text is refused."""
    place, name = os.fsencode(tmp_path) + b"/" + NAMES[kind], NAMES[kind] + b".csv"
    os.mkdir(place)
    moves = [f"{i * 1e-3:.3f},{0.02 * (1 - math.cos(2 * math.pi * i / 50)):.6f}" for i in range(51)]
    trace = "\n".join(["time [s],U.setpoint [mm]", *moves, ""])
    for file, content in ((b"small.toml", TOML), (b"small.xml", MJCF), (name, trace)):
        Path(os.fsdecode(place + b"/" + file)).write_text(content, encoding="utf-8")
    options = [b"--machine", place + b"/small.toml", b"--out", place + b"/out"]

    def done(file: bytes) -> subprocess.CompletedProcess[bytes]:
        command = [os.fsencode(sys.executable), b"-m", b"twin", b"run", file, *options]
        return subprocess.run(command, capture_output=True, env={**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}, check=False)

    found, missing = done(place + b"/" + name), done(place + b"/none" + name)
    if kind == "bytes":
        assert b"not valid UTF-8" in found.stderr
    else:
        assert (found.returncode, found.stderr) == (0, b"")
        assert {"run.rrd", "summary.json"} <= {p.name for p in Path(os.fsdecode(place + b"/out")).iterdir()}
    for one in (missing, *([found] if kind == "bytes" else [])):
        assert (one.returncode, one.stderr.count(b"\n")) == (2, 1)
        assert one.stderr.startswith(b"twin: ")


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"
    except OSError:
        return False
