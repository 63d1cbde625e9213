"""Current amplifier and coil, linear view: commanded current u to control current i, unit gain at DC."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import Amplifier

AMPLIFIER_ORDERS = ("none", "first", "twice-first", "second")


def linearised(amplifier: Amplifier, axes: Sequence[str]) -> StateSpace:
    """The same amplifier on every axis: inputs ``u_<axis>`` [A], outputs ``i_<axis>`` [A].

    Every state is a current [A], so that A and B have entries of the size of the bandwidths. "second" is
    i/u = w^2/(s^2 + d s + w^2) with w the natural frequency and d the damping, both [rad/s]. Raises InvalidInput for an
    unknown order, and for a figure that the order needs and is missing or not positive.
    """
    A, B, C, D = _one_axis(amplifier)
    eye = np.eye(len(axes))
    inputs, outputs = [f"u_{axis}" for axis in axes], [f"i_{axis}" for axis in axes]
    return StateSpace(np.kron(eye, A), np.kron(eye, B), np.kron(eye, C), np.kron(eye, D), inputs, outputs)


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
    raise invalid("the amplifier's order", repr(order), f"one of {', '.join(AMPLIFIER_ORDERS)}", "correct amplifier.order")


def _figure(amplifier: Amplifier, name: str) -> float:
    value = getattr(amplifier, name)
    if value is None:
        raise invalid(f"the amplifier's {name}", "missing", f"given for order {amplifier.order!r}", f"add {name} [rad/s]")
    return check_positive(value, f"the amplifier's {name} [rad/s]", "give it in rad/s, or choose another order")
