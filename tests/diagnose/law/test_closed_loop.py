"""Closed-loop fit of laws: a law of the recorded machine is found and cross-validated; a machine without a law gets none."""

from __future__ import annotations

from dataclasses import replace
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of, no_tuning
from twin.diagnose.corrected import fitted_without
from twin.diagnose.cross_validation import folds_of
from twin.diagnose.fit import fit_with_fixed_effects, free_parameters, simulated_response
from twin.diagnose.law import laws as law_search
from twin.diagnose.law.closed_loop import OUTSIDE, ClosedLoop, closed_loop
from twin.diagnose.law.laws import _search_from, laws_of, settled
from twin.diagnose.law.proposals import STRONG, WEAK, ProposedLaw
from twin.diagnose.observe import Group, observe
from twin.diagnose.settings import T
from twin.diagnose.tolerance import drive_train_of
from twin.diagnose.view import view_of
from twin.effects import EFFECTS, Setting, settings_of, with_effects
from twin.errors import SimulationError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.motor_and_scale import shifted
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

X = load_machine().with_axes(["X"])
BELL = {
    "name": "law", "axis": "X", "block": "mechanics", "output": "friction", "variables": ["speed"],
    "formula": "gaussian", "height": -300.0, "width": 0.010,
}  # fmt: skip
STROKES = ((0.010, 0.015), (0.020, 0.03), (0.040, 0.06))
"""Distance [m] and speed [m/s] of the runs."""


def runs_of(effects: list[dict], strokes=STROKES, acceleration: float = 0.3) -> list[MeasuredRun]:
    """Short runs of X, with measuring noise, of a machine that has these effects."""
    runs = []
    for seed, (distance, speed) in enumerate(strokes):
        position = moves_in_turn(0.0, [distance, -distance], speed, acceleration, 5.0 / 0.3 * acceleration, 0.1, 1e-3)[1]
        run = simulate(with_effects(X, effects), Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=seed)
        runs.append(MeasuredRun(f"run{seed}", run.trace, "velocity+torque", 0.0))
    return runs


def observed(runs):
    return observe([view_of(X, run) for run in runs], ("X",))


def laws_beside(effects: list[dict], group, machine=X):
    """Laws of X beside these effects of a search."""
    settings = settings_of(with_effects(machine, effects))
    response = simulated_response(group, settings) if settings else np.zeros(group.size)
    state = found_of(group, no_tuning(group.size), fit_with_fixed_effects(group, no_tuning(group.size), settings, response))
    return laws_of([state], ["X"], folds_of(len(group.views)))


def found(effects: list[dict], strokes=STROKES):
    """Laws of X on these runs."""
    return laws_beside([], observed(runs_of(effects, strokes)))


def loop_of(group, shakes: bool = False, count: int = 0) -> ClosedLoop:
    return closed_loop(group, "X", folds_of(count or len(group.views)), shakes)


def names(settings) -> list[str]:
    return [s.effect.name for s in settings]


def test_model_error_limits_the_accuracy_of_a_law(monkeypatch):
    monkeypatch.setattr(T, "model_error", 0.2)
    (law,) = found([BELL]).laws
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
    assert sum(law.explained for law in laws.laws) > 0.9
    # the corrected machine and those fitted without a fold have the law
    assert all(len(settings_of(m)) == 1 for m in (laws.corrected, *(fitted_without(X, laws.states, fold) for fold in folds_of(3))))


def test_a_law_replaces_the_effects_that_imitated_it():
    laws = laws_beside([{"name": "viscous_friction", "axis": "X", "factor": 0.7}], observed(runs_of([BELL])))
    assert names(settings_of(laws.corrected)) == ["law"]
    assert laws.laws[0].setting.parameters["height"] == pytest.approx(-300.0, rel=0.1)


def test_an_effect_that_is_there_stays_beside_the_law():
    there = {"name": "viscous_friction", "axis": "X", "factor": 1.6}
    laws = laws_beside([there], observed(runs_of([BELL, there])))
    assert sorted(names(settings_of(laws.corrected))) == ["law", "viscous_friction"]
    assert list(laws.beside.values()) == pytest.approx([1.0], abs=0.05)


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
    assert law.probability <= T.confidence_in_one_run


