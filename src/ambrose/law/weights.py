"""Weights from requirements in words: how large the error may be, how fast it must vanish, how hard
the controller may work.

A weight is the inverse of what is allowed: |S_o| <= 1/|W_p| and |K S_o| <= (D_u/D_e)/|W_u|, in
units of the largest error D_e and the largest control current D_u (Lauridsen 2017, paper P5, eq.
(7), paper P3, eq. (11); Skogestad & Postlethwaite 2005, sec. 2.8.2). ``problem.py`` puts them
around a plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import (
    StateSpace,
    as_statespace,
    is_stable,
    series,
    static_gain,
    transfer_function,
)
from ambrose.machine.axial import in_file
from ambrose.machine.description import DesignWeights
from ambrose.machine.machine import Machine

_SYSTEMS = ("performance", "control")
_SIZES = (
    "error_scale",
    "current_scale",
    "current_disturbance",
    "output_disturbance",
    "control_factor",
)
_LIMIT = 30.0  # default of |W_u| far above its crossover


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Weights(Presented):
    """The weights of one design; every axis has the same ones.

    performance W_p and control W_u: stable systems with one input and one output [-]. error_scale
    D_e [m]: the largest error that is acceptable; current_scale D_u [A]: the largest control
    current. current_disturbance and output_disturbance [-]: sizes of the disturbances w1 (current,
    added before the amplifier) and w2 (measured displacement) in units of D_u and D_e.
    control_factor [-]: what W_u has been multiplied by since it was stated (``scale_control``).
    Raises InvalidInput.
    """

    performance: StateSpace
    control: StateSpace
    error_scale: float
    current_scale: float
    current_disturbance: float = 1.0
    output_disturbance: float = 1.0
    control_factor: float = 1.0

    def __post_init__(self) -> None:
        for name in _SYSTEMS:
            object.__setattr__(self, name, _checked(getattr(self, name), f"the {name} weight"))
        for name in _SIZES:
            check_positive(
                getattr(self, name),
                name,
                "a disturbance or scale of size zero makes the problem singular",
            )

    def facts(self) -> Mapping[str, Any]:
        return {name: float(getattr(self, name)) for name in _SIZES}

    def to_dict(self) -> dict[str, Any]:
        """Matrices and sizes as JSON-ready data."""
        systems = {
            name: {x: getattr(getattr(self, name), x).tolist() for x in "ABCD"} for name in _SYSTEMS
        }
        return {**systems, **{name: float(getattr(self, name)) for name in _SIZES}}


def _checked(weight: Any, name: str) -> StateSpace:
    weight = as_statespace(weight)
    if weight.D.shape != (1, 1) or weight.dt is not None:
        raise invalid(
            name,
            repr(weight),
            "continuous with one input and one output",
            "all axes have the same weight",
        )
    if not is_stable(weight):
        raise invalid(
            name,
            "unstable or integrating",
            "stable",
            "move the pole off zero: low_frequency_error > 0",
        )
    return weight


def performance_weight(
    peak: float, bandwidth: float, low_frequency_error: float = 1e-3
) -> StateSpace:
    """W_p = (s/M + w_B)/(s + w_B A_w): 1/A_w at zero frequency, 1 near w_B, 1/M far above.

    peak M [-] > 1: the largest sensitivity; bandwidth w_B [rad/s]: disturbances below it are
    reduced; low_frequency_error A_w [-], 0 < A_w < 1: what is left of a constant disturbance (P5,
    eq. (7); P3, eq. (11)). Above A_w w_B the weight is a PI controller with the integral time 1/(M
    w_B) [s]. Raises InvalidInput.
    """
    peak = check_positive(peak, "peak", "3 is the border of zone A of ISO 14839-3")
    bandwidth = check_positive(
        bandwidth, "bandwidth", "give it in rad/s; 1/(peak T_i) for an integral time T_i [s]"
    )
    error = check_positive(
        low_frequency_error, "low_frequency_error", "1e-3 stands for integral action"
    )
    if peak <= 1:
        raise invalid(
            "peak",
            f"{peak:g}",
            "above 1",
            "no loop around a strictly proper plant stays below (Bode's integral)",
        )
    if error >= 1:
        raise invalid(
            "low_frequency_error", f"{error:g}", "below 1", "1e-3 stands for integral action"
        )
    return transfer_function([1 / peak, bandwidth], [1.0, bandwidth * error], "err", "z1")


def control_weight(
    level: float, crossover: float | None = None, order: int = 1, limit: float | None = None
) -> StateSpace:
    """W_u: the constant ``level`` [-], or a high-pass filter that makes the controller roll off.

    With a ``crossover`` [rad/s]: W_u = level ((s/w_z + 1)/(s/w_p + 1))^order goes from ``level`` <
    1 at low frequencies through |W_u| = 1 at the crossover to ``limit`` > 1 far above (default:
    30). A bending mode above the crossover is left alone when the weight is large enough there.
    Raises InvalidInput.
    """
    level = check_positive(level, "level", "0.3 lets the current reach 3 D_u for an error of D_e")
    if crossover is None:
        if limit is not None:
            raise invalid(
                "limit",
                limit,
                "left out without a crossover",
                "a constant weight has no other level",
            )
        return static_gain([[level]], ["u"], ["z2"])
    crossover = check_positive(crossover, "crossover", "give it in rad/s")
    limit = (
        _LIMIT
        if limit is None
        else check_positive(limit, "limit", "30 puts its pole far above the crossover")
    )
    if not isinstance(order, int | np.integer) or not 1 <= order <= 8:
        raise invalid(
            "order",
            order,
            "a whole number from 1 to 8",
            "2 suits a bending mode one octave above the crossover",
        )
    if not level < 1 < limit:
        raise invalid(
            "level and limit",
            f"{level:g} and {limit:g}",
            "below and above 1",
            "|W_u| is 1 at the crossover",
        )
    ratio = (limit / level) ** (1 / order)  # w_p / w_z
    a = level ** (2 / order)  # |1 + j w_c/w_z|^2 a = |1 + j w_c/w_p|^2
    # with t = (w_c/w_z)^2:   a (1 + t) = 1 + t/ratio^2
    zero = crossover * np.sqrt((a - ratio**-2) / (1 - a))
    section = transfer_function([1 / zero, 1.0], [1 / (zero * ratio), 1.0], "u", "z2")
    result = static_gain([[level]], ["u"], ["z2"])
    for _ in range(order):
        result = series(result, section)
    return result


def machine_weights(machine: Machine | DesignWeights) -> Weights:
    """The Weights that the machine's [weights] table describes. Raises InvalidInput when it has
    none.
    """
    settings = machine.weights if isinstance(machine, Machine) else machine
    if settings is None:
        if not isinstance(machine, Machine):
            raise InvalidInput("there are no weights; give DesignWeights")
        remedy = in_file(machine, "add a [weights] table to its file")
        raise InvalidInput(f"machine {machine.name!r} has no weights; {remedy}")
    return Weights(
        performance_weight(settings.peak, settings.bandwidth, settings.low_frequency_error),
        control_weight(
            settings.control_level,
            settings.control_crossover,
            settings.control_order,
            settings.control_limit,
        ),
        settings.error_scale,
        settings.current_scale,
        settings.current_disturbance,
        settings.output_disturbance,
    )


def scale_control(weights: Weights, factor: float) -> Weights:
    """The weights with W_u multiplied by ``factor`` [-] at every frequency: above 1 the controller
    becomes more careful.
    """
    W = weights.control
    factor = check_positive(factor, "factor", "above 1 weighs the current more")
    control = StateSpace(W.A, W.B, W.C * factor, W.D * factor, W.inputs, W.outputs)
    return replace(weights, control=control, control_factor=weights.control_factor * factor)
