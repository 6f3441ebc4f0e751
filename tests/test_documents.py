"""Readers of TOML and JSON, files named in files, errors of reader libraries."""

from collections.abc import Callable
from pathlib import Path

import pytest

from twin.documents import named_file, read_json, read_toml, reading
from twin.errors import InputError, nearest, one_line

TOML = {
    "nesting": ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    "nesting by dots": ("a" + ".a" * 500 + " = 1", "nested more than"),
    "thousands of digits": ("x = " + "9" * 5000, "an integer has more than 4300 digits; give one below 2^63"),
    "beyond a float": ("x = 1" + "0" * 400, "an integer of 401 digits"),
    "beyond 64 bits": ("x = [1, 9223372036854775808]", "x: an integer of 19 digits"),
    "beyond any quantity": ("[a]\nx = [0.0, -1e308]", "a.x = -1e+308 is too large for any quantity"),
    "NUL in a text": ('file = "a\\u0000b"', "file: the text 'a\\x00b' contains the character NUL"),
    "NUL in a name": ('"a\\u0000b" = 1', "contains the character NUL"),
    "Latin-1": (b'name = "Fr\xe4se"', "save it as UTF-8"),
    "cut off": ("x = [1, 2", "not a valid TOML file"),
}


@pytest.mark.parametrize("case", TOML)
def test_unusable_toml_is_refused(case: str, tmp_path: Path) -> None:
    text, words = TOML[case]
    file = tmp_path / "x.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as error:
        read_toml(file)
    assert str(file) in str(error.value)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


JSON = {
    "nesting": ("[" * 200_000, "nested too deeply"),
    "thousands of digits": ("[" + "9" * 5000 + "]", "an integer has more than 4300 digits; give one below 2^63"),
    "beyond 64 bits": ('{"x": 9223372036854775808}', "x: an integer of 19 digits"),
    "NUL": ('{"x": "\\u0000"}', "contains the character NUL"),
    "cut off": ('{"x": ', "truncated or damaged"),
    "no table": ("[1]", "is not an object"),
}


@pytest.mark.parametrize("case", JSON)
def test_unusable_json_is_refused(case: str, tmp_path: Path) -> None:
    text, words = JSON[case]
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_json(file)
    assert str(file) in str(error.value)
    assert words in str(error.value)


def test_valid_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_bytes(b"\xef\xbb\xbf[a.b]\nc = [1, 2.5, true, inf, 1e99]\n")
    (tmp_path / "x.json").write_bytes(b'\xef\xbb\xbf{"a": [1, 2.5, null, true]}')
    assert read_toml(tmp_path / "x.toml") == {"a": {"b": {"c": [1, 2.5, True, float("inf"), 1e99]}}}
    assert read_json(tmp_path / "x.json") == {"a": [1, 2.5, None, True]}


def linked(folder: Path) -> object:
    (folder / "link.stl").symlink_to(folder.parent / "secret.stl")
    return "link.stl"


def circle(folder: Path) -> object:
    (folder / "a.stl").symlink_to("b.stl")
    (folder / "b.stl").symlink_to("a.stl")
    return "a.stl"


NAMES: dict[str, tuple[Callable[[Path], object], str]] = {
    "absolute": (lambda f: str(f.parent / "secret.stl"), "leaves the folder"),
    "parent folder": (lambda _: "../secret.stl", "leaves the folder"),
    "parent folder by a detour": (lambda _: "sub/../../secret.stl", "leaves the folder"),
    "link": (linked, "leaves the folder"),
    "loop of links": (circle, "no such file"),
    "missing": (lambda _: "none.stl", "no such file"),
    "a folder": (lambda _: "sub", "no such file"),
    "too long": (lambda _: "x" * 5000, "no such file"),
    "NUL": (lambda _: "a\0b", "not a file name"),
    "a list": (lambda _: ["a"], "not a file name"),
    "nothing": (lambda _: "", "not a file name"),
}


@pytest.mark.parametrize("case", NAMES)
def test_names_outside_the_folder_or_of_no_file_are_refused(case: str, tmp_path: Path) -> None:
    make, words = NAMES[case]
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "secret.stl").write_text("secret")
    with pytest.raises(InputError, match=words):
        named_file(make(folder), folder, "machine.toml: model")


def test_names_inside_the_folder_are_found(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.stl").write_text("a")
    (tmp_path / "b.stl").symlink_to("sub/a.stl")
    assert named_file("sub/a.stl", tmp_path, "x").read_text() == "a"
    assert named_file("b.stl", tmp_path, "x").read_text() == "a"
    assert named_file("../sub/a.stl", tmp_path / "sub", "x", outer=True).read_text() == "a"


@pytest.mark.parametrize(
    "error",
    [OverflowError("too large"), KeyError("a"), RecursionError(), UnicodeDecodeError("utf-8", b"", 0, 1, "bad"), AssertionError("a\nb")],
)
def test_any_error_of_a_library_becomes_an_input_error(error: Exception) -> None:
    def read() -> None:
        with reading(Path("a.mat"), "MATLAB file", "save it again"):
            raise error

    with pytest.raises(InputError, match=r"a.mat: not a readable MATLAB file; it is damaged.*: save it again$") as refused:
        read()
    assert "\n" not in str(refused.value)


def test_memory_permissions_and_input_errors_keep_their_own_message() -> None:
    for error, words in (
        (MemoryError(), "reading it fills the memory"),
        (PermissionError(), "check its permissions"),
        (InputError("b: cut off"), "^b: cut off$"),
    ):
        with pytest.raises(InputError, match=words), reading(Path("a.mat"), "MATLAB file"):
            raise error


def test_a_long_message_keeps_its_start_and_its_remedy() -> None:
    message = f"/a/b/machine.toml: [axis.X]: kind = '{'x' * 900}': {'a word and ' * 200} use one of linear, rotary"
    text = one_line(message)
    assert len(text) <= 340
    assert text.startswith("/a/b/machine.toml: [axis.X]: kind = 'xxx")
    assert text.endswith("use one of linear, rotary")
    assert one_line("short:\n  and   sweet") == "short: and sweet"
    assert len(one_line("a.tdms: column '" + "\x00\x0e\x1b[2J\u00ff " * 90 + "': give it a name")) <= 340  # counted as printed
    assert nearest(0, ["X", "Y"]) == "known are: X, Y"
    assert nearest("zzzz", [f"name{i}" for i in range(500)]).endswith("and 476 more")