def test_a_disturbance_of_one_stretch_of_one_run_is_no_law():
    """A force that pulls for a tenth of a second in one of four runs is predicted by no other stretch."""
    runs = runs_of([], [*STROKES, (0.030, 0.02)])
    pushed = {
        "name": "law", "axis": "X", "block": "mechanics", "output": "force", "variables": ["time"], "formula": "gaussian",
        "height": 400.0, "at": 0.5, "width": 0.03,
    }  # fmt: skip
    runs[2] = runs_of([pushed], [*STROKES, (0.030, 0.02)])[2]
    assert laws_beside([], observed(runs)).laws == ()


PLAY = {
    "name": "law", "axis": "X", "block": "measurement", "output": "displacement", "variables": ["slack"], "formula": "line",
    "height": -6e-6, "length": 6e-6,
}  # fmt: skip


def test_a_play_has_one_number():
    """Height and length of a play are both half its width, and stay equal."""
    settings = settings_of(with_effects(X, [PLAY]))
    (free,) = free_parameters(settings, X)
    assert free.parameter.name == "length"
    (play,) = free.moved(settings, 10.0)
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
    """Neither that of the axis nor that of another one in its group, which shares its bodies."""
    group = observed(runs_of(TWO_STAGES))
    spring, _ = TWO_STAGES  # stiff in its centre, too
    for loop in (loop_of(group), replace(loop_of(group), axis="Y")):
        fitted = loop.start(settings_of(with_effects(X, [spring])))
        assert fitted is not None
        assert fitted.fit.loss > 100.0 * group.expected_loss
        about = fitted.fit.about
        assert np.abs(fitted.fit.theta).max() * about.spread < 3.0 * X.parameter_tolerance


def test_an_axis_that_cannot_be_simulated_does_not_end_the_search_on_the_others(monkeypatch):
    def refused(*_):
        raise SimulationError("axis X diverges")

    monkeypatch.setattr(law_search, "_search_axis", refused)
    assert laws_beside([], observed(runs_of([]))).laws == ()


def test_the_spring_beside_a_law_of_the_drive_train_is_fitted_with_its_damping():
    """Stiffness, damping, height and width start 5 % to a factor of 2 from the truth."""
    group = observed(runs_of(TWO_STAGES))
    spring, law = TWO_STAGES
    start = [{**spring, "stiffness": 2.1e8, "damping": 6e4}, {**law, "height": -2650.0, "width": 15.5e-6}]
    loop = loop_of(group)
    first = loop.start(settings_of(with_effects(X, start)))
    assert first is not None
    fitted = loop.refits(first, [first.settings])[0]
    assert fitted is not None
    own = {s.effect.name: s.parameters for s in fitted.settings}
    assert own["transmission_compliance"]["stiffness"] == pytest.approx(2e8, rel=0.01)
    assert own["transmission_compliance"]["damping"] == pytest.approx(3e4, rel=0.2)
    assert own["law"]["height"] == pytest.approx(-2800.0, rel=0.01)
    assert own["law"]["width"] == pytest.approx(15e-6, rel=0.01)
    assert fitted.held_out < 1.1 * group.expected_loss


def hardening(stiffness: float, height: float, reach: float) -> list[dict]:
    """A spring with a force beside it that grows with the third power of the windup."""
    law = {"name": "law", "axis": "X", "block": "transmission", "output": "force", "variables": ["windup"]}
    return [
        {"name": "transmission_compliance", "axis": "X", "stiffness": stiffness, "damping": 5e4},
        {**law, "formula": "power", "height": height, "reach": reach, "n": 3.0},
    ]


def test_a_hardening_spring_replaces_the_backlash_that_imitated_it():
    """The spring is soft within a few um; beside a backlash no law over the windup would fit."""
    runs = runs_of(hardening(8e7, 1600.0, 5.8e-6), ((0.010, 0.05), (0.020, 0.1), (0.040, 0.2)), acceleration=1.0)
    laws = laws_beside([{"name": "backlash", "axis": "X", "clearance": 8.6e-6}], observed(runs))
    own = {s.effect.name: s.parameters for s in settings_of(laws.corrected)}
    assert own.keys() == {"transmission_compliance", "law"}
    assert own["transmission_compliance"]["stiffness"] == pytest.approx(8e7, rel=0.05)
    assert own["law"]["n"] == pytest.approx(3.0, rel=0.03)


