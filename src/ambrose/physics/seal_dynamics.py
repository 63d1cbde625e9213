"""Seal forces that depend on the whirl frequency as a linear system: constant coefficients and a few states.

    f(s) = -[[D, E], [-E, D]] x(s),   D(j w) = K(w) + j w C(w),   E(j w) = k(w) + j w c(w)

D and E are fitted by rational functions with common stable poles (``core.rational_fit``); their constants and slopes are
K, k, C, c of an ordinary seal, the rest is a state space from displacements to forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape
from ambrose.core.rational_fit import RationalFit, fit_rational
from ambrose.core.statespace import StateSpace
from ambrose.physics.seal import SealCoefficients


@dataclass(frozen=True, slots=True, eq=False)
class SealDynamics:
    """``constant`` acts as any seal does; ``system`` maps displacements x, y [m] to further forces f_x, f_y [N] on the rotor.

    fit: of D and E, in this order; its error is relative to the largest |D| and |E|.
    """

    constant: SealCoefficients
    system: StateSpace
    fit: RationalFit

    def coefficients(self, omega: ArrayLike) -> np.ndarray:
        """K, k [N/m], C, c [N s/m] (4, w) that the model has at omega (w,) [rad/s], positive."""
        omega = check_shape(omega, "omega", "(w,)").astype(float)
        D, E = self.fit.response(omega)
        return np.array([D.real, E.real, D.imag / omega, E.imag / omega])


def seal_dynamics(
    omega: ArrayLike, K: ArrayLike, k: ArrayLike, C: ArrayLike, c: ArrayLike, order: int = 2, damping: bool = True
) -> SealDynamics:  # fmt: skip
    """A seal with 2 ``order`` states whose coefficients at whirl frequencies are nearest to the given ones.

    omega (w,) [rad/s]: positive, ascending. K, k (w,) [N/m], C, c (w,) [N s/m]. damping: whether constant C and c are allowed;
    without them the stiffness stays finite at high frequency. D and E count each by its largest magnitude. Raises InvalidInput
    and NumericalFailure as ``fit_rational``.
    """
    omega = check_shape(omega, "omega", "(w,)").astype(float)
    K, k, C, c = (check_shape(x, name, "(w,)", w=len(omega)) for x, name in ((K, "K"), (k, "k"), (C, "C"), (c, "c")))
    fit = fit_rational(omega, np.array([K + 1j * omega * C, k + 1j * omega * c]), order, slope=damping)
    A, b, (direct, cross) = fit.real_form()
    zero = np.zeros_like(A)
    system = StateSpace(
        np.block([[A, zero], [zero, A]]),
        np.block([[b[:, None], 0 * b[:, None]], [0 * b[:, None], b[:, None]]]),
        -np.block([[direct, cross], [-cross, direct]]),
        np.zeros((2, 2)),
        ["x", "y"],
        ["f_x", "f_y"],
    )
    constant = SealCoefficients(fit.constant[0], fit.constant[1], fit.slope[0], fit.slope[1])
    return SealDynamics(constant, system, fit)
