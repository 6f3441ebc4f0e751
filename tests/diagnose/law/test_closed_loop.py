"""Closed-loop fit of laws: a law of the recorded machine is found and cross-validated; a machine without a law gets none."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.diagnose.cross_validation import folds_of
from twin.diagnose.law.acceptance import is_significant, remove_needless_slip, replace_laws_by_effects
from twin.diagnose.law.closed_loop import ClosedLoop, state_of, unknowns_of
from twin.diagnose.law.laws import _AxisLaws, _search_from, laws_of
from twin.diagnose.law.proposals import STRONG, WEAK
from twin.diagnose.law.springs import with_rigid_drive_train
from twin.diagnose.observe import observe
from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.simulations import in_turn
from twin.diagnose.tolerance import drive_train_of
from twin.diagnose.view import view_of
from twin.effects import settings_of, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.simulation.two_encoders import shifted

X = load_machine().with_axes(["X"])
BELL = {
    "name": "law", "axis": "X", "block": "mechanics", "output": "friction", "variables": ["speed"],
    "formula": "gaussian", "height": -300.0, "width": 0.010,
}  # fmt: skip
STROKES = ((0.010, 0.015), (0.020, 0.03), (0.040, 0.06))
"""Distance [m] and speed [m/s] of the runs."""


def runs_of(effects: list[dict], strokes=STROKES) -> list[MeasuredRun]:
    """Short runs of X, with measuring noise, of a machine that has these effects."""
    runs = []
    for seed, (distance, speed) in enumerate(strokes):
        position = moves_in_turn(0.0, [distance, -distance], speed, 0.3, 5.0, 0.1, 1e-3)[1]
        run = simulate(with_effects(X, effects), Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=seed)
        runs.append(MeasuredRun(f"run{seed}", run.trace, "velocity+torque", 0.0))
    return runs


def found(effects: list[dict], thresholds: Thresholds = DEFAULT, strokes=STROKES):
    """Laws of X on these runs."""
    views = [view_of(X, run) for run in runs_of(effects, strokes)]
    folds = folds_of(len(views))
    return laws_of([observe(views, ("X",), thresholds=thresholds)], X, X, ["X"], folds, [X] * len(folds), in_turn)


def test_model_error_limits_the_accuracy_of_a_law():
    (law,) = found([BELL], replace(DEFAULT, model_error=0.2)).laws
    height = law.setting.parameters["height"]
    assert 0.2 * abs(height) < law.deviations["height"] < 0.3 * abs(height)


def test_a_law_is_kept_with_its_numbers_and_the_gap_closes():
    laws = found([BELL])
    assert [law.setting.table()["variables"] for law in laws.laws] == [["speed"]]
    law = laws.laws[0]
    assert law.measured.shape == "gaussian"
    assert law.setting.parameters["height"] == pytest.approx(-300.0, rel=0.1)
    assert law.setting.parameters["width"] == pytest.approx(0.010, rel=0.1)
    assert law.explained > 0.9
    assert laws.left["X"] < 0.1
    # the corrected machine and those fitted without a fold have the law
    assert all(len(settings_of(m)) == 1 for m in (laws.corrected, *laws.without_fold))


def test_a_law_replaces_the_effects_that_imitated_it():
    runs = runs_of([BELL])
    views = [view_of(X, run) for run in runs]
    folds = folds_of(len(views))
    wrong = with_effects(X, [{"name": "viscous_friction", "axis": "X", "factor": 0.7}])
    laws = laws_of([observe(views, ("X",))], X, wrong, ["X"], folds, [wrong] * len(folds), in_turn)
    assert [s.effect.name for s in settings_of(laws.corrected)] == ["law"]
    assert laws.laws[0].setting.parameters["height"] == pytest.approx(-300.0, rel=0.1)


def test_an_effect_that_is_there_stays_beside_the_law():
    there = {"name": "viscous_friction", "axis": "X", "factor": 1.6}
    views = [view_of(X, run) for run in runs_of([BELL, there])]
    folds = folds_of(len(views))
    right = with_effects(X, [there])
    laws = laws_of([observe(views, ("X",))], X, right, ["X"], folds, [right] * len(folds), in_turn)
    assert [s.effect.name for s in settings_of(laws.corrected)] == ["viscous_friction", "law"]


def test_a_law_that_only_one_run_shows_is_confirmed_within_that_run():
    """A limit that only the fastest of four runs reaches."""
    limit = {
        "name": "law", "axis": "X", "block": "position controller", "output": "speed", "variables": ["speed_setpoint"],
        "formula": "clip above", "limit": 0.05,
    }  # fmt: skip
    laws = found([limit], strokes=[*STROKES, (0.030, 0.02)])
    (law,) = laws.laws
    assert law.setting.parameters["limit"] == pytest.approx(0.05, rel=1e-3)
    assert law.only_fold == 2
    assert law.probability <= DEFAULT.confidence_in_one_run
    assert laws.without_fold[2].effects == laws.corrected.effects  # fitted to all runs


def test_a_disturbance_of_one_stretch_of_one_run_is_no_law():
    """A force that pulls for a tenth of a second in one of four runs is predicted by no other stretch."""
    runs = runs_of([], [*STROKES, (0.030, 0.02)])
    pushed = {
        "name": "law", "axis": "X", "block": "mechanics", "output": "force", "variables": ["time"], "formula": "gaussian",
        "height": 400.0, "at": 0.5, "width": 0.03,
    }  # fmt: skip
    runs[2] = runs_of([pushed], [*STROKES, (0.030, 0.02)])[2]
    folds = folds_of(len(runs))
    laws = laws_of([observe([view_of(X, run) for run in runs], ("X",))], X, X, ["X"], folds, [X] * len(folds), in_turn)
    assert laws.laws == ()


PLAY = {
    "name": "law", "axis": "X", "block": "measurement", "output": "displacement", "variables": ["slack"], "formula": "line",
    "height": -6e-6, "length": 6e-6,
}  # fmt: skip


def test_a_play_has_one_number():
    """Height and length of a play are both half its width, and stay equal."""
    state = state_of(X, with_effects(X, [PLAY]), ("X",), DEFAULT)
    unknowns = [u for u in unknowns_of(state, ("X",), 0.0) if u.setting is not None]
    assert [u.name for u in unknowns] == ["length"]
    (play,) = state.moved(unknowns, np.array([10.0])).settings
    assert play.parameters["length"] > 7e-6
    assert play.parameters["height"] == -play.parameters["length"]


TWO_STAGES = [
    {"name": "transmission_compliance", "axis": "X", "stiffness": 2e8, "damping": 3e4},
    {
        "name": "law", "axis": "X", "block": "transmission", "output": "force", "variables": ["windup"],
        "formula": "height * clip(windup / width, -1, 1)", "height": -2800.0, "width": 15e-6,
    },
]  # fmt: skip
"""A drive train that is soft within 15 um around its centre."""


def test_an_unexplained_gap_does_not_pull_parameters_out_of_their_tolerance():
    group = observe_once(runs_of(TWO_STAGES))
    spring, _ = TWO_STAGES  # stiff in its centre, too
    state = state_of(X, with_effects(X, [spring]), ("X",), group.thresholds)
    fitted = ClosedLoop(group, ("X",), folds_of(3), in_turn).fit(state, X.parameter_tolerance, steps=2)
    assert fitted is not None
    assert fitted.loss > 100.0 * group.expected_loss
    assert np.abs(fitted.state.deviations).max() < 3.0 * X.parameter_tolerance


def test_the_spring_beside_a_law_of_the_drive_train_is_fitted_with_its_damping():
    """Stiffness, damping, height and width start 5 % to a factor of 2 from the truth."""
    group = observe_once(runs_of(TWO_STAGES))
    spring, law = TWO_STAGES
    start = [{**spring, "stiffness": 2.1e8, "damping": 6e4}, {**law, "height": -2650.0, "width": 15.5e-6}]
    state = state_of(X, with_effects(X, start), ("X",), group.thresholds)
    fitted = ClosedLoop(group, ("X",), folds_of(3), in_turn).fit(state, X.parameter_tolerance)
    assert fitted is not None
    own = {s.effect.name: s.parameters for s in fitted.state.settings}
    assert own["transmission_compliance"]["stiffness"] == pytest.approx(2e8, rel=0.01)
    assert own["transmission_compliance"]["damping"] == pytest.approx(3e4, rel=0.2)
    assert own["law"]["height"] == pytest.approx(-2800.0, rel=0.01)
    assert own["law"]["width"] == pytest.approx(15e-6, rel=0.01)
    assert fitted.held_out < 1.1 * group.expected_loss


def test_a_play_of_the_scale_replaces_effects_that_the_search_put_in_its_place():
    """The search bent the drive train and changed its friction and motor; the law starts from the machine file, too."""
    wrong = with_effects(
        X,
        [
            {"name": "transmission_compliance", "axis": "X", "stiffness": 5e7},
            {"name": "coulomb_friction", "axis": "X", "factor": 1.2},
            {"name": "torque_constant", "axis": "X", "factor": 1.1},
        ],
    ).with_values({"axis.X.moving_mass_kg": 1.1 * X.document["axis"]["X"]["moving_mass_kg"]})
    views = [view_of(X, run) for run in runs_of([PLAY])]
    folds = folds_of(len(views))
    laws = laws_of([observe(views, ("X",))], X, wrong, ["X"], folds, [wrong] * len(folds), in_turn)
    (setting,) = settings_of(laws.corrected)
    assert setting.effect.name == "law"
    assert setting.parameters["length"] == pytest.approx(6e-6, rel=0.05)


def test_a_play_of_the_scale_replaces_a_spring_that_is_too_soft_to_be_normal():
    soft = with_effects(X, [{"name": "transmission_compliance", "axis": "X", "stiffness": 2.03e8}])
    views = [view_of(X, run) for run in runs_of([PLAY])]
    folds = folds_of(len(views))
    laws = laws_of([observe(views, ("X",))], X, soft, ["X"], folds, [soft] * len(folds), in_turn)
    assert [s.effect.name for s in settings_of(laws.corrected)] == ["law"]
    assert laws.laws[0].setting.parameters["length"] == pytest.approx(6e-6, rel=0.05)


def test_a_play_is_measured_beside_the_elasticity_of_the_drive_train():
    """The machine file has a rigid drive train. Its elasticity reverses with the motion, too."""
    laws = found([PLAY, {"name": "transmission_compliance", "axis": "X", "stiffness": 1.5e9}])
    own = {s.effect.name: s.parameters for s in settings_of(laws.corrected)}
    assert own.keys() == {"law", "transmission_compliance"}
    assert own["law"]["length"] == pytest.approx(6e-6, rel=0.01)
    assert own["transmission_compliance"]["stiffness"] == pytest.approx(1.5e9, rel=0.05)
    assert laws.left["X"] < 0.001


def test_a_lead_error_is_no_part_of_an_elastic_drive_train():
    lead = {"name": "lead_error", "axis": "X", "fraction": 5e-5}
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": 2e8}
    state = state_of(X, with_effects(X, [lead, spring]), ("X",), DEFAULT)
    assert [s.effect.name for s in drive_train_of(state.settings, "X")] == ["transmission_compliance"]
    assert [s.effect.name for s in with_rigid_drive_train(state, "X").settings] == ["lead_error"]


SLIP = {"name": "presliding", "axis": "X", "stiffness": 1.2e10}


@pytest.mark.parametrize(("shaken", "kept"), [(True, ["presliding"]), (False, [])])
def test_slip_is_judged_with_noise_in_the_loop(shaken, kept):
    """Noise makes an axis slip at rest. Without noise in the simulation, the slip of this axis seems to be of no use."""
    group = observe_once(runs_of([SLIP]))
    loop = ClosedLoop(group, ("X",), folds_of(3), in_turn, shaken)
    fitted = loop.fit(state_of(X, with_effects(X, [SLIP]), ("X",), DEFAULT), X.parameter_tolerance, steps=2)
    assert fitted is not None
    fitted = remove_needless_slip(loop, fitted, "X", X.parameter_tolerance)
    assert [s.effect.name for s in fitted.state.settings] == kept


@pytest.mark.parametrize("effects", [[], [SLIP]])
def test_laws_of_an_axis_that_slips_are_searched_with_noise_in_the_loop(effects, monkeypatch):
    searched = []
    monkeypatch.setattr("twin.diagnose.law.laws._search_axis", lambda loop, *_: searched.append(loop.shaken) or _AxisLaws([], None, 1.0))
    machine = with_effects(X, effects)
    laws_of([observe_once(runs_of([]))], X, machine, ["X"], folds_of(3), [machine] * 3, in_turn)
    assert searched == [bool(effects)]


def test_a_fine_wave_of_the_scale_is_measured_over_the_position_of_the_motor():
    """The scale's own position contains the wave, here a sixth of a period."""
    wave = {
        "name": "law", "axis": "X", "block": "measurement", "output": "displacement", "variables": ["position"], "formula": "sine",
        "amplitude": 3e-6, "period": 20e-6, "phase_rad": 0.5,
    }  # fmt: skip
    laws = found([wave], strokes=((0.010, 0.005), (0.150, 0.0937), (0.030, 0.0213), (0.200, 0.1379)))
    (law,) = laws.laws
    p = law.setting.parameters
    assert p["amplitude"] == pytest.approx(3e-6, rel=0.01)
    assert p["period"] == pytest.approx(20e-6, rel=1e-5)
    assert math.remainder(p["phase_rad"] - 0.5, 2.0 * math.pi) == pytest.approx(0.0, abs=0.1)
    assert laws.left["X"] < 0.01
    # a fit without some of the runs keeps the wave in phase over the whole range
    for machine in laws.without_fold:
        (setting,) = settings_of(machine)
        at = np.linspace(0.0, 0.2, 100)
        wave_of = [q["amplitude"] * np.sin(2.0 * np.pi * at / q["period"] + q["phase_rad"]) for q in (setting.parameters, p)]
        assert np.abs(wave_of[0] - wave_of[1]).max() < 0.1 * 3e-6


