"""A study on a real Dask scheduler with two workers on the loopback; one of them is killed in the middle."""

from collections.abc import Iterator
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

import pytest

from tests.builders.refused import refused
from tests.builders.study_files import FACTOR, GRID, rows_of, write_spec
from twin.study.design import variants_of
from twin.study.execution import Store, carry_out, dask_cluster, fingerprint
from twin.study.results import table_of
from twin.study.spec import read_study

pytest.importorskip("distributed", reason="no Dask here: pip install 'twin[cluster]'")

QUIET = {**os.environ, "DASK_DISTRIBUTED__DASHBOARD__LINK": "", "OMP_NUM_THREADS": "1"}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def started(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", *arguments]
    return subprocess.Popen(command, env=QUIET, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster() -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and its two workers of one thread each."""
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler = started("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-show")
    worker = ("distributed.cli.dask_worker", address, "--host", "127.0.0.1", "--no-nanny", "--nthreads", "1", "--no-dashboard")
    workers = [started(*worker) for _ in range(2)]
    try:
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(
    tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]], capsys: pytest.CaptureFixture[str]
) -> None:
    address, processes = cluster
    spec = write_spec(tmp_path, FACTOR + GRID.replace("3", "24"))
    expected = rows_of(spec, tmp_path / "here", threads=2)
    study = read_study(spec)
    variants = variants_of(study)
    store = Store(tmp_path / "there", fingerprint(study, variants), resume=False)
    came: list[float] = []

    def kill_one(_: None) -> None:
        came.append(time.monotonic())
        if len(came) == 6:
            processes[0].send_signal(signal.SIGKILL)
            processes[0].wait()

    # the workers have done another study before, on another machine of the same name
    (tmp_path / "before").mkdir()
    earlier = read_study(write_spec(tmp_path / "before", '[fixed]\n"axis.X.coulomb_friction_nm" = 3.0\n' + FACTOR + GRID))
    with dask_cluster(address) as workers:
        first = Store(tmp_path / "earlier", fingerprint(earlier, variants_of(earlier)), resume=False)
        carry_out(earlier, variants_of(earlier), first, workers, lambda _: None)
        assert first.rows()[0][2] != expected[0][2]
        first.close()

    with dask_cluster(address) as workers:
        deadline = time.monotonic() + 120.0
        while workers.count() < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert workers.count() == 2
        carry_out(study, variants, store, workers, kill_one)
        assert workers.count() == 1
    rows = store.rows()
    store.close()
    assert len(came) == len(variants)
    assert processes[0].returncode == -signal.SIGKILL
    assert rows == expected  # every number to the last bit, whoever computed it
    assert table_of(study, rows).equals(table_of(study, expected))

    # the last worker is lost while the scheduler stays: reported without waiting for ever
    processes[1].kill()
    processes[1].wait()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.study.execution.SECONDS_TO_ANSWER", 4)
        message = refused(capsys, "study", str(spec), "--out", str(tmp_path / "none"), "--scheduler", address)
    assert "has no worker; start some with 'dask worker" in message
