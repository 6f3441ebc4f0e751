"""All places of the package that open a file, with the reason. A new one must use twin/documents.py, or be added here and justified.

Files named in other files are opened through `named_file`, TOML and JSON through `read_toml` and `read_json`.
"""

import ast
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "twin"

METHODS = {"read_text", "read_bytes", "open", "fromfile", "loadtxt", "genfromtxt", "memmap", "loadmat", "whosmat", "imread", "from_file",
           "from_xml_path", "ParquetFile", "read_csv", "ZipFile", "File", "MDF", "TdmsFile", "RrdReader", "exec_module", "iterparse", "parse"}  # fmt: skip
"""Names of calls that open a file, on any object."""
LOADERS = {"np", "numpy", "pickle", "tomllib", "json", "trimesh", "URDF", "pandas", "runpy", "yaml"}
"""Modules whose `load`, `loads` or `run_path` reads a file or its text."""

ALLOWED = {
    "cli/exam.py": {"read_bytes": 2},  # the machine file that is asked for
    "cli/import_recordings.py": {"read_text": 1},  # a map that it would write over
    "recordings/imported.py": {"read_text": 1},  # a map that is completed
    "cli/remedy.py": {"read_text": 1},  # by documents.py: a file that the control saved
    "remedy/files/existing.py": {"read_text": 1},  # by documents.py: a file of the control
    "cli/parser.py": {"open": 1},  # os.devnull
    "compiled_functions.py": {"read_bytes": 3},  # the package's own source
    "desk/entries.py": {"open": 1},  # the first lines of a page below the folder that it serves
    "desk/server.py": {"open": 1},  # pages and results below the folder that it serves
    "files.py": {"open": 2},  # the lock of a folder, and a file that was just written; both by descriptor
    "system.py": {"open": 5, "read_text": 1},  # folders and outputs by descriptor; what is written into a pipe; limits of a container
    "documents.py": {"read_text": 3, "tomllib.loads": 1, "json.loads": 1},  # the one reader of TOML and the one of JSON
    "effects/user_files.py": {"exec_module": 1},  # effects that --effects names: code of the user's own
    "exam/candidate.py": {"read_bytes": 3},  # what the examination wrote, against its seal
    "exam/mark.py": {"read_text": 1},  # what the examination wrote
    "exam/plant/compiled.py": {"read_bytes": 1},  # the package's own source
    "exam/session.py": {"read_bytes": 3, "read_text": 1},  # the package's own source, and what the examination wrote
    "geometry/mesh_file.py": {"read_bytes": 1, "trimesh.load": 1},  # the one reader of meshes
    "history/dated.py": {"open": 1},  # a recording that the command names, or a campaign names by named_file: its digest
    "identify/from_recording.py": {"read_text": 1},  # the machine file that it wrote
    "iso230/readings.py": {"open": 2},  # a table that the command names
    "machine/machine.py": {"read_text": 1},  # a machine file that is loaded already: its comments
    "machine/model_file.py": {"open": 1, "parse": 1, "read_bytes": 1},  # the one reader of XML of models
    "machine/sinumerik.py": {"read_text": 1},  # an archive that the command names
    "program/source.py": {"open": 1},  # programs that the command names, and subprograms in their folder
    "program/read.py": {"open": 1},  # programs that the command names
    "recordings/formats/delimited.py": {"open": 1},  # a recording that the command names
    "recordings/formats/json_text.py": {"read_text": 1},  # by documents.py: a recording that the command names
    "recordings/formats/ros_text.py": {"read_text": 1},  # by documents.py: a recording that the command names
    "recordings/formats/text_sample.py": {"open": 1},  # the head of a recording that the command names
    "recordings/formats/text_stream.py": {"open": 1},  # a recording that the command names
    "recordings/formats/arrays.py": {"ZipFile": 1, "np.load": 2},  # a recording that the command names; no pickles
    "recordings/formats/hdf5.py": {"File": 1},  # a recording that the command names; datasets that stand elsewhere are refused
    "recordings/formats/packed.py": {"ZipFile": 1, "open": 4},  # a recording that the command names, and its own scratch files
    "recordings/formats/matlab.py": {"loadmat": 1},  # a recording that the command names
    "recordings/formats/mdf.py": {"MDF": 1},  # a recording that the command names
    "recordings/formats/tdms.py": {"open": 1},  # a recording that the command names
    "recordings/formats/xml_text.py": {
        "iterparse": 3,
        "open": 1,
    },  # a recording that the command names, without entities; its own scratch files
    "recordings/signals.py": {"fromfile": 1, "open": 3},  # a recording that the command names, and its own scratch files
    # the one reader of Parquet, in batches with a limit; a trace that the command names, or a campaign by named_file
    "recordings/table_file.py": {"open": 2, "ParquetFile": 3, "read_csv": 2},
    "report/page.py": {"read_text": 1},  # by documents.py: the page of a diagnosis, for a link to its remedy
    "replay/source.py": {"RrdReader": 1, "open": 1},  # a recording that the command names
    "replay/viewer.py": {"open": 2},  # the viewer's picture, its client
    "simulation/effect_picture.py": {"open": 1},  # a picture that it wrote
    "simulation/plant_spec.py": {"from_file": 1},  # the engine, behind the checks of model_file and model_limits
    "study/evaluate.py": {"read_bytes": 2},  # files of a study that were checked, to be sent to workers
    "study/execution.py": {"read_bytes": 1, "json.loads": 1},  # the same, for their digest; cells of its own data base
    "surface/measured.py": {"ZipFile": 2, "np.load": 1, "read_bytes": 1},  # a map that the command names; no pickles
}
"""Number of calls by file and call, and why each is safe."""


