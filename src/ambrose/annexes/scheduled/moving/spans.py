"""Spans of seal pressure at one speed, and how the seals' forces follow the pressure within
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.judge.checks import Check
from ambrose.judge.criteria import judge
from ambrose.machine.criteria import TWO_PI, Demand
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.seals import Seal
from ambrose.model.assemble import seal_coefficients
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.plant import Plant

FROZEN = 21  # pressures at which the loop with a pressure that stands still is examined
REST = (
    "proved is the energy gain from disturbances of the measurement to the measurement, which is "
    "sigma_max(S_o) at rest"
)
_NODES = 13  # pressures at which a seal's coefficients are read
_STRAIGHT = 1e-3  # largest misfit of a polynomial over the range of its coefficient
_MOST_POWERS = 3  # of pressure in a seal's coefficients

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class PressureSpan:
    """Operating points that differ in pressure alone: all between ``low`` and ``high`` [Pa] at the
    place of ``point``.
    """

    point: OperatingPoint
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half its width [Pa]."""
        return (self.high - self.low) / 2

    @property
    def label(self) -> str:
        where = (
            f"{self.low / 1e5:.4g} to {self.high / 1e5:.4g} bar at {self.point.speed / TWO_PI:.4g} "
            "Hz"
        )
        return f"while the pressure changes, {where}"

    @property
    def middle(self) -> OperatingPoint:
        return replace(self.point, seal_pressure=(self.low + self.high) / 2, label=self.label)


def pressure_spans(machine: Machine) -> tuple[PressureSpan, ...]:
    """One span for every speed (and bias) of the operating points and ranges at which there are
    several pressures.
    """
    groups: dict[tuple[float, float | None, float | None], list[OperatingPoint]] = {}
    for point in machine.operation.envelope:
        groups.setdefault((point.speed, point.bias_current, point.whirl_frequency), []).append(
            point
        )
    spans = []
    for points in groups.values():
        pressures = [point.seal_pressure for point in points]
        if machine.seals and min(pressures) < max(pressures):
            spans.append(PressureSpan(points[0], min(pressures), max(pressures)))
    return tuple(spans)


def seal_force(plant: Plant, seal: Seal, pressure: float) -> np.ndarray:
    """P (2, 4): a seal's force at the pressure [Pa] is P (x, y, x', y') beyond what it is at the
    plant's own point.

    Raises InvalidInput for a seal with states or an added mass that changes.
    """
    change = (
        _coefficients(plant, seal, [pressure])[0]
        - _coefficients(plant, seal, [plant.point.seal_pressure])[0]
    )
    if change[4]:
        raise InvalidInput(
            f"the added mass of seal {seal.name} changes with the pressure; no port of the plant "
            "carries it"
        )
    return _force(change)


def _force(change: np.ndarray) -> np.ndarray:
    K, k, C, c = change[:4]
    # f_x = -(K x + k y + C x' + c y'),   f_y = -(-k x + K y - c x' + C y')
    return -np.array([[K, k, C, c], [-k, K, -c, C]])


def _coefficients(plant: Plant, seal: Seal, pressures: Iterable[float]) -> np.ndarray:
    """K, k, C, c and M at every pressure."""
    if has_states(seal):
        raise InvalidInput(
            f"seal {seal.name} has states of its own, which no proof for a changing pressure "
            "covers yet"
        )
    at_pressures = [
        seal_coefficients(seal, replace(plant.point, seal_pressure=float(p))) for p in pressures
    ]
    return np.array([[c.K, c.k, c.C, c.c, c.M] for c in at_pressures])


class BentSeal(InvalidInput):
    """Coefficients that no polynomial of three powers follows over a span."""


def seal_range(plant: Plant, seal: Seal, span: PressureSpan) -> np.ndarray:
    """By how much K, k, C, c and M change over the span (5,); of two that add up to one force the
    larger change.
    """
    size = np.ptp(_coefficients(plant, seal, _nodes(span)), axis=0)
    size[:2], size[2:4] = size[:2].max(), size[2:4].max()
    return np.asarray(size)


def seal_terms(
    plant: Plant, seal: Seal, span: PressureSpan, size: np.ndarray | None = None
) -> list[np.ndarray]:
    """P_1 .. P_n (2, 4): from the span's middle a seal's force changes by sum_i delta^i P_i (x, y,
    x', y').

    delta is -1 at the span's lowest and 1 at its highest pressure; to 0.1 % of ``size``, the span's
    own range where not given. Raises InvalidInput (BentSeal) where three powers do not suffice, for
    a seal with states or an added mass that changes.
    """
    size = seal_range(plant, seal, span) if size is None else size
    if size[4] > 0:
        raise InvalidInput(
            f"the added mass of seal {seal.name} changes with the pressure; no port of the plant "
            "carries it"
        )

    # change from the middle, at Chebyshev's nodes; delta = -1 .. 1
    nodes = _nodes(span)
    values = (nodes - span.low) / span.half - 1
    change = _coefficients(plant, seal, nodes) - _coefficients(
        plant, seal, [(span.low + span.high) / 2]
    )

    # sum_i delta^i term_i without a constant: the middle is met exactly
    for degree in range(1, _MOST_POWERS + 1):
        powers = values[:, None] ** np.arange(1, degree + 1)
        terms = np.linalg.lstsq(powers, change, rcond=None)[0]
        off = np.abs(powers @ terms - change).max(axis=0) / np.where(size > 0, size, 1.0)
        if off.max() < _STRAIGHT:
            return [_force(term) for term in terms]
    remedy = "give operating points at pressures closer together, or the seal a smoother table"
    raise BentSeal(
        f"seal {seal.name} is {off.max():.1%} off a polynomial of the pressure of degree "
        f"{_MOST_POWERS}; {remedy}"
    )


def _nodes(span: PressureSpan) -> np.ndarray:
    return (span.low + span.high) / 2 + span.half * np.cos(
        np.pi * (np.arange(_NODES) + 0.5) / _NODES
    )


def judged_rate(wanted: Demand, rate: float, value: float, detail: str) -> Check:
    """The row of what was proved for a rate [Pa/s]; failed where nothing was."""
    title = (
        f"Output sensitivity proved for any motion of the pressure at up to {rate / 1e5:.4g} bar/s"
    )
    check = judge("moving.sensitivity.rate", title, value, "-", wanted, detail)
    # also where nothing is required
    return check if np.isfinite(value) else replace(check, passed=False)