def test_a_hardening_spring_is_a_law_of_the_drive_train_where_slow_strokes_show_two_of_its_forces():
    """Friction of either sign loads the spring; its shape hardly shows. A play of the scale had been named."""
    runs = runs_of(hardening(8.4e7, 370.0, 4.3e-6))
    laws = laws_beside([{"name": "backlash", "axis": "X", "clearance": 8.6e-6}], observed(runs))
    assert sorted(names(settings_of(laws.corrected))) == ["law", "transmission_compliance"]
    assert laws.laws[0].setting.effect.definition["variables"] == ["windup"]


def test_a_play_of_the_scale_replaces_effects_that_the_search_put_in_its_place():
    """The search bent the drive train and changed its friction and motor; the law starts from the machine file, too."""
    wrong = [
        {"name": "transmission_compliance", "axis": "X", "stiffness": 5e7},
        {"name": "coulomb_friction", "axis": "X", "factor": 1.2},
        {"name": "torque_constant", "axis": "X", "factor": 1.1},
    ]
    (setting,) = settings_of(laws_beside(wrong, observed(runs_of([PLAY]))).corrected)
    assert setting.effect.name == "law"
    assert setting.parameters["length"] == pytest.approx(6e-6, rel=0.05)


def test_a_play_of_the_scale_replaces_a_spring_that_is_too_soft_to_be_normal():
    laws = laws_beside([{"name": "transmission_compliance", "axis": "X", "stiffness": 2.03e8}], observed(runs_of([PLAY])))
    assert names(settings_of(laws.corrected)) == ["law"]
    assert laws.laws[0].setting.parameters["length"] == pytest.approx(6e-6, rel=0.05)


def test_a_play_is_measured_beside_the_elasticity_of_the_drive_train():
    """The machine file has a rigid drive train. Its elasticity reverses with the motion, too."""
    laws = found([PLAY, {"name": "transmission_compliance", "axis": "X", "stiffness": 1.5e9}])
    own = {s.effect.name: s.parameters for s in settings_of(laws.corrected)}
    assert own.keys() == {"law", "transmission_compliance"}
    assert own["law"]["length"] == pytest.approx(6e-6, rel=0.01)
    assert own["transmission_compliance"]["stiffness"] == pytest.approx(1.5e9, rel=0.05)
    assert sum(law.explained for law in laws.laws) > 0.999


def test_a_lead_error_is_no_part_of_an_elastic_drive_train():
    lead = {"name": "lead_error", "axis": "X", "fraction": 5e-5}
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": 2e8}
    settings = settings_of(with_effects(X, [lead, spring]))
    assert names(drive_train_of(settings, "X")) == ["transmission_compliance"]


SLIP = {"name": "presliding", "axis": "X", "stiffness": 1.2e10}


@pytest.mark.parametrize(("shaken", "kept"), [(True, ["presliding"]), (False, [])])
def test_slip_is_judged_with_noise_in_the_loop(shaken, kept):
    """Noise makes an axis slip at rest. Without noise in the simulation, the slip of this axis seems to be of no use."""
    loop = loop_of(observed(runs_of([SLIP])), shaken)
    fitted = loop.start(settings_of(with_effects(X, [SLIP])))
    assert fitted is not None
    assert names(settled(loop, fitted, ())[0].settings) == kept


@pytest.mark.parametrize("effects", [[], [SLIP]])
def test_laws_of_an_axis_that_slips_are_searched_with_noise_in_the_loop(effects, monkeypatch):
    searched = []
    monkeypatch.setattr(law_search, "_search_axis", lambda loop, *_: searched.append(loop.group.shakes))
    laws_beside(effects, observed(runs_of([])))
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
    assert sum(law.explained for law in laws.laws) > 0.99
    # a fit without some of the runs keeps the wave in phase over the whole range
    for fold in folds_of(4):
        (setting,) = settings_of(fitted_without(X, laws.states, fold))
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
    alike, other = (loop_of(observed(of)).start(()) for of in (runs, apart))
    assert alike is not None
    assert other is not None
    assert other.held_out == pytest.approx(alike.held_out, rel=1e-4)