def test_a_machine_without_a_law_gets_none():
    laws = found([])
    assert laws.laws == ()
    assert np.array_equal(laws.corrected.effects, X.effects)


def test_encoder_zeros_are_fitted_with_every_law():
    runs = runs_of([{"name": "transmission_compliance", "axis": "X", "stiffness": 1e8}])
    apart = [replace(run, trace=shifted(run.trace, X.axes[0], (k - 1) * 3e-6)) for k, run in enumerate(runs)]
    states = [state_of(X, X, ("X",), observe_once(of).thresholds) for of in (runs, apart)]
    folds = folds_of(len(runs))
    left = [ClosedLoop(observe_once(of), ("X",), folds, in_turn).left(state) for of, state in zip((runs, apart), states)]
    np.testing.assert_allclose(left[0], left[1], atol=1e-6 * np.abs(left[0]).max())


def observe_once(runs):
    return observe([view_of(X, run) for run in runs], ("X",))


def test_an_effect_is_preferred_to_an_equivalent_law():
    """A sine over the motor turn is found as a law; the equivalent effect replaces it."""
    wave = {"name": "cyclic_error", "axis": "X", "amplitude": 4e-6, "phase_rad": 0.5}
    there = settings_of(with_effects(X, [wave]))
    group = observe_once(runs_of([wave]))
    loop = ClosedLoop(group, ("X",), folds_of(len(group.views)), in_turn)
    start = state_of(X, X, ("X",), group.thresholds)
    assert _search_from(loop, start, "X", X, lambda _: None).laws
    both = _search_from(loop, start, "X", X, lambda _: None, restorable=there)
    assert both.laws == []
    assert [s.effect.name for s in both.fitted.state.settings] == ["cyclic_error"]


