"""The picture of docs/remedy.md: python -m devtools.picture_remedy."""

from __future__ import annotations

from pathlib import Path

import twin
from twin.machine.check import Asked
from twin.remedy.choose import Goal, Task
from twin.remedy.predict import standard_motions
from twin.remedy.remedy import remedy
from twin.remedy.report import remedy_figure
from twin.report import save_png

PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "remedy.png"


def main() -> None:
    worn = twin.add_effects(twin.load_machine(), "coulomb_friction:X:factor=1.4", "backlash:Y:clearance=12e-6")
    circle, *others = standard_motions(worn)
    save_png(remedy_figure(remedy(Task(worn, circle, others, Goal(0.4e-6), Asked()), {})), PICTURE)


if __name__ == "__main__":
    main()
