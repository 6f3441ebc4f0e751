"""Programs as texts."""

from pathlib import Path

import pytest

from twin.program import read_program


@pytest.fixture
def read(mikron, tmp_path):
    """Reads a text as a program."""

    def reader(text: str, name: str = "part.mpf", machine=mikron):
        path = tmp_path / name
        path.write_text(text)
        return read_program(path, machine)

    return reader


@pytest.fixture
def write(tmp_path):
    """Writes a text as a program file."""

    def writer(text: str, name: str = "part.mpf") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return writer