def test_a_law_is_found_although_the_noise_of_all_channels_is_overestimated():
    """A notch, for example, roughens one signal, so that its noise is overestimated; the sum over all signals then lies below that of noise."""
    group = observe_once(runs_of([BELL]))
    loop = ClosedLoop(group, ("X",), folds_of(len(group.views)), in_turn)
    start = state_of(X, X, ("X",), group.thresholds)
    left = loop.left(start)
    loop.expected = 0.6 * float(left @ left)
    (law,) = _search_from(loop, start, "X", X, lambda _: None).laws
    assert law.setting.parameters["height"] == pytest.approx(-300.0, rel=0.1)


def test_a_single_run_is_predicted_half_by_half():
    """Random columns reduce the squares of the half that they are fitted to and worsen the prediction of the other half."""
    group = observe_once(runs_of([])[:1])
    loop = ClosedLoop(group, ("X",), folds_of(1), in_turn)
    state = state_of(X, X, ("X",), group.thresholds)
    (_, first), (_, second) = loop.parts
    assert np.array_equal(first, ~second)
    assert abs(int(first.sum()) - int(second.sum())) <= len(group.channels)
    rng = np.random.default_rng(0)
    before, columns = rng.standard_normal(group.size), rng.standard_normal((group.size, 40))
    left = before - columns @ np.linalg.lstsq(columns, before, rcond=None)[0]
    nothing = np.zeros(40)
    fitted = loop._cross_validated(state, [], left, columns, 0.5 * float(left @ left), nothing, nothing)
    assert fitted.loss < 0.5 * float(before @ before) < fitted.held_out
    assert fitted.without(0) == state  # the machine file is fitted to all samples


