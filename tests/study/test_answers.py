"""The statistics of a study on functions whose answers are known."""

from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from scipy.stats import qmc

from tests.builders.study_files import FACTOR, GRID, write_spec
from twin.errors import InputError
from twin.machine.loops import loops_of, margins_of
from twin.machine.machine import load_machine
from twin.study.design import retuned
from twin.study.labels import valued
from twin.study.outcomes import effects_of, pareto_front, sobol_of, surrogate_of, swings_of, without_effect
from twin.study.paths import carrying_axes, with_numbers
from twin.study.report import effect_rows, sentences, swing_rows
from twin.study.results import Row, answers_of, surrogate_from, table_of
from twin.study.spec import read_study


def points(count: int, low: list[float], high: list[float], seed: int = 0) -> np.ndarray:
    return qmc.scale(qmc.LatinHypercube(len(low), rng=np.random.default_rng(seed)).random(count), low, high)


def test_effects_of_a_product_are_its_coefficients() -> None:
    table = points(40, [0.0, 10.0], [2.0, 30.0])
    a, b = table.T
    found = {e.factors: e for e in effects_of(["a", "b"], table, 3.0 * (a - 1.0) + 0.2 * (b - 20.0) + 0.05 * (a - 1.0) * (b - 20.0))}
    # ends of the sample, not of the range, are -1 and 1
    half_a, half_b = np.ptp(table, axis=0) / 2.0
    middle_a, middle_b = (table.min(axis=0) + table.max(axis=0)) / 2.0
    assert found["a",].value == pytest.approx(half_a * (3.0 + 0.05 * (middle_b - 20.0)))
    assert found["b",].value == pytest.approx(half_b * (0.2 + 0.05 * (middle_a - 1.0)))
    assert found["a", "b"].value == pytest.approx(0.05 * half_a * half_b)
    assert found["a",].high - found["a",].low < 1e-9


def test_entries_of_a_catalogue_have_no_order() -> None:
    """Four motors in any order of the file: the same predictions, and effects against the first one."""
    rng = np.random.default_rng(3)
    motor, x = rng.permutation(np.arange(40) % 4), rng.uniform(0.0, 10.0, 40)
    level, slope = np.array([5.0, 1.0, 9.0, 2.0]), np.array([0.0, 0.1, 0.0, -0.2])
    y = level[motor] + 2.0 * x + slope[motor] * x
    table = np.column_stack([motor, x])
    surrogate = surrogate_of(table, y, [0])
    assert surrogate is not None
    assert surrogate.error < 1e-6
    other = np.array([2.0, 0.0, 3.0, 1.0])
    again = surrogate_of(np.column_stack([other[motor], x]), y, [0])
    assert again is not None
    for entry in range(4):
        expected = level[entry] + (2.0 + slope[entry]) * 4.0
        assert surrogate.predict(np.array([[entry, 4.0]])) == pytest.approx(expected)
        assert again.predict(np.array([[other[entry], 4.0]])) == pytest.approx(expected)
    found = {e.factors: 2.0 * e.value for e in effects_of(["motor", "x"], table, y, {0: ["A", "B", "C", "D"]})}
    middle = (x.min() + x.max()) / 2.0
    for entry, name in ((1, "B"), (2, "C"), (3, "D")):
        assert found[f"motor: {name} instead of A",] == pytest.approx(level[entry] - 5.0 + slope[entry] * middle)
    assert not any(len(factors) == 2 and all(f.startswith("motor") for f in factors) for factors in found)
    assert without_effect(["motor", "x"], [(table, y)], [0]) == []


def test_intervals_contain_the_truth_as_often_as_stated() -> None:
    table = points(30, [-1.0, -1.0], [1.0, 1.0])
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(400):
        y = table @ [1.0, 0.0] + 0.3 * rng.standard_normal(30)
        e = next(e for e in effects_of(["a", "b"], table, y) if e.factors == ("a",))
        inside += e.low <= np.ptp(table[:, 0]) / 2.0 <= e.high
    assert 0.92 < inside / 400 < 0.98


