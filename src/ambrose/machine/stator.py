"""What stands around the rotor, as the user writes it down: displacement sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ambrose.machine.kinds import Angle, Count, Length, PairOf, Rate, Ratio, Text
from ambrose.machine.part import Part

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True, repr=False)
class Runout(Part):
    """One harmonic of the sensor track's profile: amplitude cos(order (spin angle - sensor's angle) + phase)."""

    order: Annotated[int, Count(), "periods per revolution"]
    amplitude: Annotated[Length, "amplitude, zero to peak"]
    phase: Annotated[Angle, "phase"] = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class Sensor(Part):
    """A pair of displacement sensors, at right angles, that serves a bearing; a calibrated one has gain 1.

    Of several pairs of one bearing the controller gets the weighted mean, in the directions of the first one.
    """

    bearing: Annotated[str, Text("the name of a [[bearing]]"), "name of the bearing"]
    position: Annotated[Length, "axial position, from the left end"]
    gain: Annotated[Pair, PairOf("ratio"), "indicated per true displacement"] = (1.0, 1.0)
    bandwidth: Annotated[Rate | None, "corner frequency of a first-order lag; default: no lag"] = None
    noise: Annotated[Length, "root mean square of the noise in every sample; for the virtual rig"] = 0.0
    offset: Annotated[Pair, PairOf("length"), "indicated at zero displacement; for the virtual rig"] = (0.0, 0.0)
    resolution: Annotated[Length, "step of the converter, 0 for none; for the virtual rig"] = 0.0
    runout: Annotated[tuple[Runout, ...], "harmonics of the sensor track's run-out"] = ()
    angle: Annotated[Angle | None, "angle of the first sensor from the global x; default: the bearing's angle"] = None
    weight: Annotated[Ratio, "in the mean of all pairs of the bearing, relative to the others"] = 1.0
