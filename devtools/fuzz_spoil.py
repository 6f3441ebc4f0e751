"""Corrupting a file by its ending: unexpected values, moved or repeated keys and elements, changed cells and bytes.

The same state of the random number generator gives the same file.
"""

from __future__ import annotations

from collections.abc import Callable
import io
import json
from pathlib import Path
import random
import re
import struct
import zipfile

from devtools import fuzz_programs

VALUES = (
    "[]", "{}", '""', "[[1]]", "[1, 2]", '["X"]', '{ a = 1 }', "true", "false", "nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "1e-308",
    "1e9", "1e-9", "1e15", "9223372036854775807", "1" + "0" * 30, "1979-05-27", "07:32:00", '"\\u0000"', '"../../x"', '"/etc/hostname"', '"."',
    '"$x_{"', '"<b>&"', '"a/b"', '"' + "x" * 400 + '"', '"é\\n"', "12345678901234567890123", "0.5", "3", "1000000000", '"X"', '"-nan"',
)  # fmt: skip
"""Unexpected values of a TOML file."""
WORDS = (
    "",
    "nan",
    "inf",
    "-1",
    "0",
    "1e300",
    "1e-300",
    "1 2",
    "1 2 3 4 5",
    "x",
    "999999999",
    "../x",
    "/etc/hostname",
    "é",
    "-0",
    "1,5",
    "[]",
    "true",
)
"""Unexpected values of an attribute or a cell."""


def replaced(line: str, value: str) -> str:
    """A line of TOML with another value. A name never becomes `nan`, because the fuzzer looks for this word in the output."""
    key = line.split("=", 1)[0]
    return key + "= " + ("1" if key.strip() == "name" and value == "nan" else value)


def spoil_toml(text: str, rng: random.Random) -> str:
    """Change values, keys, tables or their order."""
    lines = text.split("\n")
    settable = [i for i, line in enumerate(lines) if re.match(r"\s*[\w.\"*]+\s*=", line)]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        i = rng.choice(settable or [0])
        what = rng.randrange(10)
        if what < 6 and settable:
            lines[i] = replaced(lines[i], rng.choice(VALUES))
        elif what == 6:
            lines[i] = ""
        elif what == 7:
            lines.insert(i, rng.choice(lines))
        elif what == 8 and settable:
            key, _, value = lines[i].partition("=")
            lines[i] = rng.choice(("x" + key, key.strip() + ".a ", '"a b" ', "name ", "model ", "effect ", "axis ", key)) + "=" + value
        else:
            j = rng.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
    return "\n".join(lines)


