"""The thrust bearing, as the machine file has it: the table [[thrust_bearing]], with everything of
the axis along the shaft in it.

The axis z points to the rotor's right end. A collar turns between two stators, each a ring with one
coil between an inner and an outer pole; the right one pulls along z. What is designed and judged
for this axis is a machine of its own (``ambrose.machine.machine``).
"""

from dataclasses import dataclass, field
from typing import Annotated

from ambrose.machine.description import Tolerance
from ambrose.machine.kinds import (
    Choice,
    Current,
    Damping,
    Length,
    Name,
    PairOf,
    Quantity,
    Rate,
    Ratio,
    Stiffness,
    Text,
    Time,
)
from ambrose.machine.part import Part

Pair = tuple[float, float]  # (left, right)
CORES = ("solid", "laminated")
_SIDES = "left, right"


@dataclass(frozen=True, slots=True, repr=False)
class ThrustStator(Part):
    """One stator: a ring with a slot for its coil between two poles, and a wall behind them."""

    turns: Annotated[float, Quantity("plain number"), "turns of the coil"]
    inner_pole: Annotated[
        Pair, PairOf("length", "inner, outer", scalar=False), "radii of the inner pole"
    ]
    outer_pole: Annotated[
        Pair, PairOf("length", "inner, outer", scalar=False), "radii of the outer pole"
    ]
    slot_depth: Annotated[Length, "depth of the slot"]
    back_wall: Annotated[Length, "thickness behind the slot"]


@dataclass(frozen=True, slots=True, repr=False)
class AxialSensor(Part):
    """The displacement sensor of the axis. Between its place and the collar the rotor grows with
    heat, more than the casing does: ``growth`` is what it then reads with the collar centred.
    """

    position: Annotated[Length, "place of its target"]
    gain: Annotated[Ratio, "indicated per true displacement"] = 1.0
    bandwidth: Annotated[Rate | None, "corner frequency of its lag"] = None
    noise: Annotated[Length, "rms; for the rig"] = 0.0
    resolution: Annotated[Length, "step of the converter; for the rig"] = 0.0
    growth: Annotated[
        Pair | None,
        PairOf("length", "least, most", scalar=False),
        "[least, most] read through thermal growth",
    ] = None
    temperature_rise: Annotated[
        Pair | None,
        PairOf("plain number", "least, most", scalar=False),
        "in place of growth: rotor over casing [K]",
    ] = None
    expansion: Annotated[float, Quantity("plain number"), "of the rotor, per K"] = 1.2e-5


@dataclass(frozen=True, slots=True, repr=False)
class AxialLoad(Part):
    """The process thrust at an operating point."""

    point: Annotated[str, Text("the label of an operating point"), "label of an operating point"]
    force: Annotated[float, Quantity("force"), "thrust on the rotor there, along z"]


@dataclass(frozen=True, slots=True, repr=False)
class AxialController(Part):
    """The axis' reference controller, as [controller] has it for the radial ones."""

    gain: Annotated[float, Quantity("current per displacement"), "K_p"]
    integral_time: Annotated[Time | None, "T_i"] = None
    derivative_time: Annotated[Time | None, "T_d"] = None
    derivative_filter: Annotated[Ratio, "eps"] = 0.1
    low_pass: Annotated[Rate | None, "corner, second order"] = None
    sample_time: Annotated[Time | None, "default: the machine's"] = None
    delay: Annotated[Time | None, "default: the machine's"] = None


@dataclass(frozen=True, slots=True, repr=False)
class AxialWeights(Part):
    """What a robust design of the axis aims at, as [weights]."""

    error_scale: Annotated[Length, "as in [weights]"]
    current_scale: Annotated[Current, "as there"]
    bandwidth: Annotated[Rate, "as there"]
    control_level: Annotated[Ratio, "as there"]


@dataclass(frozen=True, slots=True, repr=False)
class AxialRequirements(Part):
    """What verification of the axis demands, as [requirements]; what is left out of sensitivity and
    margins is the machine's.
    """

    sensitivity_peak: Annotated[Ratio | None, "default: the machine's"] = None
    compliance_peak: Annotated[float | None, Quantity("compliance"), "displacement per force"] = (
        None
    )
    settling_time: Annotated[Time | None, "after a current pulse"] = None


