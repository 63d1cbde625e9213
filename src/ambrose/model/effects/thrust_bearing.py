"""Thrust bearing: along the shaft an axis of its own (``ambrose.model.axial``); against the radial
motion the negative stiffness of its collar's tilting.

The moment k_t phi_t on the collar (``magnet.tilt_stiffness``) acts as two equal and opposite forces
at its faces, a thickness t apart: f = K (q_left, q_right) with K = k_t/t^2 [[1, -1], [-1, 1]] in
each plane, and phi_t = (q_right - q_left)/t.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ambrose.machine.attachment import Station
from ambrose.machine.axial import axial_machine
from ambrose.machine.description import OperatingPoint
from ambrose.machine.thrust import ThrustBearing
from ambrose.machine.validation.thrust import findings
from ambrose.model.effect import Effect, Reaction


def _stations(part: ThrustBearing) -> tuple[Station, ...]:
    half = part.collar_thickness / 2
    return (
        Station(f"{part.name}_left", part.position - half),
        Station(f"{part.name}_right", part.position + half),
    )


def _reaction(part: ThrustBearing, point: OperatingPoint) -> Reaction:
    """f = -K q with the negative stiffness in K; ports left x, y, right x, y."""
    # a file without a thrust bearing is read without its mathematics
    from ambrose.model.axial.magnet import tilt_stiffness

    tilt = tilt_stiffness(part) / part.collar_thickness**2
    pair = np.array([[-tilt, tilt], [tilt, -tilt]])
    return Reaction(np.kron(pair, np.eye(2)), np.zeros((4, 4)))


def _no_action(part: Any, point: OperatingPoint, quantity: str) -> Iterator[Any]:
    """Its tolerances are those of the axis."""
    yield from ()


THRUST_BEARING = Effect(
    table="thrust_bearing",
    part=ThrustBearing,
    findings=findings,
    stations=_stations,
    quantities={
        "force_per_current": ("force per current", ()),
        "negative_stiffness": ("stiffness", ()),
        "core_scale": ("ratio", ()),
    },
    most=1,
    symbol="mark",
    reach=18.0,
    reaction=_reaction,
    actions=_no_action,
    axis=axial_machine,
)
