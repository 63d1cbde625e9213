"""What bearings and seals stand on: every support and every mode of the casing as coordinates of
second order.

q'' + 2 d w q' + w^2 q = -row . f, f [N] the force of stator on rotor; the stator moves by row q. A
support is two coordinates, one per direction, of its own mass; the receptances of all that moves
one stator add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.machine.description import MachineDescription


@dataclass(frozen=True, slots=True, eq=False)
class Foundation:
    """m coordinates: stiffness (m,) [rad2/s2], damping (m,) [rad/s]; rows (2, m) [1/sqrt(kg)] of
    stators by name and of sensors by bearing: how far they move in x and y.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    stators: dict[str, np.ndarray]
    sensors: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.stiffness)

    def stator_rows(self, names: Sequence[str]) -> np.ndarray:
        """(names, 2, m), zero for what stands on the ground."""
        still = np.zeros((2, len(self)))
        return np.array([self.stators.get(name, still) for name in names]).reshape(
            len(names), 2, len(self)
        )

    def sensor_rows(self, bearings: Sequence[str]) -> np.ndarray:
        """(bearings, 2, m), zero for sensors that stand on the ground."""
        still = np.zeros((2, len(self)))
        return np.array([self.sensors.get(name, still) for name in bearings]).reshape(
            len(bearings), 2, len(self)
        )


def foundation(machine: MachineDescription) -> Foundation:
    """The coordinates of all supports, then of the modes of the casing."""
    coordinates: list[tuple[float, float, dict[str, tuple[float, float]], bool]] = []
    for item in machine.supports:
        for way in range(2):
            # mass-normalised: k/m, d/m, and x, y of a unit coordinate 1/sqrt(m)
            angle, size = item.angle + way * np.pi / 2, 1 / np.sqrt(item.mass[way])
            row = (float(size * np.cos(angle)), float(size * np.sin(angle)))
            rows = dict.fromkeys((item.bearing, *item.seals), row)
            coordinates.append(
                (
                    item.stiffness[way] * size**2,
                    item.damping[way] * size**2,
                    rows,
                    item.sensor == "support",
                )
            )
    for mode in machine.casing_modes:
        size, zero = 1 / np.sqrt(mode.mass), (0.0,) * len(mode.at)
        rows = {
            name: (size * x, size * y)
            for name, x, y in zip(mode.at, mode.x or zero, mode.y or zero, strict=True)
        }
        coordinates.append(
            (mode.frequency**2, 2 * mode.damping * mode.frequency, rows, mode.sensor == "support")
        )
    m = len(coordinates)
    stators: dict[str, np.ndarray] = {}
    sensors: dict[str, np.ndarray] = {}
    bearings = {bearing.name for bearing in machine.bearings}
    for i, (_, _, rows, carried) in enumerate(coordinates):
        for name, row in rows.items():
            stators.setdefault(name, np.zeros((2, m)))[:, i] = row
            if carried and name in bearings:
                sensors.setdefault(name, np.zeros((2, m)))[:, i] = row
    return Foundation(
        np.array([c[0] for c in coordinates]),
        np.array([c[1] for c in coordinates]),
        stators,
        sensors,
    )
