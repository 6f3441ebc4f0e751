"""Builds the wheel and tries it outside the checkout, on any system: version, help, demo, examples, regression suite, a schema, on the packages that
are installed here. Some minutes.

    python -m devtools.wheel               # about a minute
    python -m devtools.wheel --clean       # scripts/first_hour: a new virtual environment, then every command of docs/first_hour.md
    python -m devtools.wheel --clean --compiled

With --clean, pip installs the wheel and what it needs into an environment that holds nothing else; commands that wait for a user are named and left
out; the time from `pip install` to the first report is printed. With --compiled the wheel gets the compiled functions of this checkout, which numba
takes where the sources are the same to the letter: some minutes less, but no measure of a user's first report.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "first_hour.md"
WAIT_FOR_A_USER = ("replay", "desk")
MADE = ("out/demo/x_200mm.png", "out/worn/report.html", "out/gap.html", "out/diagnosis/report.html")
"""Files that the commands of the page make."""
SHORT = (
    "demo --out demo",
    "run examples/x_200mm.csv --out first --no-recording",
    "gap examples/campaign",
    "regress --only viscous_friction --no-evidence",
)
INSIDE = "import pathlib, sys, twin; assert pathlib.Path(twin.__file__).is_relative_to(sys.argv[1]), twin.__file__"


def commands() -> list[list[str]]:
    """The words of every `twin` line of the page; what follows two blanks and a # explains the line."""
    lines = re.findall(r"^    twin (.*)$", PAGE.read_text(encoding="utf-8"), re.M)
    return [shlex.split(line, comments=True) for line in lines]


def done(command: list[str], place: Path, environment: dict[str, str]) -> str:
    """Output of a command that has to succeed."""
    found = subprocess.run(command, cwd=place, env=environment, capture_output=True, check=False)
    text = (found.stdout + found.stderr).decode(errors="replace")
    if found.returncode:
        sys.exit(f"{text}\nfailed: {' '.join(command)}")
    return text


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m devtools.wheel", description="build the wheel and try it outside the checkout")
    parser.add_argument("--clean", action="store_true", help="in a new virtual environment, with every command of the first hour")
    parser.add_argument("--compiled", action="store_true", help="take over the compiled functions of this checkout")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="twin-wheel-", ignore_cleanup_errors=True) as folder:  # Windows keeps a loaded library
        place, environment, python, pip = Path(folder), dict(os.environ), sys.executable, ["-m", "pip", "--disable-pip-version-check"]
        done([python, *pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, str(ROOT)], place, environment)
        wheel = next(place.glob("twin-*.whl"))
        begun = time.perf_counter()
        if given.clean:
            environment = {k: v for k, v in environment.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONDONTWRITEBYTECODE")}
            done([python, "-m", "venv", "clean"], place, environment)
            python = str(place / "clean" / ("Scripts/python.exe" if os.name == "nt" else "bin/python"))
            site = Path(done([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], place, environment).strip())
            done([python, *pip, "install", "--quiet", "--no-compile", str(wheel)], place, environment)  # Python compiles what it imports
            print(f"first hour: installed after {time.perf_counter() - begun:.0f} s", flush=True)
        else:
            site = place / "site"
            done([python, *pip, "install", "--quiet", "--no-deps", "--target", str(site), str(wheel)], place, environment)
            environment["PYTHONPATH"] = str(site)
        if given.compiled:
            for file in (ROOT / "twin").rglob("*.nb[ic]"):
                target = site / file.relative_to(ROOT)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(file, target)
        done([python, "-c", INSIDE, str(site.resolve())], place, environment)
        for words in ("--version", "--help"):
            done([python, "-m", "twin", words], place, environment)
        there = [(site / name).exists() for name in ("twin/py.typed", "twin/report/schemas/gap.json", "devtools", "tests")]
        if there != [True, True, False, False]:
            sys.exit(f"wheel: py.typed, a schema, devtools and tests in the wheel: {there}")
        for n, words in enumerate(commands() if given.clean else [line.split() for line in SHORT]):
            if words[0] in WAIT_FOR_A_USER:
                print(f"first hour: left out, it waits for a user: twin {' '.join(words)}")
                continue
            started = time.perf_counter()
            done([python, "-m", "twin", *words], place, environment)
            print(f"{time.perf_counter() - started:.0f} s  twin {' '.join(words)}", flush=True)
            if given.clean and n == 0:
                print(f"first hour: first report {time.perf_counter() - begun:.0f} s after pip install began", flush=True)
        missing = [name for name in (MADE if given.clean else ("demo/x_200mm.png",)) if not (place / name).is_file()]
        if missing:
            sys.exit(f"wheel: not made: {missing}")
        print(f"wheel: {wheel.stat().st_size / 1e6:.1f} MB, works outside the checkout")


if __name__ == "__main__":
    main()
