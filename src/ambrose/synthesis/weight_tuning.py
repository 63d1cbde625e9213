"""The weight of the current tuned so that a synthesised controller works as hard as a reference
controller does.

Controllers are only comparable at similar gain: paper P5 chooses W_u for each synthesis "to obtain
similar gains of the direct terms" as the PID in the middle of the frequency range (Lauridsen 2017,
P5, sec. 4.3, fig. 10).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_positive,
    invalid,
    named_failure,
)
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import ControllerLike, as_statespace
from ambrose.judge.result import Synthesis
from ambrose.law.design_problem import Weights, design_plant, scale_control
from ambrose.model.plant import Plant

BAND = (0.0, 2 * np.pi * 200.0)  # [rad/s]
_POINTS = 60  # frequencies of the grid, evenly by logarithm
# the grid starts this factor below the band's end: both controllers integrate, at their own rates
_SPAN = 200.0
_LARGEST_STEP = np.log(30.0)


@dataclass(frozen=True, slots=True, eq=False)
class Tuning:
    """The tuned weights and the controller they gave.

    mismatch: mean over axes and frequencies of ln(|K_ii| / |R_ii|), 0 when the direct gains agree
    on average; factor [-]: what W_u was multiplied by; converged: whether |mismatch| is within the
    tolerance; history: factor and mismatch of each.
    """

    weights: Weights
    synthesis: Synthesis
    factor: float
    mismatch: float
    converged: bool
    history: tuple[Mapping[str, float], ...]


def direct_gain_mismatch(
    controller: ControllerLike, reference: ControllerLike, band: tuple[float, float] = BAND
) -> tuple[float, float]:
    """Mean and root mean square of ln(|K_ii| / |R_ii|) over the axes and the band [rad/s], on a
    logarithmic grid.

    The grid starts at the band's lower end, but not below 1/200 of the upper one. Raises
    InvalidInput for controllers of different sizes, a reference without direct gain, or an empty
    band.
    """
    controller, reference = as_statespace(controller), as_statespace(reference)
    if controller.D.shape != reference.D.shape or controller.D.shape[0] != controller.D.shape[1]:
        raise invalid(
            "the controller's size",
            controller.D.shape,
            f"square, like the reference's {reference.D.shape}",
            "match",
        )
    low, high = band
    if not 0 <= low < high < np.inf:
        raise invalid(
            "band", band, "ascending, not negative and finite, in rad/s", "0 to 200 Hz is usual"
        )
    omega = np.geomspace(max(low, high / _SPAN), high, _POINTS)
    gains = [
        np.abs(np.diagonal(frequency_response(item, omega).values, axis1=1, axis2=2))
        for item in (controller, reference)
    ]
    if not (gains[1] > 0).all():
        raise InvalidInput(
            "the reference controller has an axis without direct gain; compare with a "
            "decentralised controller"
        )
    ratio = np.log(np.maximum(gains[0], 1e-300) / gains[1])
    return float(ratio.mean()), float(np.sqrt((ratio**2).mean()))


@named_failure("the control weight")
def tune_control_weight(
    plant: Plant | GeneralizedPlant,
    weights: Weights,
    reference_controller: Any,
    synthesize: Callable[[GeneralizedPlant], Synthesis],
    *,
    uncertain: bool = True,
    tolerance: float = 0.02,
    max_syntheses: int = 12,
) -> Tuning:
    """W_u multiplied by the factor at which the synthesised controller's direct gains match the
    reference's in the band.

    plant, weights, uncertain: as for ``design_plant``. reference_controller: err_<axis> ->
    u_<axis>, usually the PID. synthesize: design problem -> Synthesis (H-infinity, mu). tolerance
    [-]: of the mean ln ratio, 0.02 is 2 % of gain. A bracketing secant search in ln(factor); where
    the gains cannot be matched the nearest is returned with converged False. Raises what
    ``synthesize`` raises for the weights it is first given.
    """
    check_positive(tolerance, "tolerance", "0.02 is 2 % of gain")
    trials: dict[float, tuple[Synthesis, float]] = {}

    def mismatch(x: float) -> float:
        made = synthesize(
            design_plant(plant, scale_control(weights, float(np.exp(x))), uncertain=uncertain)
        )
        trials[x] = made, direct_gain_mismatch(made.controller, reference_controller)[0]
        return trials[x][1]

    _search(mismatch, tolerance, max_syntheses)
    x = min(trials, key=lambda key: abs(trials[key][1]))
    made, mean = trials[x]
    history = tuple(
        {"factor": float(np.exp(key)), "mismatch": value} for key, (_, value) in trials.items()
    )
    factor = float(np.exp(x))
    return Tuning(
        scale_control(weights, factor), made, factor, mean, abs(mean) <= tolerance, history
    )


def _search(function: Callable[[float], float], tolerance: float, most: int) -> None:
    """Look for a root of a falling function from x = 0, whose slope is first taken as -1: secant
    steps until the root is bracketed, then false position with halving (Illinois). A trial that
    fails numerically is retried half as far.
    """
    x, f = 0.0, function(0.0)
    ends: dict[bool, tuple[float, float]] = {}  # the newest point on either side, by f > 0
    previous: tuple[float, float] | None = None
    for _ in range(most - 1):
        if abs(f) <= tolerance:
            return
        side = f > 0
        if previous is not None and (previous[1] > 0) == side and (not side) in ends:
            x_other, f_other = ends[not side]
            ends[not side] = (x_other, f_other / 2)
        ends[side] = (x, f)
        if len(ends) == 2:
            (a, fa), (b, fb) = ends[True], ends[False]
            trial = a + (b - a) * fa / (fa - fb)
        else:
            slope = -1.0 if previous is None else min((f - previous[1]) / (x - previous[0]), -0.1)
            trial = x + float(np.clip(-1.2 * f / slope, -_LARGEST_STEP, _LARGEST_STEP))
        previous = (x, f)
        try:
            x, f = trial, function(trial)
        except NumericalFailure:
            x = 0.5 * (x + trial)
            f = function(x)