def test_an_effect_is_preferred_to_an_equivalent_law():
    """A sine over the motor turn is found as a law; the equivalent effect replaces it."""
    wave = {"name": "cyclic_error", "axis": "X", "amplitude": 4e-6, "phase_rad": 0.5}
    loop = loop_of(observed(runs_of([wave])))
    alone = _search_from(loop, loop.start(()), (), lambda _: None)
    assert alone is not None
    assert alone.laws
    both = _search_from(loop, loop.start(()), settings_of(with_effects(X, [wave])), lambda _: None)
    assert both is not None
    assert not both.laws
    assert names(both.fitted.settings) == ["cyclic_error"]


def test_a_law_is_found_although_the_noise_of_all_channels_is_overestimated():
    """A notch, for example, roughens one signal, so that its noise is overestimated; the sum over all signals then lies below that of noise."""
    group = observed(runs_of([BELL]))
    noisier = replace(
        group, channels=[replace(c, sigma=c.sigma * max(1.0, 1.1 * np.sqrt(np.mean((c.residual / c.sigma) ** 2)))) for c in group.channels]
    )
    loop = loop_of(noisier)
    first = loop.start(())
    assert first is not None
    assert first.held_out < loop.expected
    found = _search_from(loop, loop.start(()), (), lambda _: None)
    assert found is not None
    (law,) = found.fitted.settings
    assert law.parameters["height"] == pytest.approx(-300.0, rel=0.1)


def test_a_single_run_is_predicted_half_by_half():
    """Random columns reduce the squares of the half that they are fitted to and worsen the prediction of the other half."""
    group = observed(runs_of([])[:1])
    loop = loop_of(group)
    first, second = loop.parts
    assert [r.stop for r in first] == [r.start for r in second]
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((group.size, 40))
    free = group_of([rng.standard_normal(group.size)])
    tuning = no_tuning(group.size).with_free(columns_of(columns))
    fit = fit_with_fixed_effects(free, tuning, (), np.zeros(group.size))
    alone = ClosedLoop(free, "X", ((slice(0, group.size),),)).halving(0, np.ones(group.size))
    assert fit.loss < 0.5 * float(free.residual @ free.residual) < alone.with_cost(fit).held_out


@pytest.mark.parametrize(("left_by_effect", "named"), [(15.0, ["backlash"]), (20.0, ["law"])])
def test_an_effect_replaces_a_law_only_if_it_predicts_as_well(left_by_effect, named):
    """Play of a scale explains almost as much as a backlash; the difference decides, against the price of a claim outside the library (16)."""
    play, backlash = (Setting(settings_of(with_effects(X, [PLAY]))[0].effect, "X", PLAY), Setting(EFFECTS["backlash"], "X", {}))
    assert play_or_effect({("law",): 0.0, ("backlash",): left_by_effect, (): 1000.0}, play, backlash) == named


def play_or_effect(misfits, play, backlash):
    loop = costs_of(misfits)
    return names(settled(loop, loop.start((play,)), (backlash,))[0].settings)


def costs_of(misfits: dict[tuple[str, ...], float]) -> Any:
    """A closed loop in which each set of terms has this misfit."""

    def start(settings):
        misfit = misfits.get(tuple(s.effect.name for s in settings), 1e4)
        cost = misfit + T.evidence * len(settings) + OUTSIDE * any(s.effect.name == "law" for s in settings)
        return SimpleNamespace(settings=tuple(settings), misfit=misfit, held_out=misfit, cost=cost, fit=None)

    return SimpleNamespace(
        axis="X",
        group=SimpleNamespace(machine=X, views=[], mapper=map),
        refits=lambda like, several, steps=None: [start(settings) for settings in several],
        start=start,
        above_noise=lambda f: f.misfit,
    )


