"""Flexible coupling to ground, linear view: f = -stiffness x - damping x' on the rotor, in the coupling's axes."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_shape
from ambrose.machine.description import Coupling


def matrices(coupling: Coupling) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (2, 2) [N/m] and damping (2, 2) [N s/m] in (zeta, eta). Raises InvalidInput for figures that are not finite."""
    stiffness = check_shape(coupling.stiffness, f"the stiffness of coupling {coupling.name}", "(2)")
    damping = check_shape(coupling.damping, f"the damping of coupling {coupling.name}", "(2)")
    return np.diag(stiffness.astype(float)), np.diag(damping.astype(float))