@dataclass(frozen=True)
class _State:
    settings: tuple
    machine_of: Any = None


@pytest.mark.parametrize(("left_by_effect", "named"), [(103.0, ["backlash"]), (140.0, ["law"])])
def test_an_effect_replaces_a_law_only_if_it_predicts_as_well(left_by_effect, named):
    """Play of a scale explains almost as much of the gap (1000 here) as a backlash, but the difference is large against noise (100)."""
    play, backlash = (SimpleNamespace(key=name) for name in ("law", "backlash"))
    left = {("law",): 100.0, ("backlash",): left_by_effect, (): 1000.0}

    def fit(state, *_: Any, **__: Any):
        return SimpleNamespace(state=state, held_out=left[tuple(s.key for s in state.settings)])

    loop = SimpleNamespace(fit=fit, expected=100.0)
    fitted = fit(_State((play,)))
    assert [s.key for s in replace_laws_by_effects(loop, fitted, [play], [backlash], 0.01).state.settings] == named


def test_a_fit_with_the_slopes_of_another_has_the_same_result(monkeypatch):
    loop = ClosedLoop(observe([view_of(X, run) for run in runs_of([BELL])], ("X",)), ("X",), folds_of(3), in_turn)
    simulated = []
    left = loop.residuals_of_each
    monkeypatch.setattr(loop, "residuals_of_each", lambda states: simulated.extend(states) or left(states))

    def fitted(height, like=None):
        simulated.clear()
        fit = loop.fit(state_of(X, with_effects(X, [{**BELL, "height": height}]), ("X",), DEFAULT), X.parameter_tolerance, like=like)
        assert fit is not None
        return fit, len(simulated)

    first, _ = fitted(-290.0)
    alone, simulated_alone = fitted(-280.0)
    beside, simulated_beside = fitted(-280.0, like=first)
    assert simulated_beside < 0.5 * simulated_alone
    assert beside.held_out == pytest.approx(alone.held_out, rel=1e-4)
    assert beside.state.settings[0].parameters["height"] == pytest.approx(alone.state.settings[0].parameters["height"], rel=1e-3)
    # slopes of the wrong sign are computed again
    wrong, _ = fitted(-280.0, like=replace(first, columns=-first.columns))
    assert wrong.state.settings[0].parameters["height"] == pytest.approx(alone.state.settings[0].parameters["height"], rel=1e-2)


