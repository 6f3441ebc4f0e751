"""Laws of the units at the border."""

import math

import pytest

from twin.errors import InputError
from twin.units import ARCSEC, AXIS_UNITS, UNITS, factor_to_si


@pytest.mark.parametrize(
    ("unit", "si"),
    [("mm", 1e-3), ("um", 1e-6), ("deg", math.pi / 180), ("m/min", 1 / 60), ("mm/s", 1e-3), ("deg/min", math.pi / 10800), ("A", 1.0)],
)
def test_factor_of_each_unit(unit: str, si: float) -> None:
    assert factor_to_si(unit, "here") == pytest.approx(si, rel=1e-15)


def test_ninety_degrees_are_324000_arcsec() -> None:
    assert math.radians(90.0) == pytest.approx(324_000 * ARCSEC, rel=1e-15)


@pytest.mark.parametrize("kind", ["linear", "rotary"])
def test_output_units_are_the_inverse_of_the_table(kind: str) -> None:
    units = AXIS_UNITS[kind]
    for name, per_si in (units.position, units.speed):
        assert per_si * UNITS[name][1] == pytest.approx(1.0, rel=1e-15)


def test_unknown_unit_offers_the_nearest() -> None:
    with pytest.raises(InputError, match=r"somewhere: unknown unit \[mm/sec\]; did you mean 'mm/s'\?"):
        factor_to_si("mm/sec", "somewhere")
