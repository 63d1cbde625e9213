"""Flexible coupling to ground: f = -stiffness x - damping x' on the rotor, in the coupling's
axes.
"""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_shape
from ambrose.machine.description import Coupling


def matrices(coupling: Coupling) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (2, 2) [N/m] and damping (2, 2) [N s/m] in (zeta, eta). Raises InvalidInput for
    figures that are not finite.
    """
    stiffness = check_shape(coupling.stiffness, f"the stiffness of coupling {coupling.name}", "(2)")
    damping = check_shape(coupling.damping, f"the damping of coupling {coupling.name}", "(2)")
    return np.diag(stiffness.astype(float)), np.diag(damping.astype(float))


def parameters(coupling: Coupling) -> tuple[float, ...]:
    """What ``force`` needs: (k_zeta, k_eta [N/m], d_zeta, d_eta [N s/m])."""
    stiffness, damping = matrices(coupling)
    return (
        float(stiffness[0, 0]),
        float(stiffness[1, 1]),
        float(damping[0, 0]),
        float(damping[1, 1]),
    )


def force(x: float, y: float, vx: float, vy: float, p: tuple[float, ...]) -> tuple[float, float]:
    """Force (zeta, eta) [N] on the rotor at displacements [m] and velocities [m/s] in the
    coupling's axes.

    Compiles with numba as it stands.
    """
    return -p[0] * x - p[2] * vx, -p[1] * y - p[3] * vy