def test_two_variants_have_effects_without_intervals() -> None:
    (effect,) = effects_of(["a"], np.array([[0.0], [1.0]]), np.array([1.0, 3.0]))
    assert effect.value == pytest.approx(1.0)
    assert np.isnan(effect.low)


def test_sobol_indices_of_ishigami() -> None:
    from SALib.sample import sobol

    problem = {"num_vars": 3, "names": ["a", "b", "c"], "bounds": [[-np.pi, np.pi]] * 3}
    x = sobol.sample(problem, 1024, calc_second_order=False, seed=1)
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = sobol_of(problem, y)
    np.testing.assert_allclose(found["S1"], [0.3139, 0.4424, 0.0], atol=0.03)
    np.testing.assert_allclose(found["ST"], [0.5576, 0.4424, 0.2437], atol=0.03)


def test_the_pareto_front_contains_exactly_the_undominated_variants() -> None:
    rng = np.random.default_rng(3)
    values = np.round(rng.random((300, 3)), 1)  # with ties
    plain = [not any(np.all(other <= row) and np.any(other < row) for other in values) for row in values]
    np.testing.assert_array_equal(pareto_front(values), plain)
    assert pareto_front(np.zeros((0, 2))).size == 0
    assert pareto_front(np.ones((4, 2))).all()


@pytest.mark.parametrize("count", [60, 900])
def test_the_surrogate_reports_its_error(count: int) -> None:
    def truth(x: np.ndarray) -> np.ndarray:
        return np.sin(2.0 * x[:, 0]) + x[:, 1] ** 2

    table = points(count, [-1.0, -1.0], [1.0, 1.0])
    surrogate = surrogate_of(table, truth(table))
    new = points(2000, [-1.0, -1.0], [1.0, 1.0], seed=9)
    real = np.sqrt(np.mean((surrogate.predict(new) - truth(new)) ** 2))
    assert surrogate.kind == "thin-plate spline"
    assert real < 0.03
    assert 0.5 < surrogate.error / real < 3.0  # a fifth of the points is missing where it is measured
    swings = swings_of(["a", "b"], table, truth(table), surrogate)
    assert swings[0].factor == "a"
    assert abs(next(s for s in swings if s.factor == "b").least_at) < 0.05


def test_a_surrogate_of_noise_has_no_predictive_power() -> None:
    table = points(50, [0.0, 0.0], [1.0, 1.0])
    surrogate = surrogate_of(table, np.random.default_rng(1).standard_normal(50))
    assert surrogate.error > 0.8 * surrogate.spread


def test_too_few_variants_have_no_surrogate() -> None:
    assert surrogate_of(np.arange(5.0)[:, None], np.arange(5.0)) is None


@pytest.mark.parametrize("design", ["grid", "cube", "one at a time"])
def test_a_factor_without_effect_is_found_and_no_other(design: str) -> None:
    if design == "grid":
        table = np.array([(a, b, c) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0) for c in (-1.0, 0.0, 1.0)])
    elif design == "cube":
        table = points(40, [-1.0] * 3, [1.0] * 3)
    else:
        table = np.array([[0.5, 0.5, 0.5], *(np.where(np.arange(3) == i, v, 0.5) for i in range(3) for v in (-1.0, 1.0))])
    a, b, _ = table.T
    # b acts by its square alone: no main effect
    responses = [(table, 5.0 + a), (table, 2.0 + 0.1 * np.exp(a) + 0.01 * b**2), (table, np.full(len(table), 7.0))]
    assert without_effect(["a", "b", "c"], responses) == ["c"]
    assert without_effect(["a", "b", "c"], responses[2:]) == ["a", "b", "c"]


