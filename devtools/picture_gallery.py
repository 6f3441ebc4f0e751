"""Makes the reports of docs/gallery.md and takes screenshots of their first page with a headless Chromium.

    python -m devtools.picture_gallery [--out out/gallery] [--only NAME]

The worn machine is simulated by the second plant: 15 um of backlash on X, Coulomb friction of Y a third higher. Takes minutes, mostly for the diagnosis.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import shutil
import subprocess
import tempfile
import tomllib

from devtools.record_example_campaign import SEED, record
from twin.cli import main as twin
from twin.exam.draw import SHIPPED_MACHINE, Case
from twin.exam.plant.parameters import Richness, unit_factors

PICTURES = Path("docs/pictures/gallery")
WORN = ({"name": "backlash", "axis": "X", "clearance": 15e-6}, {"name": "coulomb_friction", "axis": "Y", "factor": 1.33})
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--hide-scrollbars",
)  # fmt: skip


def photograph(page: Path, picture: Path, width: int = 1200, height: int = 1000) -> None:
    """The first `height` pixels of a page as PNG, in 128 colours."""
    from PIL import Image

    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("no Chromium found; on Debian: apt-get install chromium")
    picture.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        where = [f"--user-data-dir={profile}", f"--window-size={width},{height}", f"--screenshot={picture.resolve()}"]
        subprocess.run([browser, *FLAGS, *where, page.resolve().as_uri()], check=True, capture_output=True, timeout=120)
    shown = Image.open(picture).convert("RGB")
    shown.resize((width * 3 // 4, height * 3 // 4), Image.Resampling.LANCZOS).quantize(128).save(picture, optimize=True)


def main() -> None:
    """Make the requested reports and screenshots."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/gallery"))
    parser.add_argument("--only", action="append", help="beside, gap, diagnosis, identify, study")
    args = parser.parse_args()
    out = args.out
    worn = out / "worn_machine"
    reports = {
        "beside": (["run", "examples/x_200mm.csv", "--effect", "backlash:X:clearance=15e-6", "--beside", "--no-recording", "--out"], ""),
        "gap": (["gap", str(worn), "--html"], ".html"),
        "diagnosis": (["diagnose", str(worn), "--out"], ""),
        "identify": (["identify", "examples/campaign", "--out"], ".toml"),
        "study": (["study", "examples/studies/corner_mass.toml", "--no-replay", "--out"], ""),
    }
    if not (worn / "campaign.toml").is_file():
        record(worn, Case(SEED, "gallery", 1.0, WORN, unit_factors(), Richness.off()), tomllib.loads(SHIPPED_MACHINE.read_text("utf-8")))
    for name, (command, ending) in reports.items():
        if args.only and name not in args.only:
            continue
        place = out / f"{name}{ending}"
        if twin([*command, str(place)]):
            raise SystemExit(f"twin {' '.join(command)} failed")
        page = place / "report.html" if not ending else place.with_suffix(".html")
        photograph(page, PICTURES / f"{name}.png")


if __name__ == "__main__":
    main()
