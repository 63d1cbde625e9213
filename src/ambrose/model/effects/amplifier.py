"""Current amplifier and coil: commanded current u to control current i, unit gain at DC; linear,
and with its limits.

The nonlinear view has two states per axis, s_1 and s_2 [A], whatever the order: "none" uses
neither, "first" s_1, "twice-first" s_1 (coil current) and s_2 (flux, after the eddy currents' lag),
"second" s_1 (current) and s_2 (its slope over w), "current-loop" s_1 (current) and s_2 (the
integral part of the voltage over R).

"current-loop" is the circuit. A coil of an opposing pair carries i_0 +- i, and what its current
loop adds to the voltage R i_0 of the bias is, per coil,

    v = R i + L i' + k_u x',    k_u = k_i/2.

L i' + k_u x' is the change of the flux linkage l(i, x); by reciprocity (dl/dx = df/di, both are
derivatives of one co-energy) a coil that makes half of the pair's k_i has k_u = k_i/2. The
controller P + I/s with P = w L and I = w R cancels the coil's pole: i = w/(s + w) u at standstill,

    v = w L (u - i) + R s_2,    s_2' = w (u - i),    |v| <= V - R i_0.

Its magnet still has f = k_i i + k_s x; the current that motion drives takes of k_s what the loop
does not hold. Without integral part, k_s(s) = k_s (R + P)/(L s + R + P) where L = k_i^2/(2 k_s),
the coil without leakage (INDUSTRIAL notes R5.1; Maslen, Knospe & Zhu 2006 for its meaning).
Held at the centred position: L and k_u do not move with the rotor.
"""

import math
from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import Amplifier

AMPLIFIER_ORDERS = ("none", "first", "twice-first", "second", "current-loop")
LOOP = "current-loop"
_UNITS = {"resistance": "ohm", "inductance": "H"}


def linearised(
    amplifier: Amplifier, axes: Sequence[str], force_per_current: Sequence[float] | np.ndarray = ()
) -> StateSpace:
    """The same amplifier on every axis: inputs ``u_<axis>`` [A], outputs ``i_<axis>`` [A].

    force_per_current (a,) [N/A]: k_i of every axis, whose half is the back-EMF of a
    "current-loop"; it then has inputs ``qdot_<axis>`` [m/s] as well, after the commands. Without
    it the loop is that of a rotor at standstill.

    Every state is a current [A], so that A and B have entries of the size of the bandwidths.
    "second" is i/u = w^2/(s^2 + d s + w^2) with w the natural frequency and d the damping, both
    [rad/s]. Raises InvalidInput for an unknown order, and for a figure that the order needs and is
    missing or not positive.
    """
    A, B, C, D = _one_axis(amplifier)
    eye = np.eye(len(axes))
    inputs, outputs = [f"u_{axis}" for axis in axes], [f"i_{axis}" for axis in axes]
    by_command, direct = np.kron(eye, B), np.kron(eye, D)
    if amplifier.order == LOOP and len(force_per_current):
        # i' = ... - (k_i/2)/L x'
        moving = np.kron(np.diag(back_emf(amplifier, force_per_current)), [[-1.0], [0.0]])
        by_command, direct = np.hstack([by_command, moving]), np.hstack([direct, 0.0 * direct])
        inputs = inputs + [f"qdot_{axis}" for axis in axes]
    return StateSpace(np.kron(eye, A), by_command, np.kron(eye, C), direct, inputs, outputs)


def back_emf(amplifier: Amplifier, force_per_current: Sequence[float] | np.ndarray) -> np.ndarray:
    """k_u/L (a,) [A/m], by which motion changes the current of a "current-loop"; zero of others.

    force_per_current (a,) [N/A]. Raises InvalidInput without inductance.
    """
    k_i = np.asarray(force_per_current, dtype=float)
    return k_i / (2 * _figure(amplifier, "inductance")) if amplifier.order == LOOP else 0 * k_i


def decay(amplifier: Amplifier) -> float:
    """R/L [rad/s] of a "current-loop". Raises InvalidInput where a figure is missing."""
    return _figure(amplifier, "resistance") / _figure(amplifier, "inductance")


def parameters(
    amplifier: Amplifier,
    max_current: float | None = None,
    bias_current: float = 0.0,
    force_per_current: float = 0.0,
) -> tuple[float, ...]:
    """What ``derivative``, ``coil_current`` and ``effective_current`` need of an axis.

    (order as its index in AMPLIFIER_ORDERS, w [rad/s], e or d or R/L [rad/s], largest slope of the
    current [A/s], max_current [A], k_u/L [A/m]); what has no limit is infinite. max_current [A]:
    largest control current, either sign. bias_current [A] and force_per_current k_i [N/A] are a
    "current-loop"'s: R i_0 comes off its voltage, and k_u = k_i/2. Raises InvalidInput as
    ``linearised`` does, and for a voltage limit without inductance or without dynamics.
    """
    order = amplifier.order
    _one_axis(amplifier)  # complains about what is missing
    w = {"none": 0.0, "second": amplifier.natural_frequency}.get(order, amplifier.bandwidth)
    second = {"twice-first": amplifier.eddy_bandwidth, "second": amplifier.damping}.get(order, 0.0)
    voltage = amplifier.max_voltage
    if order == LOOP:
        resistance = _figure(amplifier, "resistance")
        second = decay(amplifier)
        voltage = None if voltage is None else _left(voltage, resistance * bias_current)
    slope = np.inf
    if amplifier.max_voltage is not None:
        if order == "none":
            raise invalid(
                "the amplifier's max_voltage",
                "given",
                "left out for order 'none'",
                "an ideal amplifier has no slope",
            )
        assert voltage is not None
        slope = voltage / _figure(amplifier, "inductance")
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
        float(back_emf(amplifier, [force_per_current])[0]),
    )


def _left(voltage: float, bias: float) -> float:
    if voltage <= bias:
        raise invalid(
            "the amplifier's max_voltage",
            f"{voltage:g} V",
            f"above the {bias:g} V that the bias current takes in the coil's resistance",
            "give a higher voltage, or a smaller resistance",
        )
    return voltage - bias


def derivative(
    u: float, s_1: float, s_2: float, p: tuple[float, ...], velocity: float = 0.0
) -> tuple[float, float]:
    """Derivatives of both states [A/s] at a commanded current u [A]; p from ``parameters``.

    The command is cut at the largest current, the slope of the coil current at U/L; at either stop
    the states of "second" stay instead of winding up. velocity [m/s] of the rotor along the axis:
    of "current-loop" alone, whose voltage is cut and whose integrator then stands still. Compiles
    with numba as it stands.
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
    if order == 4.0:
        # v/L = w (u - i) + R/L s_2, cut; i' = v/L - R/L i - k_u/L x'
        error = w * (u - s_1)
        wanted = error + other * s_2
        given = min(max(wanted, -slope), slope)
        pushing = (wanted > slope and error > 0.0) or (wanted < -slope and error < 0.0)
        return given - other * s_1 - p[5] * velocity, 0.0 if pushing else error
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
    if order == LOOP:
        w = _figure(amplifier, "bandwidth")
        ratio = decay(amplifier)
        A = np.array([[-w - ratio, ratio], [-w, 0.0]])
        return A, np.array([[w], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
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
            f"add {name} [{_UNITS.get(name, 'rad/s')}]",
        )
    unit = _UNITS.get(name, "rad/s")
    return check_positive(
        value, f"the amplifier's {name} [{unit}]", f"give it in {unit}, or choose another order"
    )
