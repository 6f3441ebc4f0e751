"""A seeded part of `scripts/fuzz --only recording`: damaged recordings are imported or refused in one line."""

from pathlib import Path

from devtools.fuzz_recordings import recording


def test_no_mutilated_recording_ends_in_a_traceback(tmp_path: Path) -> None:
    results = [recording(seed, tmp_path / str(seed), []) for seed in range(30)]
    assert [fault for _, fault in results if fault] == []
    codes = {code for code, _ in results}
    assert codes == {0, 2}  # some are read, some are refused