def spoil_xml(text: str, rng: random.Random) -> str:
    """Change attributes, elements or their order."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        what = rng.randrange(8)
        attributes = list(re.finditer(r'(\w+)="([^"]*)"', text))
        elements = list(re.finditer(r"<(\w+)[^<>]*/>", text))
        if what < 4 and attributes:
            m = rng.choice(attributes)
            value = rng.choice((*WORDS, rng.choice(attributes)[2]))
            if value == "nan" and m[1] in _NAMES:  # the fuzzer looks for this word in the output
                value = "x"
            text = text[: m.start(2)] + value + text[m.end(2) :]
        elif what == 4 and attributes:
            m = rng.choice(attributes)
            text = text[: m.start()] + text[m.end() :]
        elif what == 5 and elements:
            m, n = rng.choice(elements), rng.choice(elements)
            text = text[: n.start()] + m[0] + text[n.start() :]
        elif what == 6 and elements:
            m = rng.choice(elements)
            text = text[: m.start()] + text[m.end() :]
        elif elements:
            m = rng.choice(elements)
            text = text[: m.start()] + rng.choice(_ELEMENTS) + text[m.start() :]
    return text


_NAMES = ("name", "link", "joint", "body", "mesh", "model", "prefix")
_ELEMENTS = (
    '<replicate count="99999999"><geom size="1"/></replicate>', '<hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/>',
    '<texture name="t" type="2d" builtin="flat" width="99999" height="99999"/>', '<include file="m.xml"/>', '<include file="/etc/hostname"/>',
    '<mesh name="q" file="../a.stl"/>', "<freejoint/>", '<joint type="ball"/>', "<body/>", '<body name="a"/>', '<geom type="mesh" mesh="q"/>',
    '<flexcomp name="f" type="grid" count="99 99 99"/>', '<site name="s" size="nan"/>', '<camera name="c" resolution="99999 99999"/>',
    '<composite type="cable" count="9999 1 1"/>', '<joint name="j" type="slide" range="1 -1"/>', '<size memory="999G"/>', "<link/>", "<joint/>",
    '<default class="x"/>', '<option timestep="-1"/>', '<inertial pos="0 0 0" mass="1e300" diaginertia="1 1 1e-300"/>', '<mesh filename="package://../x"/>',
    '<numeric name="n" size="2000000000"/>', '<key name="k" qpos="1 2 3 4 5 6 7"/>', '<general joint="nothing"/>', '<attach model="m" body="b" prefix="p"/>',
)  # fmt: skip


def spoil_table(text: str, rng: random.Random) -> str:
    """Change cells, headings or rows."""
    rows = [line.split(",") for line in text.strip("\n").split("\n")]
    for _ in range(rng.choice((1, 1, 2, 3))):
        i = rng.choice((0, rng.randrange(len(rows))))
        j = rng.randrange(max(1, len(rows[i])))
        what = rng.randrange(8)
        if what < 4 and rows[i]:
            rows[i][min(j, len(rows[i]) - 1)] = rng.choice((*WORDS, "1e6", "18446744073709551615", "2024-01-01", "a$b_{c", "\u00fc"))
        elif what == 4:
            rows[i] = rows[i] + [rng.choice(WORDS)]
        elif what == 5:
            rows[i] = rows[i][:-1]
        elif what == 6 and len(rows) > 2:
            k = rng.randrange(len(rows))
            rows[i], rows[k] = rows[k], rows[i]
        else:
            rows = rows[: rng.randrange(len(rows)) + 1]
    return "\n".join(",".join(row) for row in rows) + "\n"


def spoil_json(text: str, rng: random.Random) -> str:
    """Change one value."""
    document = json.loads(text)
    at, key = document, None
    for _ in range(8):
        if not isinstance(at, dict | list) or not at:
            break
        key, holder = (rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))), at
        at = at[key]
        if rng.random() < 0.3:
            break
    if key is not None:
        holder[key] = rng.choice([None, [], {}, "", "x", -1, 1e308, 10**30, True, [[1]], {"a": 1}, "\0", 0])
    return json.dumps(document)


def spoil_bytes(content: bytes, rng: random.Random) -> bytes:
    """Change bytes, cut the end off, or make a number large."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 2, 5, 20))):
        what = rng.randrange(5)
        at = rng.randrange(max(1, len(data)))
        if what == 0 and data:
            data[at] = rng.randrange(256)
        elif what == 1:
            del data[at : at + rng.randrange(64)]
        elif what == 2:
            data[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(16)))
        elif what == 3 and rng.random() < 0.3:
            del data[at:]
        elif len(data) > 8:
            data[at : at + 4] = struct.pack("<I", rng.choice((0, 0xFFFFFFFF, 0x7FFFFFFF, 1 << 20, 1 << 30)))
    return bytes(data)


SPOIL: dict[str, Callable[[str, random.Random], str]] = {
    ".toml": spoil_toml, ".xml": spoil_xml, ".urdf": spoil_xml, ".csv": spoil_table, ".json": spoil_json,
    ".mpf": fuzz_programs.mutate, ".ngc": fuzz_programs.mutate, ".nc": fuzz_programs.mutate, ".apt": fuzz_programs.mutate,
}  # fmt: skip


