"""The pieces of a classical controller channel: PID, notch, lead, low pass; each a system with one input and one output."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_positive
from ambrose.core.statespace import StateSpace, transfer_function


def pid_term(integral_time: float | None, derivative_time: float | None, derivative_filter: float) -> StateSpace:
    """1 + 1/(T_i s) + T_d s/(eps T_d s + 1), in parallel form (Lauridsen 2017, paper P5, eq. 6).

    integral_time T_i, derivative_time T_d [s]; None leaves the term out. derivative_filter eps [-]. Raises InvalidInput.
    """
    A: list[float] = []
    B, C, D = [], [], 1.0
    if integral_time is not None:
        rate = 1 / check_positive(integral_time, "integral_time", "leave it out for a controller without integral action")
        A.append(0.0)
        B.append(rate)
        C.append(1.0)
    if derivative_time is not None:
        check_positive(derivative_time, "derivative_time", "leave it out for a controller without derivative action")
        check_positive(derivative_filter, "derivative_filter", "0.1 is usual; a pure derivative cannot be realised")
        corner = 1 / (derivative_filter * derivative_time)  # T_d s/(eps T_d s + 1) = (1 - corner/(s + corner))/eps
        A.append(-corner)
        B.append(corner)
        C.append(-1 / derivative_filter)
        D += 1 / derivative_filter
    return StateSpace(np.diag(A), np.reshape(B, (-1, 1)), np.reshape(C, (1, -1)), [[D]])


def notch(frequency: float, pole_damping: float, zero_damping: float) -> StateSpace:
    """(s^2 + 2 z w s + w^2)/(s^2 + 2 p w s + w^2): gain z/p at the frequency w [rad/s], 1 far from it.

    pole_damping p, zero_damping z [-]; z = 0 blocks w completely. Raises InvalidInput.
    """
    w = check_positive(frequency, "a notch's frequency", "give it in rad/s")
    p = check_positive(pole_damping, "a notch's pole_damping", "0.5 is usual")
    z = check_positive(zero_damping, "a notch's zero_damping", "0 is the deepest notch", zero_allowed=True)
    # x1' = w x2, x2' = -w x1 - 2 p w x2 + w u: both states have the size of the input.
    return StateSpace([[0, w], [-w, -2 * p * w]], [[0.0], [w]], [[0, 2 * (z - p)]], [[1]])


def lead(zero: float, pole: float) -> StateSpace:
    """(s/zero + 1)/(s/pole + 1), unit gain at DC; a lag where pole < zero. Both [rad/s]. Raises InvalidInput."""
    check_positive(zero, "the lead's zero", "give it in rad/s")
    check_positive(pole, "the lead's pole", "give it in rad/s")
    return transfer_function([1 / zero, 1], [1 / pole, 1])


def low_pass(frequency: float, damping: float) -> StateSpace:
    """w^2/(s^2 + 2 d w s + w^2), unit gain at DC, 1/(2 d) at the frequency w [rad/s]; damping d [-]. Raises InvalidInput."""
    w = check_positive(frequency, "the low pass' frequency", "give it in rad/s")
    d = check_positive(damping, "low_pass_damping", "0.7071 is a Butterworth filter")
    return StateSpace([[0, w], [-w, -2 * d * w]], [[0.0], [w]], [[1, 0]], [[0]])
