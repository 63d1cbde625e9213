"""Rigid rotors in touchdown bearings, without a machine around them, and the closed form of their
whip.
"""

import numpy as np

from ambrose.annexes.touchdown.drop import FallenRotor
from ambrose.model.effects.touchdown import Bearing

CLEARANCE = 2e-4


def bush(k, d, mass=1e-9, contact=1e15):
    """A bush on a mount, so light and hard that the mount alone counts."""
    return Bearing(
        CLEARANCE,
        contact,
        0.0,
        0.2,
        0.01,
        0.04,
        1e-7,
        0.2,
        0.1,
        ring_mass=mass,
        mount_stiffness=k,
        mount_damping=d,
    )


def rotor(mass_matrix, rows, bearings):
    """A free rotor without weight; rows (b, 2, n)."""
    n = len(mass_matrix)
    zero = np.zeros((n, n))
    return FallenRotor(
        tuple("AB"[: len(bearings)]),
        tuple(bearings),
        mass_matrix,
        zero,
        zero,
        zero,
        np.array(rows),
        np.zeros(n),
        mass_matrix[0, 0],
        1.0,
        1000.0,
        (),
        np.zeros(0),
        np.zeros((0, 2, n)),
        np.zeros((2 * len(bearings), n)),
    )


def polynomial_edge(m, k, d, mu):
    """The root of mu (k^2 - (k m - d^2) w^2) = m d w^3 above zero."""
    roots = np.roots([m * d, mu * (k * m - d**2), 0.0, -mu * k**2])
    real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
    (edge,) = real[real > 0]
    return edge
