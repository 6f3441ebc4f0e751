"""All thresholds of the search for effects in one object, each with value, unit, meaning and provenance. Those of unlisted laws are
constants of the modules in `twin.diagnose.law`, those of levels of a gap are in `twin.diagnose.judgement`.

`devtools/sensitivity.py` varies each threshold by a third and prints which of them change a result. Grids of starting values are not
thresholds; they are constants of the module that uses them.
"""

from dataclasses import dataclass, field
from typing import Any

JUDGEMENT = "engineering judgement"
IMITATION = "devtools/measure_imitation.py"
PILOT = "pilot on one axis with 24 effects: about 60 independent samples a signal"


def _of(value: float, unit: str, meaning: str, provenance: str = JUDGEMENT) -> Any:
    """A field of `Thresholds` with default value, unit, meaning and provenance."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "provenance": provenance})


@dataclass
class Thresholds:
    """Thresholds of a diagnosis. Squares are relative to noise, nat is the unit of log likelihood, a share is between 0 and 1."""

    # shares that several judgements use
    most: float = _of(
        0.6, "share", "least part that is most of the whole: regime of a gap, runs that show a drive train, runs that a law improves"
    )
    nearly_all: float = _of(0.8, "share", "the same for nearly all: the runs of a gap, a motion that follows another axis")
    half: float = _of(0.5, "share", "part of a gain that is predicted or needed with which a fit goes on, or a rival explains the same")
    remaining: float = _of(
        0.1,
        "share",
        "share that may stay unexplained, or by which a size may differ between runs; what explains less, or has less of its smallest usual size, is not named",
    )
    near_noise: float = _of(0.02, "share", "counts as none: of an excess, a gap, a gain, or of a usual size")

    # the campaign
    off_set_point: float = _of(0.2, "share of the motion", "smallest position gap of a record of another machine")
    off_lag: float = _of(3.0, "1", "largest position gap over the lag of the loop on any machine")
    enough_samples: int = _of(50, "samples", "smallest number of moving samples of a channel or block")

    # noise of a channel
    noise_correlation: int = _of(150, "samples", "longest correlation of the noise, set by the closed loop")
    break_away_s: float = _of(0.06, "s", "length of a reversal; after a break-away the position depends on where the axis stuck")
    settled_s: float = _of(0.2, "s", "time after break-away until no signal depends on how the axis stuck; slower motion is drift")
    unsettled_weight: float = _of(0.03, "1", "weight of earlier samples in the evidence")
    resting: float = _of(0.3, "share of the normal slip", "standard deviation of the rest position of an axis")
    law_share: float = _of(
        1e-4, "share of the speed", "model error of a control law fitted by hand; that of a real control deviates by 3e-5 of the top speed"
    )

    # a channel without a fault
    clean_square: float = _of(1.15, "1", "mean square over noise of a clean channel or axis; no law is sought in a block with less")
    by_chance: float = _of(
        1.5,
        "1",
        "mean square that noise reaches over a short time, the error of a control law that holds, and a block that is no place of a gap",
    )

    # model error of the twin
    shapes: float = _of(60.0, "1", "independent samples of a model error in one channel, however many samples it has", PILOT)
    doubt: float = _of(
        0.01,
        "share",
        "relative model error of an effect's law; a smaller share of a gain, of information, of a normal imperfection, or of noise is none",
    )
    lag_s: float = _of(0.01, "s", "largest error of the time of a response to an effect")
    event_s: float = _of(0.1, "s", "length of a break-away; the residual within it counts as one error")
    outlier: float = _of(
        5.0, "1", "deviation and roughness over noise that noise does not reach, and standard deviations of its mean square"
    )

    # tolerance and normal imperfections
    prior_weight: float = _of(50.0, "1", "weight of the prior: a parameter at the edge of its tolerance costs 75 nat")
    widest: float = _of(2.0, "tolerances", "largest deviation of a re-tuned parameter")
    nearby: float = _of(0.03, "share", "finite-difference step of a toleranced parameter, and of the frequency of a drive train")
    normal_mode_hz: float = _of(180.0, "Hz", "lowest first mode of a drive train with a normal elasticity")
    normal_slip: float = _of(0.8, "um or arcsec", "largest normal travel before break-away")
    normal_damping: float = _of(2.0, "1", "largest factor between true and assumed damping of a drive train")

    # fits
    fit_steps: int = _of(8, "steps", "largest number of Gauss-Newton steps")
    refit_steps: int = _of(4, "steps", "the same in a quick look, and for a fit that starts at an earlier optimum")
    narrow_slope: float = _of(0.1, "scale units", "finite-difference step once steps of 1 no longer reduce the loss")
    converged: float = _of(0.02, "nat", "largest gain of a fit that has converged")
    spring_step: float = _of(0.25, "share", "largest move of a spring from the size that was simulated; its response is not linear")
    wave_step: float = _of(0.1, "waves", "phase shift at the end of a run for a step of 1")

    # screening
    most_fits: int = _of(2, "times", "largest number of fits of an effect: it may be refused at first and accepted next to others")
    collinear: float = _of(
        1e-6,
        "share of its squares",
        "least part of a response that re-tuning leaves, or of the evidence needed at a usual size; less is nothing",
    )
    most_rivals: int = _of(3, "candidates", "largest number of rivals that are fitted in place of an effect")
    rivals_within: float = _of(0.25, "share of the best gain", "smallest gain in screening of a linear rival that is fitted")

    # acceptance of an effect
    evidence: float = _of(14.0, "nat", "evidence of an effect on held-out runs, of an imperfection on all runs, and between two rivals")
    evidence_in_sample: float = _of(60.0, "nat", "the same if no run can be held out")
    imperfect: float = _of(1.2e-3, "share of noise", "evidence that model errors of the twin may imitate", IMITATION)
    imperfect_uncut: float = _of(4e-3, "share of noise", "the same for a block that the signals do not isolate", IMITATION)
    price: float = _of(2.0, "nat", "cost of each further free parameter")
    small_residual: float = _of(
        1.3, "1", "largest level of an axis, its mean square in a quick look, and loss over that of noise, that is noise alone"
    )
    size_rounds: int = _of(2, "times", "updates of the model error during the final fit")

    largest_size: float = _of(4.5, "1", "largest factor of a plausible size, speed, wavelength or frequency over the usual ones")

    # verdict
    temperature: float = _of(3.0, "nat", "divisor of the evidence when it is converted to a probability")
    confidence: float = _of(0.98, "1", "largest probability: an unlisted law cannot be ruled out")
    confidence_in_one_run: float = _of(0.9, "1", "largest probability of what a single run shows and no other run can confirm")
    beyond_chance: float = _of(4.0, "1", "largest difference of the size in a run by chance")
    model_error: float = _of(0.007, "share", "relative standard deviation of a size due to model error, however many samples there are")

    # where
    echo: float = _of(0.05, "share", "share that a block without an effect keeps next to a block with an effect")
    stretch_s: float = _of(0.5, "s", "length of the interval with the largest excess")
    smooth_s: float = _of(0.025, "s", "window over which a recorded motion is smoothed")
    sliding: float = _of(3e-4, "share of the top speed", "smallest speed of a sliding axis")
    accelerating: float = _of(0.03, "share of the top acceleration", "smallest acceleration of an accelerating axis")


T = Thresholds()
"""The thresholds of every diagnosis."""
