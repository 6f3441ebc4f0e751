"""The viewer really draws it: a headless picture is looked at for the machine, its motion, the tool path, the curves, the legend.

Needs a Vulkan driver; software is enough (Mesa's lavapipe, package mesa-vulkan-drivers). Where there is none the checks are
skipped and say so. Pictures are compared for content: two viewers never draw the same bytes.
"""

from pathlib import Path
import time as clock

import numpy as np
from PIL import Image
import pytest

from twin.errors import InputError
from twin.machine.machine import load_machine
from twin.replay.blueprint import LIGHT_GROUND
from twin.replay.curves import CONTOUR_COLOUR
from twin.replay.recording import write_recording
from twin.replay.viewer import screenshot
from twin.report.colours import ERROR_BANDS, Colour, axis_colour
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

SIZE = (1600, 900)
EARLY, LATE = 0.45, 1.9
# shares of the picture (left, top, right, bottom) that the layout gives to each view, without their title bars
MACHINE = (0.0, 0.03, 0.41, 0.57)
TOOL_PATH = (0.42, 0.03, 0.74, 0.49)
LEGEND = (0.42, 0.555, 0.74, 0.61)
CONTOUR = (0.01, 0.63, 0.23, 0.95)
AXES = (0.25, 0.65, 1.0, 0.95)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> dict[float, np.ndarray]:
    """The view of a five-axis run at two times, (row, column, RGB)."""
    folder = tmp_path_factory.mktemp("picture")
    time = np.arange(2001) * 1e-3
    swing = np.outer(0.5 - 0.5 * np.cos(np.pi * time), [0.15, 0.10, -0.12, -0.4, 0.8])
    machine = load_machine()
    write_recording(folder / "run.rrd", machine, {"simulated": simulate(machine, Setpoints(swing, 1e-3)).trace})
    found = {}
    for at in (EARLY, LATE):
        start = clock.perf_counter()
        try:
            screenshot(folder / "run.rrd", folder / f"{at}.png", at, SIZE)
        except InputError as error:
            if "Vulkan" in str(error):
                pytest.skip(f"no picture of the viewer was checked: {error}")
            raise
        print(f"\npicture at {at} s after {clock.perf_counter() - start:.1f} s")
        found[at] = np.asarray(Image.open(folder / f"{at}.png").convert("RGB"), int)
    return found


def part(picture: np.ndarray, region: tuple[float, float, float, float]) -> np.ndarray:
    height, width = picture.shape[:2]
    left, top, right, bottom = region
    return picture[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def pixels_of(picture: np.ndarray, colour: Colour, tolerance: int = 24) -> int:
    """How many pixels have a colour, give or take what blending does to it."""
    return int((np.abs(picture - np.array(colour)).max(axis=2) <= tolerance).sum())


def machine_share(picture: np.ndarray) -> float:
    """Share of the machine's view that is not its ground: neither the light sky nor the grid on it."""
    view = part(picture, MACHINE)
    return float((np.abs(view - np.array(LIGHT_GROUND)).max(axis=2) > 60).mean())


def test_the_picture_has_the_size_asked_for(pictures: dict[float, np.ndarray]) -> None:
    assert {picture.shape for picture in pictures.values()} == {(SIZE[1], SIZE[0], 3)}


def test_the_machine_is_large_and_lit(pictures: dict[float, np.ndarray]) -> None:
    for picture in pictures.values():
        assert 0.15 < machine_share(picture) < 0.8
        view = part(picture, MACHINE)
        # lit: its white paint has bright and dark sides; the blue cover is there
        grey = np.ptp(view, axis=2) < 16
        levels = view[grey].mean(axis=1)
        assert np.ptp(np.quantile(levels[levels < 200], [0.05, 0.95])) > 60
        assert ((view[..., 2] - view[..., 0] > 40) & (view[..., 0] < 60)).sum() > 2000


def test_the_machine_moves(pictures: dict[float, np.ndarray]) -> None:
    change = np.abs(part(pictures[EARLY], MACHINE) - part(pictures[LATE], MACHINE)).max(axis=2) > 40
    assert change.mean() > 0.01


def test_the_tool_draws_its_path(pictures: dict[float, np.ndarray]) -> None:
    drawn = {at: sum(pixels_of(part(picture, TOOL_PATH), band) for band in ERROR_BANDS) for at, picture in pictures.items()}
    assert drawn[EARLY] > 20
    assert drawn[LATE] > 1.5 * drawn[EARLY]


def test_the_legend_shows_all_colours(pictures: dict[float, np.ndarray]) -> None:
    legend = part(pictures[LATE], LEGEND)
    assert all(pixels_of(legend, band, 6) > 100 for band in ERROR_BANDS)


def test_the_curves_are_drawn(pictures: dict[float, np.ndarray]) -> None:
    for picture in pictures.values():
        assert pixels_of(part(picture, CONTOUR), CONTOUR_COLOUR) > 100
        shown = max(pixels_of(part(picture, AXES), axis_colour(axis)) for axis in "XYZAC")
        assert shown > 400


def test_an_empty_view_would_be_noticed() -> None:
    """The checks can fail: on a page without a machine, a path or curves they find nothing."""
    empty = np.empty((SIZE[1], SIZE[0], 3), int)
    empty[:] = LIGHT_GROUND
    assert machine_share(empty) == 0.0
    assert sum(pixels_of(part(empty, TOOL_PATH), band) for band in ERROR_BANDS) == 0
    assert pixels_of(part(empty, CONTOUR), CONTOUR_COLOUR) == 0


def test_a_time_outside_the_run_is_refused(pictures: dict[float, np.ndarray], tmp_path: Path) -> None:
    machine = load_machine()
    write_recording(tmp_path / "run.rrd", machine, {"still": simulate(machine, Setpoints(np.zeros((50, 5)), 1e-3)).trace})
    with pytest.raises(InputError, match=r"give a time from 0 to 0\.049 s"):
        screenshot(tmp_path / "run.rrd", tmp_path / "x.png", 7.0)