def test_a_height_of_the_wrong_sign_changes_its_sign():
    loop = ClosedLoop(observe([view_of(X, run) for run in runs_of([BELL])], ("X",)), ("X",), folds_of(3), in_turn)
    start = state_of(X, with_effects(X, [{**BELL, "height": 1.0}]), ("X",), DEFAULT)
    fitted = loop.fit(start, X.parameter_tolerance)
    assert fitted is not None
    assert fitted.state.settings[0].parameters["height"] == pytest.approx(-300.0, rel=0.1)


@pytest.mark.parametrize(("height", "kept"), [(-300.0, True), (-0.001, False)])
def test_a_law_with_an_insignificant_height_is_removed(height, kept):
    views = [view_of(X, run) for run in runs_of([BELL] if kept else [])]
    loop = ClosedLoop(observe(views, ("X",)), ("X",), folds_of(3), in_turn)
    state = state_of(X, with_effects(X, [{**BELL, "height": height}]), ("X",), DEFAULT)
    fitted = loop.fit(state, X.parameter_tolerance, steps=0)
    assert fitted is not None
    fitted = replace(fitted, deviations=np.full(len(fitted.unknowns), 0.1 if kept else 1e6))
    assert is_significant(fitted, 0) is kept


def searched(monkeypatch, left: dict[tuple[str, ...], float], proposed: list[list[str]]) -> list[str]:
    """Laws that a search finds if `left` is the loss of each set of laws and `proposed` the laws that are proposed from call to call."""
    waiting = [[(name, None, SimpleNamespace(key=name)) for name in names] for names in proposed]

    def fit(state, *_: Any, **__: Any):
        return SimpleNamespace(state=state, held_out=left[tuple(s.key for s in state.settings)], unknowns=[], deviations=[])

    module = "twin.diagnose.law.laws."
    for name, instead in {
        "residuals_of": lambda *_: [],
        "propose_laws": lambda *_: None,
        "settings_of_proposals": lambda *_: waiting.pop(0) if waiting else [],
        "label": str,
        "with_fitted_spring": lambda state, *_: state,
        "with_normal_elasticity": lambda _, fitted, *__: fitted,
        "restore_effects": lambda _, fitted, *__: fitted,
        "replace_laws_by_effects": lambda _, fitted, *__: fitted,
        "remove_settings_that_add_nothing": lambda _, fitted, *__: fitted,
        "remove_needless_slip": lambda _, fitted, *__: fitted,
    }.items():
        monkeypatch.setattr(module + name, instead)
    group = SimpleNamespace(views=[], thresholds=DEFAULT, confidence=lambda axis: 0.98)
    loop = SimpleNamespace(fit=fit, expected=100.0, inflation=lambda loss: 1.0, group=group, mapper=in_turn, only_fold=None)
    found = _search_from(loop, _State(()), "X", X, lambda _: None, selections=(STRONG, WEAK))
    return [str(law.measured) for law in found.laws]