def spoil_parquet(content: bytes, rng: random.Random) -> bytes:
    """Change the type, heading or place of columns of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(pa.BufferReader(content))
    names, columns = list(table.column_names), [column.combine_chunks() for column in table.columns]
    for _ in range(rng.choice((1, 1, 2))):
        i, rows = rng.randrange(len(names)), table.num_rows
        what = rng.randrange(4)
        if what < 2:
            columns[i] = rng.choice(_COLUMNS)(rows)
        elif what == 2:
            names[i] = rng.choice(
                (*WORDS, rng.choice(names), "U.position []", "U.[mm]", "time [ms]", "Q.current [A]", "$x_{ [mm]", "U.position [Nm]")
            )
        else:
            j = rng.randrange(len(names))
            columns[i], columns[j] = columns[j], columns[i]
    pyarrow.parquet.write_table(pa.Table.from_arrays(columns, names), out := pa.BufferOutputStream())
    return bytes(out.getvalue())


def _typed(value: object, kind: Callable[[], object] | None = None) -> Callable[[int], object]:
    """A function that makes a column (row,) of one value, in an Arrow type."""

    def column(rows: int) -> object:
        import pyarrow as pa

        return pa.array([value] * rows, type=kind and kind())

    return column


def _arrow(name: str, *arguments: object) -> Callable[[], object]:
    def made() -> object:
        import pyarrow as pa

        return getattr(pa, name)(*(a() if callable(a) else a for a in arguments))

    return made


_COLUMNS: tuple[Callable[[int], object], ...] = (
    _typed(None), _typed("x"), _typed("1.5"), _typed(b"\xff\xfe"), _typed(True), _typed([1.0]), _typed([]), _typed({"a": 1}), _typed(float("nan")),
    _typed(float("inf")), _typed(1e300), _typed(-1e-300), _typed(2**64 - 1, _arrow("uint64")), _typed(-(2**63), _arrow("int64")), _typed(7, _arrow("int8")),
    _typed(1, _arrow("timestamp", "ns")), _typed(1, _arrow("date32")), _typed(1, _arrow("duration", "us")), _typed(1.5, _arrow("float16")),
    _typed(1, _arrow("decimal128", 9, 2)), _typed("a", _arrow("dictionary", _arrow("int8"), _arrow("string"))), _typed(None, _arrow("float64")),
    lambda rows: _typed(None)(0) if rows == 0 else _arrow("array", [0.0, None] * rows)()[:rows],  # type: ignore[index]
)  # fmt: skip


def spoil_archive(content: bytes, rng: random.Random) -> bytes:
    """Corrupt or remove one file of a zip archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(files))
    if rng.random() < 0.1:
        del files[name]
    elif name.endswith(".xml"):
        files[name] = spoil_cells(spoil_xml(files[name].decode(), rng), rng).encode(errors="replace")
    else:
        files[name] = spoil_bytes(files[name], rng)
    with zipfile.ZipFile(out := io.BytesIO(), "w") as archive:
        for name, inside in files.items():
            archive.writestr(name, inside)
    return out.getvalue()


def spoil_cells(text: str, rng: random.Random) -> str:
    """Sometimes change the text of an XML element."""
    cells = list(re.finditer(r">([^<>]+)<", text))
    if not cells or rng.random() < 0.3:
        return text
    m = rng.choice(cells)
    return text[: m.start(1)] + rng.choice(WORDS).replace("&", "") + text[m.end(1) :]


SPOIL_BYTES = {".parquet": spoil_parquet, ".x3p": spoil_archive, ".npz": spoil_archive}


def spoil(file: Path, rng: random.Random) -> None:
    """Corrupt one file in the way of its ending, sometimes by its bytes."""
    by_text, by_bytes = SPOIL.get(file.suffix), SPOIL_BYTES.get(file.suffix, spoil_bytes)
    content = file.read_bytes()
    if by_bytes is not spoil_bytes and rng.random() < 0.7:
        file.write_bytes(by_bytes(content, rng))
    elif by_text is None or rng.random() < 0.1:
        file.write_bytes(spoil_bytes(content, rng))
    else:
        text = by_text(content.decode(errors="replace"), rng)
        file.write_bytes(text.encode(rng.choice(("utf-8",) * 12 + ("latin-1", "utf-16")), errors="replace"))
