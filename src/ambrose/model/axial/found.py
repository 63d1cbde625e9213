"""What an identification found of the thrust magnets, as a thrust bearing that has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.axial.magnet import loaded

_CLOSE = 1e-6  # relative, of both coefficients
_WIDE = (0.2, 5.0)  # of the scales: beyond, the magnet is another one


def with_found(
    part: ThrustBearing, load: float, place: float, k_i: float, k_s: float
) -> ThrustBearing:
    """The bearing whose force per current [N/A] and negative stiffness [N/m] at an operating point
    are these: its faces and its air gaps scaled, all else as it is.

    k_i goes with the area over the gap squared, k_s with the area over its cube, so that two
    numbers say both. Raises InvalidInput where no such scales are found.
    """

    def scaled(x: np.ndarray) -> ThrustBearing:
        return replace(part, face_scale=float(np.exp(x[0])), gap_scale=float(np.exp(x[1])))

    def off(x: np.ndarray) -> np.ndarray:
        try:
            at = loaded(scaled(x), load, place)
        except InvalidInput:  # too weak for its load
            return np.full(2, 10.0)
        return np.log([at.force_per_current / k_i, at.stiffness / k_s])

    start = np.log([part.face_scale, part.gap_scale])
    from scipy.optimize import least_squares

    found = least_squares(off, start, bounds=np.log([[_WIDE[0]] * 2, [_WIDE[1]] * 2]), xtol=1e-15)
    if np.abs(found.fun).max() > _CLOSE:
        raise InvalidInput(
            f"no thrust magnet of {part.name}'s kind has {k_i:.4g} N/A and {k_s:.4g} N/m; check "
            "the record's signals and units, or identify one of the two alone"
        )
    return scaled(found.x)
