"""A command that must refuse its input: one line on standard error, exit code 2."""

import pytest

from twin.cli import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run the command line in this process; the one line it prints when it refuses."""
    try:
        code = main(arguments)
    except SystemExit as stop:  # usage errors come from the parser
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2, err or out
    assert err.startswith("twin: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert "Traceback" not in err
    return err
