"""What stands around the rotor, as the user writes it down: sensors, supports under bearings, modes
of a casing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ambrose.machine.kinds import (
    Angle,
    Choice,
    Count,
    Length,
    ListOf,
    Mass,
    PairOf,
    Rate,
    Ratio,
    Text,
    Texts,
)
from ambrose.machine.part import Part

Pair = tuple[float, float]
SENSORS_ON = ("support", "ground")


@dataclass(frozen=True, slots=True, repr=False)
class Runout(Part):
    """One harmonic of the sensor track's profile: amplitude cos(order (spin angle - sensor's angle)
    + phase).
    """

    order: Annotated[int, Count(), "periods per revolution"]
    amplitude: Annotated[Length, "amplitude, zero to peak"]
    phase: Annotated[Angle, "phase"] = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class Sensor(Part):
    """A pair of displacement sensors, at right angles, that serves a bearing; a calibrated one has
    gain 1.

    Of several pairs of one bearing the controller gets the weighted mean, in the directions of the
    first one.
    """

    bearing: Annotated[str, Text("the name of a [[bearing]]"), "name of the bearing"]
    position: Annotated[Length, "axial position, from the left end"]
    gain: Annotated[Pair, PairOf("ratio"), "indicated per true displacement"] = (1.0, 1.0)
    bandwidth: Annotated[Rate | None, "corner frequency of a first-order lag; default: no lag"] = (
        None
    )
    noise: Annotated[
        Length, "root mean square of the noise in every sample; for the virtual rig"
    ] = 0.0
    offset: Annotated[
        Pair, PairOf("length"), "indicated at zero displacement; for the virtual rig"
    ] = (0.0, 0.0)
    resolution: Annotated[Length, "step of the converter, 0 for none; for the virtual rig"] = 0.0
    runout: Annotated[tuple[Runout, ...], "harmonics of the sensor track's run-out"] = ()
    angle: Annotated[
        Angle | None, "angle of the first sensor from the global x; default: the bearing's angle"
    ] = None
    weight: Annotated[Ratio, "in the mean of all pairs of the bearing, relative to the others"] = (
        1.0
    )


@dataclass(frozen=True, slots=True, repr=False)
class Support(Part):
    """A pedestal or housing under the stator of a bearing: a mass on a spring and a damper to the
    ground, in x and in y.

    Magnet and touchdown bearing act between the rotor and it, and so do the seals that are named.
    """

    bearing: Annotated[
        str, Text("the name of a [[bearing]]"), "name of the bearing that stands on it"
    ]
    mass: Annotated[Pair, PairOf("mass", "x, y"), "mass that moves with the stator"]
    stiffness: Annotated[Pair, PairOf("stiffness", "x, y"), "stiffness to the ground"]
    damping: Annotated[Pair, PairOf("damping", "x, y"), "damping to the ground"] = (0.0, 0.0)
    angle: Annotated[Angle, "angle of the first of its two directions from the global x"] = 0.0
    sensor: Annotated[str, Choice(SENSORS_ON), "what the bearing's sensors are fixed to"] = (
        "support"
    )
    seals: Annotated[
        tuple[str, ...], Texts(), "names of the seals whose stator it carries, too"
    ] = ()


@dataclass(frozen=True, slots=True, repr=False)
class CasingMode(Part):
    """A mode of the casing or foundation, measured or computed without the rotor, that moves the
    stators of bearings and seals.

    Its receptance between two places is the product of their deflections over mass (w^2 - W^2 + 2 j
    damping w W).
    """

    frequency: Annotated[Rate, "natural frequency w"]
    mass: Annotated[Mass, "modal mass that belongs to the deflections"]
    at: Annotated[
        tuple[str, ...], Texts(), "names of the bearings and seals whose stators it moves"
    ]
    x: Annotated[tuple[float, ...], ListOf("plain number"), "deflection of each in x"] = ()
    y: Annotated[tuple[float, ...], ListOf("plain number"), "deflection of each in y"] = ()
    damping: Annotated[Ratio, "damping ratio"] = 0.01
    sensor: Annotated[
        str, Choice(SENSORS_ON), "what the sensors of these bearings are fixed to"
    ] = "support"