def test_a_mass_on_an_axis_is_carried_by_all_that_carry_it() -> None:
    machine = load_machine()  # the bed carries Y, Y carries X, X carries Z
    assert [set(carrying_axes(f"added_mass.{axis}", machine, "")) for axis in "XYZ"] == [{"X", "Y"}, {"Y"}, {"X", "Y", "Z"}]
    lighter = with_numbers(machine, {"added_mass.Z": -100.0, "axis.X.moving_mass_kg": 650.0})
    assert [axis.moving_mass_kg for axis in lighter.axes[:3]] == [550.0, 950.0, 250.0]
    with pytest.raises(InputError, match="no linear axis and no body A"):
        carrying_axes("added_mass.A", machine, "study")


def test_retuned_loops_have_the_margins_of_the_machine_as_it_was() -> None:
    machine = load_machine()
    changed = with_numbers(
        machine, {"added_mass.X": -250.0, "axis.X.rotor_and_screw_inertia_kg_m2": 2e-3, "axis.X.motor.inductance_h": 9e-3}
    )
    for variant, most in ((changed, 90.0), (retuned(changed, machine), 1.5)):
        apart = [
            abs(margins_of(a).phase - margins_of(b).phase)
            for a, b in zip(loops_of(variant, variant.axis("X")), loops_of(machine, machine.axis("X")))
        ]
        assert max(apart) < most
        assert (max(apart) > 5.0) == (variant is changed)


def test_a_response_without_a_pattern_gives_no_effects(tmp_path: Path) -> None:
    """A poor surrogate gives no effects; a variant at its limit is left out; the most common reason is named."""
    study = read_study(write_spec(tmp_path, 'answer = ["noise", "line"]\n' + FACTOR + '[design]\nkind = "latin_hypercube"\ncount = 30\n'))
    rng = np.random.default_rng(1)
    rows: list[Row] = []
    for n, mass in enumerate(rng.uniform(500.0, 900.0, 30)):
        rows.append((n, [mass], {"noise": rng.standard_normal() * 10.0 ** rng.uniform(0, 5), "line": 2.0 * mass}, None))
    rows += [(30 + n, [900.0], {"noise": 0.0, "line": 1e9}, f"copper loss of X is {n + 7.5} W, at most 5 W is allowed") for n in range(3)]
    rows += [(33, [100.0], {}, "axis X: moving_mass_kg = 100 does not exceed the 350 kg")]
    answers = answers_of(study, rows)
    noise, line = answers.responses
    assert noise.surrogate is not None
    assert not noise.surrogate.fits
    assert noise.swings == []
    assert noise.effects == []
    assert line.effects[0].value == pytest.approx(np.ptp([row[1][0] for row in rows[:30]]))  # half of 2 kg^-1 x the range
    said = sentences(answers)
    assert "too irregular" in said[0]
    assert f"largest influence: mass, {valued('line', line.swings[0].swing)}" in said[1]  # what the first bar shows
    assert swing_rows(answers, line)[0][1] == valued("line", line.swings[0].swing)
    assert any("1 of 34 variants could not be run; most common reason: axis X: moving_mass_kg = .." in text for text in said)
    assert any("3 of 34 variants break a constraint" in text and "copper loss of X is .. W" in text for text in said)


def test_two_variants_give_the_change_in_percent(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path, 'answer = ["line"]\n' + FACTOR + '[design]\nkind = "list"\nrows = [[600], [900]]\n'))
    said = sentences(answers_of(study, [(0, [600.0], {"line": 1200.0}, None), (1, [900.0], {"line": 1596.0}, None)]))
    assert "with mass 600 kg" in said[0]
    assert said[0].endswith("with mass 900 kg (+33 %)")