def openings() -> dict[tuple[str, str], int]:
    """Number of calls by (file, call)."""
    found: Counter[tuple[str, str]] = Counter()
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            function, name = node.func, ""
            if isinstance(function, ast.Name) and function.id in METHODS | {"open"}:
                name = function.id
            elif isinstance(function, ast.Attribute):
                owner = function.value.id if isinstance(function.value, ast.Name) else ""
                if function.attr in METHODS and owner not in ("webbrowser", "tomlkit"):
                    name = function.attr
                elif function.attr in ("load", "loads", "run_path") and owner in LOADERS:
                    name = f"{owner}.{function.attr}"
            if name:
                found[file.relative_to(PACKAGE).as_posix(), name] += 1
    return dict(found)


def differences(table: Mapping[str, Mapping[str, int]], found: Mapping[tuple[str, str], int]) -> tuple[dict, dict]:
    """What is found more often than a table lists it, and what less often, by (file, call)."""
    listed = {(file, call): count for file, calls in table.items() for call, count in calls.items()}
    new = {key: count for key, count in found.items() if count > listed.get(key, 0)}
    return new, {key: count for key, count in listed.items() if found.get(key, 0) < count}


def test_every_opening_of_a_file_is_listed() -> None:
    new, gone = differences(ALLOWED, openings())
    assert not new, f"use twin/documents.py (read_toml, read_json, named_file), or list it here with a reason: {new}"
    assert not gone, f"no longer there, take it out of ALLOWED: {gone}"


WRITERS = {"write_text", "write_bytes", "save", "savefig", "write_table", "write_csv", "export", "savez", "savez_compressed", "savetxt", "tofile",
           "ParquetWriter", "copyfile", "copy", "copytree", "imsave", "connect", "dump", "truncate",
           "mkdir", "makedirs", "unlink", "rename", "rmtree", "remove", "rmdir", "symlink_to", "hardlink_to", "touch", "chmod",
           "TemporaryDirectory", "NamedTemporaryFile", "TemporaryFile", "mkdtemp", "mkstemp"}  # fmt: skip
"""Names of calls that write, make, move or remove a file or folder. Some count for one module only, see `OWNERS`."""
OWNERS = {"copy": ("shutil",), "copytree": ("shutil",), "copyfile": ("shutil",), "connect": ("sqlite3",), "dump": ("json", "pickle", "tomlkit"),
          "rename": ("os", "path", "shutil"), "remove": ("os",), "save": ("np", "image.crop((0, bar, image.width, image.height))")}  # fmt: skip

WRITES = {
    "diagnose/first/raw.py": {"unlink": 1},  # an output of an earlier call
    "cli/replay.py": {"TemporaryDirectory": 1, "mkdtemp": 1, "rename": 1},  # a recording that the viewer reads after the command
    "diagnose/output.py": {"unlink": 1},  # an output of an earlier call
    "exam/draw.py": {"write_table": 1, "mkdir": 1},  # apart from the package; before the campaign.toml that makes them count
    "files.py": {"mkdir": 3, "unlink": 2, "TemporaryDirectory": 1, "TemporaryFile": 1},  # this is the one way
    "identify/first_values.py": {"TemporaryDirectory": 1},  # scratch files
    "identify/from_recording.py": {"TemporaryDirectory": 1},  # scratch files
    "recordings/formats/packed.py": {"mkdir": 1},  # its own scratch files
    "recordings/formats/delimited.py": {"mkdir": 1, "write_text": 1},  # its own scratch files
    "recordings/formats/parquet.py": {"write_csv": 1},  # its own scratch files
    "recordings/signals.py": {"tofile": 1},  # its own scratch files
    "recordings/formats/text_stream.py": {"mkdir": 1, "rmtree": 1},  # its own scratch files
    "recordings/imported.py": {"TemporaryDirectory": 2, "rmtree": 1},  # scratch files, also those of an import that was killed
    "recordings/write.py": {"unlink": 1},  # an output of an earlier call
    "regress/golden.py": {"unlink": 1},  # an output of an earlier call
    "regress/runners.py": {"TemporaryDirectory": 2},  # scratch files
    "study/row_file.py": {"connect": 1},  # SQLite opens by name; that it is no link is checked before
    "study/output.py": {"TemporaryDirectory": 1},  # scratch files
    "system.py": {"mkdir": 1, "unlink": 1},  # by descriptor
    "recordings/trace.py": {"write_table": 1},  # blocks of a file that `beside` opened
    "report/figure.py": {"savefig": 1},  # into memory
    "study/evaluate.py": {"write_bytes": 1, "mkdir": 1, "TemporaryDirectory": 1},  # scratch folders of a worker
}
"""File -> call -> how often it writes elsewhere than to the `partial` of `beside`, and why."""


def writings() -> dict[tuple[str, str], int]:
    """(file, call) -> how often something is written that is not the `partial` file of `twin.files.beside`."""
    found: Counter[tuple[str, str]] = Counter()
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute) or node.func.attr not in WRITERS:
                continue
            owner = ast.unparse(node.func.value)
            if node.func.attr in OWNERS and owner not in OWNERS[node.func.attr]:
                continue
            names = [owner, *(ast.unparse(argument) for argument in node.args)]
            if "partial" not in names or node.func.attr in ("unlink", "mkdir"):
                found[file.relative_to(PACKAGE).as_posix(), node.func.attr] += 1
    return dict(found)


def test_every_file_is_written_beside_its_place() -> None:
    """A full disk or a stop leaves the old file or none."""
    new, gone = differences(WRITES, writings())
    assert not new, f"write to `with beside(path) as partial` (twin/files.py), or list it here with a reason: {new}"
    assert not gone, f"no longer there, take it out of WRITES: {gone}"