def test_a_fit_with_the_slopes_of_another_has_the_same_result(monkeypatch):
    group = observed(runs_of([BELL]))
    simulated = []
    monkeypatch.setattr(
        Group, "responses", lambda self, variations, **how: simulated.extend(variations) or RESPONSES(self, variations, **how)
    )
    loop = loop_of(group)
    nothing = loop.start(())
    assert nothing is not None

    def fitted(height, like):
        simulated.clear()
        fit = loop.refits(like, [settings_of(with_effects(X, [{**BELL, "height": height}]))])[0]
        assert fit is not None
        return fit, len(simulated)

    first, simulated_alone = fitted(-280.0, nothing)
    beside, simulated_beside = fitted(-280.0, first)
    assert simulated_beside < simulated_alone
    assert beside.held_out == pytest.approx(first.held_out, rel=1e-3)
    assert beside.settings[0].parameters["height"] == pytest.approx(first.settings[0].parameters["height"], rel=1e-2)
    # slopes of the wrong sign are computed again
    wrong, _ = fitted(-280.0, replace(first, fit=replace(first.fit, columns=first.fit.columns.scaled(-np.ones(loop.group.size)))))
    assert wrong.settings[0].parameters["height"] == pytest.approx(first.settings[0].parameters["height"], rel=1e-2)


RESPONSES = Group.responses


def test_a_height_of_the_wrong_sign_changes_its_sign():
    loop = loop_of(observed(runs_of([BELL])))
    nothing = loop.start(())
    assert nothing is not None
    fitted = loop.refits(nothing, [settings_of(with_effects(X, [{**BELL, "height": 1.0}]))])[0]
    assert fitted is not None
    assert fitted.settings[0].parameters["height"] == pytest.approx(-300.0, rel=0.1)


@pytest.mark.parametrize(("effects", "height", "kept"), [([BELL], -300.0, True), ([], -0.001, False)])
def test_a_law_with_an_insignificant_height_is_not_possible(effects, height, kept):
    loop = loop_of(observed(runs_of(effects)))
    fitted = loop.start(settings_of(with_effects(X, [{**BELL, "height": height}])))
    assert fitted is not None
    assert loop.is_possible(fitted, fitted.settings[0]) is kept


def searched(monkeypatch, left: dict[tuple[str, ...], float], proposed: list[list[str]]) -> list[str]:
    """Laws that a search finds if `left` is the misfit of each set of laws and `proposed` the laws that are proposed from call to call."""

    def law(name):
        return SimpleNamespace(key=name, effect=SimpleNamespace(name=name, normal=""), axis="X")

    waiting = [[ProposedLaw(name, None, law(name)) for name in some] for some in proposed]
    for name, instead in {
        "residuals_of": lambda *_: [],
        "tuned": lambda *_: None,
        "propose_laws": lambda *_: waiting.pop(0) if waiting else [],
        "label": str,
        "with_fitted_spring": lambda settings, *_: settings,
        "with_normal_elasticity": lambda _, fitted: fitted,
        "settled": lambda loop, fitted, _: (fitted, {}),
    }.items():
        monkeypatch.setattr(law_search, name, instead)
    loop = costs_of(left)
    about = SimpleNamespace(nuisances=(), spread=0.0)
    plain = loop.start

    def start(settings):
        fit = plain(settings)
        fit.fit, fit.cost = (
            SimpleNamespace(about=about, theta=np.zeros(0)),
            fit.misfit + T.evidence * len(settings) + OUTSIDE * bool(settings),
        )
        return fit

    loop.refits, loop.start = lambda like, several: [start(settings) for settings in several], start
    found = _search_from(loop, loop.start(()), (), lambda _: None, (STRONG, WEAK))
    return [str(name) for (name, _, _), _ in found.laws.values()]


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
    of_laws = np.concatenate([c.credit for c in loop_of(group, count=1).group.channels])
    for credit, expected in ((group.credit, (0.03, 0.03, 1.0)), (of_laws, (1.0, 0.03, 1.0))):
        assert (credit[after_reversal], credit[after_stop], credit[rows.start + 700]) == expected


def test_a_sine_over_the_turn_is_a_harmonic_of_it():
    """Its period is not fitted: over many turns a small error of it would be a large error of the phase."""
    wave = {**BELL, "variables": ["turn"], "formula": "sine", "amplitude": 20.0, "period": math.pi, "phase_rad": 0.3}
    machine = with_effects(X, [{k: v for k, v in wave.items() if k not in ("height", "width")}])
    assert [f.parameter.name for f in free_parameters(settings_of(machine), X)] == ["amplitude", "phase_rad"]
