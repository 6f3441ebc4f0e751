"""Every threshold of the diagnosis in one frozen object, which is passed down with the runs: value, unit, meaning, provenance.

    replace(DEFAULT, evidence=20.0)     the same diagnosis with one threshold changed
    listed(DEFAULT)                     each with its unit, meaning and where its value comes from

`devtools/sensitivity.py` varies each by a third and prints which of them change an answer. Grids of starting values (frequencies to
try, shares to try) are no thresholds; they stand beside the code that uses them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

JUDGEMENT = "engineering judgement"
IMITATION = "devtools/measure_imitation.py"
PILOT = "pilot on one axis with 24 effects: about 60 independent samples a signal"


def _of(value: float, unit: str, meaning: str, provenance: str = JUDGEMENT) -> Any:
    """A field of `Thresholds` with its default value and what is known about it."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "provenance": provenance})


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of a diagnosis. Squares are over noise; nat is the unit of a log likelihood; a share lies between 0 and 1."""

    # the campaign
    off_set_point: float = _of(0.2, "share of the motion", "a larger position gap comes from another machine")
    off_lag: float = _of(3.0, "1", "times the lag of the loop that a position gap may reach on any machine")
    enough_samples: int = _of(50, "samples", "fewest moving samples of a channel that is used")

    # noise of a channel
    noise_correlation: int = _of(150, "samples", "longest correlation of noise, the memory of the loop")
    noisier: float = _of(5.0, "1", "roughness over the expected one up to which a record is taken for noisy")
    break_away_s: float = _of(0.06, "s", "time after break-away in which a position shows where the axis was stuck")
    settled_s: float = _of(0.2, "s", "time after break-away from which nothing shows how the axis was stuck")
    unsettled_weight: float = _of(0.03, "1", "weight as evidence of samples before that")
    resting: float = _of(0.3, "share of the normal slip", "standard deviation of the place at which an axis rests")
    law_floor: float = _of(0.01, "share of the speed noise", "least noise of the control law")
    clipped: float = _of(0.999, "share of the limit", "from here a command counts as clipped and says nothing about the law")
    law_share: float = _of(
        1e-4, "share of the speed", "model error of a control law; a real one, fitted by hand, is off by 3e-5 of its top speed"
    )

    zero_least: float = _of(20.0, "encoder noises", "constant difference of two encoders from which they have no common zero")
    zero_constant: float = _of(0.25, "share", "deviation within a run, over the largest difference, up to which the difference is constant")
    zero_by_trend: float = _of(0.9, "share", "variance between runs by time and place from which it is an effect: drift, lead error")

    trend_runs: int = _of(5, "runs", "runs from which a trend over time and place, which has three parameters, is tested")
    followed: float = _of(0.8, "share", "share of motor minus scale that the motion of other axes explains if one of them pushes this axis")
    pushed: float = _of(5.0, "encoder noises", "motion of motor minus scale from which an axis at rest counts as pushed")

    # a channel that holds nothing but noise
    clean_square: float = _of(1.15, "1", "mean square over noise of a clean channel")
    clean_spread: float = _of(6.0, "1", "standard deviations of that mean square that are chance")
    clean_mean_square: float = _of(1.5, "1", "mean square of slow means of a clean channel")
    clean_mean: float = _of(6.5, "1", "largest slow mean of a clean channel")
    clean_law_square: float = _of(1.5, "1", "mean square of a control law that holds")
    clean_law_mean: float = _of(2.0, "1", "largest mean over 25 samples of a control law that holds")

    # how far the twin is trusted
    shapes: float = _of(60.0, "1", "independent shapes that a model error takes over one channel; more samples know no more", PILOT)
    doubt: float = _of(0.01, "share", "share of what an effect changes to which its law is trusted")
    lag_s: float = _of(0.01, "s", "time by which what an effect changes may come early or late")
    event_s: float = _of(0.1, "s", "length of a break-away; what is left within it is one fault at one moment")
    by_chance: float = _of(1.5, "1", "mean square of so short a stretch that noise makes")
    outlier: float = _of(5.0, "1", "standard deviations beyond which squares grow linearly")

    # tolerance and normal imperfections
    prior_weight: float = _of(50.0, "1", "weight of the tolerance against the samples: its edge costs 75 nat")
    widest: float = _of(2.0, "tolerances", "largest deviation of a re-tuned parameter")
    nearby: float = _of(0.03, "share", "change of a parameter that shows what its spread does")
    normal_mode_hz: float = _of(180.0, "Hz", "first mode of a drive train from which its elasticity is normal")
    normal_slip_linear_m: float = _of(0.8e-6, "m", "travel before break-away that is normal, linear axis")
    normal_slip_rotary_arcsec: float = _of(0.8, "arcsec", "travel before break-away that is normal, rotary axis")
    normal_damping: float = _of(2.0, "1", "factor by which the damping of a drive train may differ")
    least_imperfection: float = _of(0.01, "share of normal", "a smaller imperfection is none")
    least_slip: float = _of(0.04, "share of normal", "less slip stays out of a machine: its spring is too stiff for a tick")
    imperfection_earned: float = _of(14.0, "nat", "evidence that a normal imperfection must bring")
    imperfect_worse: float = _of(0.02, "share", "how much more a machine with all imperfections may leave than promised")
    slip_unchanged: float = _of(0.15, "share", "a slip that moves by less needs no new simulation")
    train_shown: float = _of(0.6, "share", "share of a drive train's change that the runs hold on which it is sought")
    train_finer: float = _of(0.03, "share", "last step of a drive train's frequency")

    # fits
    fit_steps: int = _of(8, "steps", "most Gauss-Newton steps of a fit")
    quick_steps: int = _of(3, "steps", "the same of a quick look")
    refit_steps: int = _of(4, "steps", "steps of a fit that starts where it was before")
    largest_step: float = _of(6.0, "scale units", "largest Gauss-Newton step")
    slope: float = _of(1.0, "scale units", "step over which slopes are taken: wide beside a break-away that moves by a sample")
    narrow_slope: float = _of(0.1, "scale units", "the same where a wide one leads no further")
    slopes_hold: float = _of(0.5, "share", "share of its promise that a step must bring for its slopes to serve again")
    above_noise: float = _of(1.05, "1", "loss over that of noise up to which a fit is done")
    converged: float = _of(0.02, "nat", "a step that gains less is the last")
    within_mode: float = _of(0.06, "share", "change of a drive train's elasticity that shows what it does")
    wave_run_s: float = _of(15.0, "s", "length of a run for which a frequency is known to part of a wave")
    wave_step: float = _of(0.1, "waves", "shift of the far end of a wave by a step of 1")

    # screening
    screened_largest: float = _of(4.0, "1", "largest multiple of a start in screening")
    screened_least: float = _of(0.02, "1", "smallest multiple of a start in screening")
    screened_delay: float = _of(1e-5, "1", "the same of a lag's delay")
    softest_spring: float = _of(2.0, "1", "how much more than its start a spring may give in screening")
    stiffest_spring: float = _of(0.05, "1", "how much less than its start a spring may give in screening")
    rounds: int = _of(8, "rounds", "most rounds of screening and fitting")
    most_asked: int = _of(2, "times", "times that an effect is fitted: what was refused may show beside others")
    together: int = _of(8, "effects", "most effects that one round adds to a group of axes")
    span: float = _of(
        0.01, "share of the best gain", "gain from which effects enter in the same round: answers are not quite in proportion"
    )
    promising: float = _of(
        0.5, "share of the evidence needed", "gain in screening from which an effect is fitted: its shape is not found yet"
    )
    sure: float = _of(0.9, "share of the evidence needed", "the same of an effect that has a size alone")
    alike: float = _of(1e-6, "share of its squares", "a start of which the tuning leaves less is re-tuning")
    most_rivals: int = _of(3, "candidates", "rivals of an effect that are fitted in its place")
    same_gain: float = _of(0.5, "share of its gain", "a rival of which another effect leaves less explains the same")
    rivals_within: float = _of(0.25, "share of the best gain", "gain from which a screened candidate is fitted")
    bent_within: float = _of(0.08, "share of the best gain", "the same of effects not in proportion to their size")

    # when an effect is believed
    evidence: float = _of(14.0, "nat", "evidence on runs left out that an effect must bring")
    evidence_in_sample: float = _of(60.0, "nat", "the same where no run can be left out")
    imperfect: float = _of(1.2e-3, "share of noise", "evidence that faults of the twin may imitate", IMITATION)
    imperfect_uncut: float = _of(4e-3, "share of noise", "the same of a block that the signals do not cut out of the loop", IMITATION)
    price: float = _of(2.0, "nat", "cost of each further free parameter")
    looks: int = _of(3, "times", "times that effects and imperfections are fitted together again")
    little_left: float = _of(1.3, "1", "loss over noise up to which imperfections alone are looked at again")
    least_share: float = _of(0.3, "share", "share of what other effects leave that a wrong control must close")
    known_alone: float = _of(0.99, "share", "share of what is known of a parameter that one fold may hold")
    near_noise: float = _of(0.02, "share", "excess over noise that counts as noise")
    quiet: float = _of(0.25, "1", "mean square above noise up to which a quick look leaves an axis alone")
    size_rounds: int = _of(2, "times", "times that doubt is renewed while effects are sized")
    size_steps: int = _of(3, "steps", "steps of each of these fits")
    no_size: float = _of(5.0, "sizes", "half a 95 % interval from which an effect has no size")
    shows_nothing: float = _of(1e-9, "share of the evidence", "less is no change at all")

    smallest_size: float = _of(0.02, "smallest usual size", "a smaller effect is implausible: every machine has a little of most effects")
    smallest_set_size: float = _of(
        0.12, "smallest usual size", "the same for what is set or normal if small: controller laws, factors, springs, clamped masses"
    )
    largest_size: float = _of(4.0, "largest usual size", "a larger effect is implausible")
    usual_shape: float = _of(4.5, "1", "factor outside the usual range from which a speed, wavelength or frequency is implausible")
    imitated: float = _of(5.0, "tolerances", "size up to which an effect is not accepted next to a normal imperfection that imitates it")

    # verdict
    worse_by_chance: float = _of(0.3, "1", "increase of gap over noise by which a correction may be worse than the machine file by chance")
    undecided: float = _of(
        6.0, "1", "held-out gap over noise above which 'none' becomes 'unknown'; a control that interpolates in its own way leaves 3"
    )
    temperature: float = _of(3.0, "nat", "divides evidence before it becomes a probability")
    confidence: float = _of(0.98, "1", "largest probability: an unlisted law cannot be ruled out")
    left_over: float = _of(1.5, "1", "gap over noise of an axis from which something of it is listed as unexplained")
    remaining: float = _of(0.1, "share", "share of the excess over noise that, left, makes the verdict 'unknown'")
    noticed_excess: float = _of(0.12, "1", "mean square above noise from which something is left", IMITATION)
    stands_out: float = _of(1.3, "1", "mean square from which a single channel is not explained")
    systematic: float = _of(5.0, "1", "mean square in most runs from which the law is another one: true laws keep 3.3, next of kin 60")
    local_samples: int = _of(1000, "samples", "samples from which a single channel can stand out")
    local_square: float = _of(1.6, "1", "mean square of a single channel that stands out")
    local_law_square: float = _of(4.0, "1", "the same of a control law")
    beyond_chance: float = _of(4.0, "1", "standard deviations from which a run asks for another size")
    one_size: float = _of(0.12, "share", "share of its size by which an effect may differ between runs")
    ambiguous: float = _of(10.0, "nat", "evidence by which a rival may lie behind and still be named")
    model_error: float = _of(0.007, "share", "standard deviation of a size that no number of samples takes away")

    # where
    noticed_square: float = _of(1.6, "1", "mean square of a block's residual from which it is a place of the gap")
    next_to_none: float = _of(0.01, "share", "share of the largest axis' squared gap that is next to none")
    place_share: float = _of(0.02, "share", "a block with a smaller share of the gap that is seen is no place of it")
    echo: float = _of(0.05, "share", "share that a block without an effect keeps beside one with an effect")
    most_of_runs: float = _of(0.8, "share", "share of a place's excess that the named runs hold")
    regime_share: float = _of(0.6, "share", "share of the excess that makes a regime the place")
    regime_dense: float = _of(3.0, "1", "times the others' excess a sample that makes it too")
    regime_dense_share: float = _of(0.4, "share", "least share of the excess of such a regime")
    scales_share: float = _of(0.1, "share", "share of a residual that what it scales with must explain")
    stretch_s: float = _of(0.5, "s", "length of the most telling stretch")
    reversal_s: float = _of(0.06, "s", "time after a change of direction that counts as reversal")
    smooth_s: float = _of(0.025, "s", "window over which a recorded motion is smoothed")
    drift_s: float = _of(0.2, "s", "window of the drift that is taken out of a predicted current")
    sliding: float = _of(3e-4, "share of the top speed", "speed from which an axis slides")
    accelerating: float = _of(0.03, "share of the top acceleration", "acceleration from which an axis accelerates")


DEFAULT = Thresholds()
"""The thresholds of `twin diagnose`."""


class Listed(NamedTuple):
    """One threshold as it is printed."""

    name: str
    value: float
    unit: str
    meaning: str
    provenance: str


def listed(thresholds: Thresholds) -> Iterator[Listed]:
    """Every threshold with its value, unit, meaning and provenance."""
    for f in fields(thresholds):
        yield Listed(f.name, getattr(thresholds, f.name), f.metadata["unit"], f.metadata["meaning"], f.metadata["provenance"])