@dataclass(frozen=True, slots=True, repr=False)
class ThrustBearing(Part):
    """A collar between two stators that holds the rotor along its axis, with its sensor, amplifier,
    loads, controller, tolerances and requirements: the axis' own.

    Pairs are (left, right). Both magnets drive the control current against each other: the right
    coil carries bias + i, the left one bias - i.
    """

    name: Annotated[Name, "T calls its axis T_z"]
    position: Annotated[Length, "middle of the collar"]
    collar_radius: Annotated[Length, "outer radius"]
    collar_thickness: Annotated[Length, "axial"]
    gap: Annotated[Pair, PairOf("length", _SIDES), "air gaps, collar centred"]
    bias_current: Annotated[Pair, PairOf("current", _SIDES), "bias of both coils"]
    stators: Annotated[tuple[ThrustStator, ...], "one for both sides, or left and right"] = field(
        metadata={"key": "stator"}
    )
    sensor: Annotated[AxialSensor, "the axis' displacement sensor"]
    distance: Annotated[Length | None, "between the stators, as a check"] = None
    core: Annotated[str, Choice(CORES), "whether eddy currents hold its flux up"] = "solid"
    conductivity: Annotated[float, Quantity("plain number"), "solid core, S/m; assumed"] = 5e6
    permeability: Annotated[Ratio, "relative; assumed"] = 500.0
    core_corner: Annotated[
        Rate | None, "measured -3 dB of force per current; default: from radii"
    ] = None
    core_scale: Annotated[Ratio, "what radial cuts leave of eddy currents"] = 1.0
    flux_density: Annotated[
        float | None, Quantity("magnetic flux density"), "never passed where the iron is narrowest"
    ] = None
    max_current: Annotated[Current | None, "largest control current"] = None
    max_force: Annotated[float | None, Quantity("force"), "largest force"] = None
    touchdown_gap: Annotated[Pair | None, PairOf("length", _SIDES), "way to the stops"] = None
    stop_stiffness: Annotated[Stiffness, "contact there; assumed"] = 1e8
    stop_damping: Annotated[Damping, "contact there; assumed"] = 1e4
    coupling_stiffness: Annotated[Stiffness, "of a coupling to ground"] = 0.0
    coupling_damping: Annotated[Damping, "of that coupling"] = 0.0
    face_scale: Annotated[Ratio, "effective faces, as identified"] = 1.0
    gap_scale: Annotated[Ratio, "effective air gaps, as identified"] = 1.0
    load_time: Annotated[Time, "from least to largest thrust"] = 0.0
    amplifier_bandwidth: Annotated[Rate | None, "first order; default: the machine's"] = None
    max_voltage: Annotated[float | None, Quantity("voltage"), "at a coil"] = None
    inductance: Annotated[float | None, Quantity("inductance"), "of a coil"] = None
    loads: Annotated[tuple[AxialLoad, ...], "process thrust at operating points"] = field(
        default=(), metadata={"key": "load"}
    )
    controller: Annotated[AxialController | None, "the axis' reference controller"] = None
    weights: Annotated[AxialWeights | None, "what a robust design of the axis aims at"] = None
    requirements: Annotated[AxialRequirements | None, "of the axis"] = None
    tolerances: Annotated[tuple[Tolerance, ...], "uncertain parameters of the axis"] = field(
        default=(), metadata={"key": "tolerance"}
    )

    @property
    def pair(self) -> tuple[ThrustStator, ThrustStator]:
        """The stators (left, right)."""
        return self.stators[0], self.stators[-1]

    @property
    def growth(self) -> Pair:
        """What the sensor reads with the collar centred through thermal growth, (least, most) [m]:
        as stated, else expansion times distance times temperature.
        """
        sensor = self.sensor
        if sensor.growth is not None:
            return sensor.growth
        rise = sensor.temperature_rise or (0.0, 0.0)
        lever = sensor.expansion * (sensor.position - self.position)
        return min(lever * t for t in rise), max(lever * t for t in rise)
