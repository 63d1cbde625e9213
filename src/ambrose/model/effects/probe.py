"""Probe: a place on the rotor whose motion is wanted, in x and y. It pulls at nothing.

The rotor has ports there: what the plant can be pushed at, and whose displacement it gives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ambrose.machine.description import OperatingPoint
from ambrose.machine.kinds import Angle, Length, Name
from ambrose.machine.part import Part
from ambrose.model.effect import Effect, Reaction

MOST = 500  # stations of a fine mesh, each with a probe


@dataclass(frozen=True, slots=True, repr=False)
class Probe(Part):
    """A place whose motion is wanted: a vibration probe, a coupling hub, an unbalance plane."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    direction: Annotated[
        Angle | None,
        "of a single vibration probe, from the global x towards y; default: both x and y",
    ] = None


def no_reaction(part: Part, point: OperatingPoint) -> Reaction:
    """No force at one station: f = 0 q + 0 q'."""
    return Reaction(np.zeros((2, 2)), np.zeros((2, 2)))


PROBE = Effect(
    table="probe", part=Probe, most=MOST, symbol="probe", reach=17.0, reaction=no_reaction
)