def test_a_law_that_was_second_best_is_tried_again_beside_the_best(monkeypatch):
    """What the best law leaves of the force may be too rough to show the second one, which reduced the gap before."""
    left = {(): 10000.0, ("best",): 4000.0, ("second",): 7000.0, ("useless",): 9990.0, ("best", "second"): 1000.0}
    assert searched(monkeypatch, left, [["second", "useless", "best"]]) == ["best", "second"]


def test_a_law_that_predicts_little_of_its_block_is_tried_if_no_other_reduces_the_gap(monkeypatch):
    left = {(): 10000.0, ("useless",): 9990.0, ("weak",): 6000.0, ("strong",): 5000.0, ("strong", "weak"): 1000.0}
    assert searched(monkeypatch, left, [["useless"], ["weak"]]) == ["weak"]
    assert searched(monkeypatch, left | {("strong", "useless"): 4990.0}, [["strong"], ["useless"], ["weak"]]) == ["strong", "weak"]


def test_a_reversal_without_a_stop_is_full_evidence_of_a_law():
    """After a stop it depends on how the axis stuck; the search for effects weighs both alike."""
    there = 1e-3 * np.cumsum(0.03 * np.concatenate([np.ones(400), -np.ones(400)]))  # reverses at sample 399, stops from 800
    position = np.concatenate([there, np.full(300, there[-1]), there[-1] + 3e-5 * np.arange(1, 401)])
    trace = simulate(X, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    group = observe([view_of(X, MeasuredRun("run", trace, "velocity+torque", 0.0))], ("X",))
    rows = next(c for c in group.channels if c.name == "position").rows
    after_reversal, after_stop = rows.start + 450, rows.start + 1150
    for credit, expected in ((group.credit, (0.03, 0.03, 1.0)), (ClosedLoop(group, ("X",), [[0]], in_turn).credit, (1.0, 0.03, 1.0))):
        assert (credit[after_reversal], credit[after_stop], credit[rows.start + 700]) == expected


def test_a_sine_over_the_turn_is_a_harmonic_of_it():
    """Its period is not fitted: over many turns a small error of it would be a large error of the phase."""
    wave = {**BELL, "variables": ["turn"], "formula": "sine", "amplitude": 20.0, "period": math.pi, "phase_rad": 0.3}
    machine = with_effects(X, [{k: v for k, v in wave.items() if k not in ("height", "width")}])
    names = [u.name for u in unknowns_of(state_of(X, machine, ("X",), DEFAULT), ("X",), X.parameter_tolerance) if u.setting is not None]
    assert names == ["amplitude", "phase_rad"]