def test_an_optimum_inside_the_range_has_one_ranking_and_no_slope(tmp_path: Path) -> None:
    """A straight line through a U says nothing: the table ranks by the swing and gives a slope to the straight response alone."""
    study = read_study(write_spec(tmp_path, 'answer = ["u", "line"]\n' + FACTOR + '[design]\nkind = "latin_hypercube"\ncount = 20\n'))
    masses = np.linspace(500.0, 900.0, 20).tolist()
    answers = answers_of(study, [(n, [m], {"u": (m - 690.0) ** 2, "line": 2.0 * m}, None) for n, m in enumerate(masses)])
    u, line = (swing_rows(answers, r)[0] for r in answers.responses)
    assert u[-1] == "-"
    assert line[-1] == "+200 per 100 kg"
    assert [effect_rows(r) for r in answers.responses] == [[], []]


def test_a_lead_is_read_in_mm_per_revolution(tmp_path: Path) -> None:
    factor = '[[factor]]\nname = "lead"\npath = "axis.X.screw_lead_m_per_rev"\nrange = [0.016, 0.024]\n'
    lead = read_study(write_spec(tmp_path, factor + GRID)).factors[0]
    assert (lead.titled, lead.value_text(0.02)) == ("lead [mm/rev]", "20 mm/rev")


def test_effects_that_the_design_cannot_separate_are_omitted() -> None:
    """Two nearly proportional factors get coefficients of thousands for a response that changes by one; these are dropped."""
    a = np.linspace(0.0, 1.0, 12)
    rng = np.random.default_rng(2)
    table = np.column_stack([a, a + 1e-6 * rng.standard_normal(12)])
    y = a + 0.01 * rng.standard_normal(12)
    assert all(2.0 * abs(e.value) <= np.ptp(y) * 1.001 for e in effects_of(["a", "b"], table, y))
    # a full factorial keeps all effects, including the dominant interaction
    corners = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 0.0]])
    (largest, *_) = effects_of(["a", "b"], corners, corners[:, 0] * corners[:, 1])
    assert largest.factors == ("a", "b")
    assert 2.0 * largest.value == pytest.approx(2.0)


def test_the_commonest_reason_counts_every_constraint_that_is_broken(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path, 'answer = ["line"]\n' + FACTOR + '[design]\nkind = "latin_hypercube"\ncount = 9\n'))
    margin, current = "phase margin of the speed loop of X is 9 deg, at least 30 deg is asked for", "time at current limit of X is 2 %"
    reasons = [
        None,
        None,
        margin,
        f"copper loss of X is 7 W; {current}",
        f"current of Y is 8 A; {current}",
        margin.replace("9", "8"),
        current,
    ]
    rows: list[Row] = [(n, [500.0 + n], {"line": float(n)}, reason) for n, reason in enumerate(reasons)]
    assert answers_of(study, rows).commonest(ran=True) == "time at current limit of X is .. %"


def test_the_surrogate_of_a_folder_leaves_out_marked_variants(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path))
    rows: list[Row] = [(n, [500.0 + 40.0 * n], {"line": 2.0 * n}, None) for n in range(8)]
    rows += [(8, [640.0], {"line": 1e9}, "time at current limit of X is 90 %")]
    pyarrow.parquet.write_table(table_of(study, rows), tmp_path / "table.parquet")
    value, error = surrogate_from(tmp_path, "line")({"mass": 620.0})
    assert value == pytest.approx(6.0, abs=1e-6)
    assert error < 1e-6


def test_numbers_of_a_study_have_no_exponent(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path, 'answer = ["current_max_Y_a"]\n' + FACTOR + GRID))
    rows = [(n, [m], {"current_max_Y_a": 6.0 + 1e-6 * m}, None) for n, m in enumerate(np.linspace(500.0, 900.0, 20).tolist())]
    answers = answers_of(study, rows)
    (row,) = swing_rows(answers, answers.responses[0])
    assert row[1] == "< 0.001 A"
    assert row[-1] == "< 0.001 A per 100 kg"
    assert (valued("cycle_time_s", 14444.4), valued("current_max_Y_a", 2.5594)) == ("14444 s", "2.559 A")
