"""What follows the drop: the rotor slows down in its touchdown bearings until it stands.

J W' = -brake - windage W^2 - sum of the bearings' moments, each under its share of the weight F:
on a race that has spun up its friction moment M_0 + mu_b F d/2, in a fixed bush mu F R, whose work
is slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.model.effects.rotor import STANDARD_GRAVITY

_STEPS = 4000  # of the speed


@dataclass(frozen=True, slots=True)
class RunDown:
    """time [s] to stand still (inf: nothing slows the rotor); slip [J] in all fixed bushes; taken
    [J]: by drive, windage and constant friction.
    """

    time: float
    slip: float
    taken: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; a time that never ends is null."""
        time = self.time if np.isfinite(self.time) else None
        return {"time": time, "slip_energy": self.slip, "taken_by_drive_and_windage": self.taken}


def run_down(fallen: FallenRotor, speed: float, brake: float, windage: float) -> RunDown:
    """From a speed [rad/s] to rest; brake [N m], windage [N m s2]: torque over speed squared."""
    load = STANDARD_GRAVITY * fallen.mass / len(fallen.bearings)
    if not fallen.weight.any():
        load = 0.0  # what lies on the axial stop is not known here
    rubbing, rolling = 0.0, 0.0
    for bearing in fallen.bearings:
        if bearing.race_mass:
            rolling += bearing.drag + bearing.drag_arm * load
        else:
            rubbing += bearing.friction * load * bearing.radius
    # dt = J dW / torque(W); energies by their share of the torque
    edges = np.linspace(0.0, speed, _STEPS + 1)
    W = (edges[1:] + edges[:-1]) / 2
    torque = brake + windage * W**2 + rubbing + rolling
    if not torque.all():
        return RunDown(np.inf, 0.0, 0.0)
    energy = fallen.polar_inertia * W * np.diff(edges)
    return RunDown(
        float(np.sum(fallen.polar_inertia * np.diff(edges) / torque)),
        float(np.sum(energy * rubbing / torque)),
        float(np.sum(energy * (brake + windage * W**2) / torque)),
    )
