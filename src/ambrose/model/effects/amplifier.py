"""Current amplifier and coil: commanded current u to control current i, unit gain at DC; linear,
and with its limits.

The nonlinear view has two states per axis, s_1 and s_2 [A], whatever the order: "none" uses
neither, "first" s_1, "twice-first" s_1 (coil current) and s_2 (flux, after the eddy currents' lag),
"second" s_1 (current) and s_2 (its slope over w).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import Amplifier

AMPLIFIER_ORDERS = ("none", "first", "twice-first", "second")


def linearised(amplifier: Amplifier, axes: Sequence[str]) -> StateSpace:
    """The same amplifier on every axis: inputs ``u_<axis>`` [A], outputs ``i_<axis>`` [A].

    Every state is a current [A], so that A and B have entries of the size of the bandwidths.
    "second" is i/u = w^2/(s^2 + d s + w^2) with w the natural frequency and d the damping, both
    [rad/s]. Raises InvalidInput for an unknown order, and for a figure that the order needs and is
    missing or not positive.
    """
    A, B, C, D = _one_axis(amplifier)
    eye = np.eye(len(axes))
    inputs, outputs = [f"u_{axis}" for axis in axes], [f"i_{axis}" for axis in axes]
    return StateSpace(
        np.kron(eye, A), np.kron(eye, B), np.kron(eye, C), np.kron(eye, D), inputs, outputs
    )


def parameters(amplifier: Amplifier, max_current: float | None = None) -> tuple[float, ...]:
    """What ``derivative``, ``coil_current`` and ``effective_current`` need of an axis.

    (order as its index in AMPLIFIER_ORDERS, w [rad/s], e or d [rad/s], largest slope of the current
    [A/s], max_current [A]); what has no limit is infinite. max_current [A]: largest control
    current, either sign. Raises InvalidInput as ``linearised`` does, and for a voltage limit
    without inductance or without dynamics.
    """
    order = amplifier.order
    _one_axis(amplifier)  # complains about what is missing
    w = {"none": 0.0, "second": amplifier.natural_frequency}.get(order, amplifier.bandwidth)
    second = {"twice-first": amplifier.eddy_bandwidth, "second": amplifier.damping}.get(order, 0.0)
    slope = np.inf
    if amplifier.max_voltage is not None:
        if order == "none":
            raise invalid(
                "the amplifier's max_voltage",
                "given",
                "left out for order 'none'",
                "an ideal amplifier has no slope",
            )
        slope = amplifier.max_voltage / _figure(amplifier, "inductance")
    limit = (
        np.inf
        if max_current is None
        else check_positive(max_current, "max_current [A]", "leave it out where there is none")
    )
    return (
        float(AMPLIFIER_ORDERS.index(order)),
        float(w or 0.0),
        float(second or 0.0),
        float(slope),
        float(limit),
    )


def derivative(u: float, s_1: float, s_2: float, p: tuple[float, ...]) -> tuple[float, float]:
    """Derivatives of both states [A/s] at a commanded current u [A]; p from ``parameters``.

    The command is cut at the largest current, the slope of the coil current at U/L; at either stop
    the states of "second" stay instead of winding up. Compiles with numba as it stands.
    """
    order = p[0]
    w = p[1]
    other = p[2]
    slope = p[3]
    limit = p[4]
    u = min(max(u, -limit), limit)
    if order == 1.0:
        return min(max(w * (u - s_1), -slope), slope), 0.0
    if order == 2.0:
        return min(max(w * (u - s_1), -slope), slope), other * (s_1 - s_2)
    if order == 3.0:
        # s_1' = w s_2, s_2' = w (u - s_1) - d s_2
        d_1 = min(max(w * s_2, -slope), slope)
        d_2 = w * (u - s_1) - other * s_2
        # at the slope's stop s_2 goes no further; at the current's s_1 stands and s_2 may only turn
        # back
        if (w * s_2 >= slope and d_2 > 0.0) or (w * s_2 <= -slope and d_2 < 0.0):
            d_2 = 0.0
        if (s_1 >= limit and d_1 > 0.0) or (s_1 <= -limit and d_1 < 0.0):
            d_1 = 0.0
            d_2 = min(d_2, 0.0) if s_1 > 0.0 else max(d_2, 0.0)
        return d_1, d_2
    return 0.0, 0.0


def stops(p: tuple[float, ...]) -> tuple[float, float]:
    """The largest |s_1| and |s_2| [A] that ``derivative`` leaves where they are; infinite but for
    "second". For numba, too.
    """
    return (p[4], p[3] / p[1]) if p[0] == 3.0 else (math.inf, math.inf)


def coil_current(u: float, s_1: float, s_2: float, p: tuple[float, ...]) -> float:
    """The control current in the coil [A], which an ammeter shows. Compiles with numba as it
    stands.
    """
    return min(max(u, -p[4]), p[4]) if p[0] == 0.0 else s_1


def effective_current(u: float, s_1: float, s_2: float, p: tuple[float, ...]) -> float:
    """The control current that makes force [A]: the coil's, after the eddy currents' lag. Compiles
    with numba as it stands.
    """
    if p[0] == 0.0:
        return min(max(u, -p[4]), p[4])
    return s_2 if p[0] == 2.0 else s_1


def _one_axis(amplifier: Amplifier) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    order = amplifier.order
    if order == "none":
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    if order == "first":
        w = _figure(amplifier, "bandwidth")
        return np.array([[-w]]), np.array([[w]]), np.ones((1, 1)), np.zeros((1, 1))
    if order == "twice-first":
        w, e = _figure(amplifier, "bandwidth"), _figure(amplifier, "eddy_bandwidth")
        A, B = np.array([[-w, 0.0], [e, -e]]), np.array([[w], [0.0]])
        return A, B, np.array([[0.0, 1.0]]), np.zeros((1, 1))
    if order == "second":
        w, d = _figure(amplifier, "natural_frequency"), _figure(amplifier, "damping")
        A, B = np.array([[0.0, w], [-w, -d]]), np.array([[0.0], [w]])
        return A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1))
    raise invalid(
        "the amplifier's order",
        repr(order),
        f"one of {', '.join(AMPLIFIER_ORDERS)}",
        "correct amplifier.order",
    )


def _figure(amplifier: Amplifier, name: str) -> float:
    value = getattr(amplifier, name)
    if value is None:
        raise invalid(
            f"the amplifier's {name}",
            "missing",
            f"given for order {amplifier.order!r}",
            f"add {name} [rad/s]",
        )
    return check_positive(
        value, f"the amplifier's {name} [rad/s]", "give it in rad/s, or choose another order"
    )
