"""Sensitivities, complementary and control sensitivity, compliance: per axis and as maximum
singular value.

| check | what | unit |
|---|---|---|
| sensitivity.output.<axis> | peak of a diagonal element of S_o (ISO 14839-3, others closed) | - |
| sensitivity.output.max | peak of its maximum singular value | - |
| sensitivity.input.<axis> | peak of the diagonal element of S_i | - |
| sensitivity.input.max | peak of its maximum singular value | - |
| complementary.<axis>, .max | the same of T_o = I - S_o | - |
| control.<axis>, .max | the same of K S_o | A/m |
| control.roll_off | peak of K S_o times sqrt(1 + (w/w_r)^2), for a roll_off w_r | A/m |
| compliance.<axis>, .max | the same of force to displacement at the bearings | m/N |

Each has a curve of the name before the last dot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ambrose.core.frequency import largest_gain
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import judge, required_line, zone_lines
from ambrose.judge.loop_response import Evaluator, LoopResponse
from ambrose.judge.peaks import Peak, peaks_of
from ambrose.machine.criteria import SENSITIVITY, TWO_PI, demand
from ambrose.machine.description import Requirements

ALL_AXES = "maximum singular value"  # label of the line of a curve that no zone judges


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A matrix of the loop that is judged per axis and by its maximum singular value."""

    name: str
    title: str
    unit: str
    matrix: Callable[[LoopResponse], np.ndarray]
    axis_rule: str = "information"
    max_rule: str = "information"

    def rows(self, response: LoopResponse) -> np.ndarray:
        """Maximum singular value first, then the moduli of the diagonal, (1 + a, w)."""
        values = self.matrix(response)
        largest = largest_gain(values)
        return np.vstack([largest[None, :], np.abs(np.einsum("wii->iw", values))])


_QUANTITIES = (
    _Quantity(
        "sensitivity.output",
        "output sensitivity",
        "-",
        LoopResponse.output_sensitivity,
        "sensitivity of an axis",
        "maximum singular value of a sensitivity",
    ),
    _Quantity(
        "sensitivity.input",
        "input sensitivity",
        "-",
        LoopResponse.input_sensitivity,
        "input sensitivity of an axis",
    ),
    _Quantity("complementary", "complementary sensitivity", "-", LoopResponse.complementary),
    _Quantity(
        "control",
        "control sensitivity K S",
        "A/m",
        LoopResponse.control_sensitivity,
        "information",
        "control gain",
    ),
    _Quantity(
        "compliance", "compliance", "m/N", LoopResponse.compliance, "information", "compliance"
    ),
)


def sensitivity_checks(
    response: LoopResponse,
    evaluator: Evaluator,
    requirements: Requirements,
    within: tuple[float, float],
) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table; peaks are refined inside ``within`` [rad/s].

    Where a curve rises higher on the grid beyond that range, the check's detail says so.
    """
    peaks = peaks_of([quantity.rows for quantity in _QUANTITIES], response, evaluator, within)
    labels = ("max", *response.axes)
    checks, curves = [], []
    for quantity, row in zip(_QUANTITIES, peaks, strict=True):
        values = quantity.rows(response)
        for label, peak, curve in zip(labels, row, values, strict=True):
            rule = quantity.max_rule if label == "max" else quantity.axis_rule
            what = ALL_AXES if label == "max" else label
            detail = _where(peak) + _beyond(response.omega, curve, within[1], peak)
            wanted = demand(rule, requirements)
            checks.append(
                judge(
                    f"{quantity.name}.{label}",
                    f"Peak {quantity.title}, {what}",
                    peak.value,
                    quantity.unit,
                    wanted,
                    detail,
                )
            )
        curves.append(_curve(quantity, response, values, labels, requirements))
    if requirements.roll_off is not None:
        checks.append(_roll_off(response, evaluator, requirements, requirements.roll_off))
    return checks, curves


def sensitivity_curve(response: LoopResponse, requirements: Requirements) -> Curve:
    """The output sensitivity of every axis alone, with its limits."""
    rows = np.abs(np.einsum("wii->iw", response.output_sensitivity()))
    return _curve(_QUANTITIES[0], response, rows, response.axes, requirements)


def _roll_off(
    response: LoopResponse, evaluator: Evaluator, requirements: Requirements, corner: float
) -> Check:
    """Over the whole grid of the response: what lies beyond the range of ISO 14839-3 counts
    here.
    """

    def rows(at: LoopResponse) -> np.ndarray:
        size = largest_gain(at.control_sensitivity())
        return np.asarray(size * np.hypot(1, at.omega / corner))[None, :]

    ((peak,),) = peaks_of([rows], response, evaluator)
    title = (
        f"Control sensitivity with a roll-off from {corner / TWO_PI:.4g} Hz, maximum singular value"
    )
    return judge(
        "control.roll_off",
        title,
        peak.value,
        "A/m",
        demand("control gain", requirements),
        _where(peak),
    )


def _where(peak: Peak) -> str:
    edge = " (the end of the range: it may rise beyond)" if peak.at_edge else ""
    return f"at {peak.frequency / TWO_PI:.4g} Hz{edge}"


def _beyond(omega: np.ndarray, curve: np.ndarray, highest: float, peak: Peak) -> str:
    outside = omega > highest
    if not outside.any() or curve[outside].max() <= peak.value:
        return ""
    i = np.flatnonzero(outside)[np.argmax(curve[outside])]
    return (
        f"; beyond the range of {highest / TWO_PI:.4g} Hz it reaches {curve[i]:.4g} at "
        f"{omega[i] / TWO_PI:.4g} Hz"
    )


def _curve(
    quantity: _Quantity,
    response: LoopResponse,
    values: np.ndarray,
    labels: tuple[str, ...],
    requirements: Requirements,
) -> Curve:
    wanted = demand(quantity.max_rule, requirements).limit
    limits = required_line(wanted)
    if quantity.name.startswith("sensitivity"):
        limits = zone_lines(SENSITIVITY, wanted, "an axis" if "max" in labels else "")
    title = quantity.title[0].upper() + quantity.title[1:]
    labels = tuple(ALL_AXES if label == "max" else label for label in labels)
    return Curve(
        quantity.name,
        title,
        "frequency",
        response.omega,
        values,
        labels,
        "rad/s",
        quantity.unit,
        limits,
    )
