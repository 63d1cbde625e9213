"""What the user writes down about a machine. Data only: no matrices, no units but SI, no files.

A field states what it holds and, by its kind, what that measures: ``Length`` is in m, every
dimension in the SI unit that units.py gives it. Pairs are (zeta, eta) in the actuator axes, tilted
by ``angle`` from the global x, y. The tables of machine files are made from these fields
(file/tables.py). Parts are not checked on their own: the Machine made of them is (machine.py).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Annotated, Any, TypeVar

from ambrose.core.checks import check_positive, invalid, names_wrong_types, unfit
from ambrose.machine.kinds import (
    Angle,
    Choice,
    Count,
    Current,
    ForcePerCurrentPair,
    Length,
    Name,
    PairOf,
    Pressure,
    Quantity,
    Rate,
    Ratio,
    StiffnessPair,
    Time,
    Words,
)
from ambrose.machine.ordinary_file import LARGEST_OF_A_POINT
from ambrose.machine.part import (
    BendingMode,
    CasingMode,
    ChainElement,
    CoastDown,
    Disc,
    Magnet,
    MeasuredRotor,
    Part,
    PidSettings,
    Seal,
    Sensor,
    ShaftSection,
    Support,
    Touchdown,
)

Kind = TypeVar("Kind", bound=Part)
Pair = tuple[float, float]  # (zeta, eta)

SCHEMA_VERSION = 1  # of the machine file
BEARING_TERMS = ("first", "last", "every")  # what scenarios call bearings, whatever their names are
COEFFICIENTS_AT = ("no-load", "static-load")
MODAL_DAMPING = 0.005  # usual for a steel shaft
DAMPINGS = ("rayleigh_alpha", "rayleigh_beta", "loss_factor")  # in place of modal_damping
BEAM_THEORIES = ("bernoulli-euler", "rayleigh", "timoshenko")
AMPLIFIER_PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "first": ("bandwidth",),
    "twice-first": ("bandwidth", "eddy_bandwidth"),
    "second": ("natural_frequency", "damping"),
    "current-loop": ("bandwidth",),
}


@dataclass(frozen=True, slots=True, repr=False)
class MagnetGeometry(Part):
    """A heteropolar magnet, from which coefficients are computed when they are not given.

    One opposing pair of horseshoes per axis, differential driving; eight poles have a
    pole_half_angle of 22.5 degrees.
    """

    turns: Annotated[float, Quantity("plain number"), "turns of one horseshoe"]
    pole_area: Annotated[float, Quantity("area"), "area of one pole face"]
    gap: Annotated[Length, "nominal radial air gap"]
    pole_half_angle: Annotated[Angle, "half the angle between the two poles of a horseshoe"] = (
        0.39269908169872414
    )


@dataclass(frozen=True, slots=True, repr=False)
class MagnetIron(Part):
    """The magnet's iron, whose flux density levels off; for the virtual rig and for coefficients
    from geometry.
    """

    turns: Annotated[
        float, Quantity("plain number"), "turns of one horseshoe, both of its poles together"
    ]
    flux_density: Annotated[
        float,
        Quantity("magnetic flux density"),
        "flux density in the air gap that full saturation never passes",
    ]
    equivalent_gap: Annotated[
        Length, "air gap that the unsaturated iron is worth, its path length/(2 mu_r)"
    ]


@dataclass(frozen=True, slots=True, repr=False)
class BiasPoint(Part):
    """Coefficients measured at another bias current."""

    bias_current: Annotated[Current, "bias current of the measurement"]
    force_per_current: Annotated[ForcePerCurrentPair, "force per control current, k_i"]
    negative_stiffness: Annotated[
        StiffnessPair, "negative stiffness k_s, positive where it destabilises"
    ]


@dataclass(frozen=True, slots=True, repr=False)
class MagneticBearing(Part):
    """A radial magnetic bearing with two axes; f = k_i i + k_s x on each, k_s > 0 destabilising.

    Either force_per_current and negative_stiffness are given, or ``geometry`` or ``magnet``;
    ``measured`` holds
    coefficients at other bias currents. The plant has those at the static load, computed where they
    are of the magnet without it (``coefficients_at``). gap, touchdown_gap, max_current (amplitude
    of the control current) and max_force are limits used in verification.
    """

    name: Annotated[Name, "name, first part of its axes' names: A gives A_zeta and A_eta"]
    position: Annotated[Length, "axial position of the magnets' middle, from the left end"]
    bias_current: Annotated[Current, "bias (premagnetisation) current"]
    angle: Annotated[Angle, "angle of the axis zeta from the global x"] = 0.0
    force_per_current: Annotated[
        ForcePerCurrentPair | None,
        "force per control current k_i at bias_current; or give geometry or measured",
    ] = None
    negative_stiffness: Annotated[
        StiffnessPair | None,
        "negative stiffness k_s at bias_current, positive where it destabilises",
    ] = None
    geometry: Annotated[MagnetGeometry | None, "the magnet's geometry"] = None
    measured: Annotated[tuple[BiasPoint, ...], "coefficients at other bias currents"] = ()
    gap: Annotated[Length | None, "radial air gap, a limit in verification"] = None
    touchdown_gap: Annotated[Length | None, "radial gap of the touchdown bearing"] = None
    max_current: Annotated[Current | None, "largest control current"] = None
    max_force: Annotated[float | None, Quantity("force"), "largest force"] = None
    iron: Annotated[MagnetIron | None, "the magnet's iron"] = None
    touchdown: Annotated[Touchdown | None, "contact in the touchdown bearing"] = None
    cross_coupling: Annotated[
        Ratio, "part of the other axis' control current that acts on an axis; for the virtual rig"
    ] = 0.0
    magnetic_offset: Annotated[Pair, PairOf("length"), "magnetic centre from the sensors' zero"] = (
        0.0,
        0.0,
    )
    coefficients_at: Annotated[
        str,
        Choice(COEFFICIENTS_AT),
        "of what the coefficients and measured rows are: the magnet without load (a data sheet), "
        "or while it carries the "
        "rotor's weight (as identified)",
    ] = "no-load"
    magnet: Annotated[Magnet | None, "the magnet as a magnetic network, in place of geometry"] = (
        None
    )


@dataclass(frozen=True, slots=True, repr=False)
class Amplifier(Part):
    """Current amplifier and coil of every axis, unit gain at standstill.

    order "first": bandwidth/(s + bandwidth); "twice-first": that times eddy_bandwidth/(s +
    eddy_bandwidth); "second": natural_frequency^2/(s^2 + damping s + natural_frequency^2); "none":
    ideal. "current-loop": bandwidth/(s + bandwidth) of a coil with resistance and inductance under
    a PI controller, into which the rotor's motion induces a voltage.
    """

    order: Annotated[str, Choice(tuple(AMPLIFIER_PARAMETERS)), "the model's form"] = field(
        default="none", metadata={"required": True}
    )
    bandwidth: Annotated[
        Rate | None, 'corner frequency, for "first", "twice-first" and "current-loop"'
    ] = None
    eddy_bandwidth: Annotated[Rate | None, 'second corner frequency, for "twice-first"'] = None
    natural_frequency: Annotated[Rate | None, 'natural frequency, for "second"'] = None
    damping: Annotated[
        Rate | None, 'damping term d in s^2 + d s + natural_frequency^2, for "second"'
    ] = None
    max_voltage: Annotated[
        float | None,
        Quantity("voltage"),
        "largest voltage at the coil, which limits the slope of the current; for the virtual rig",
    ] = None
    inductance: Annotated[
        float | None,
        Quantity("inductance"),
        'inductance of a coil; for the virtual rig and "current-loop"',
    ] = None
    resistance: Annotated[
        float | None, Quantity("resistance"), 'resistance of a coil, for "current-loop"'
    ] = None


@dataclass(frozen=True, slots=True, repr=False)
class Coupling(Part):
    """A flexible coupling to ground."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    stiffness: Annotated[StiffnessPair, "stiffness"]
    damping: Annotated[Pair, PairOf("damping"), "damping"] = (0.0, 0.0)
    angle: Annotated[Angle, "angle of the axis zeta from the global x"] = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class OperatingPoint(Part):
    """An operating point; the first one is the nominal point."""

    speed: Annotated[Rate, "spin speed"] = 0.0
    seal_pressure: Annotated[Pressure, "differential pressure of every seal"] = 0.0
    bias_current: Annotated[Current | None, "bias current; default: that of each bearing"] = None
    whirl_frequency: Annotated[
        Rate | None, "frequency at which frequency-dependent seals are read; default: the speed"
    ] = None
    label: Annotated[Words, "its name in reports"] = ""

    def __post_init__(self) -> None:
        if unfit(self.label, str):
            kind = type(self.label).__name__
            raise invalid("label of an operating point", kind, "a text", "write its name in quotes")
        for name, (largest, unit) in LARGEST_OF_A_POINT.items():
            value = getattr(self, name)
            if isinstance(value, str):
                raise invalid(
                    f"{name} of an operating point",
                    repr(value),
                    "a number in SI",
                    "units are for machine files",
                )
            optional = value is None and name in ("bias_current", "whirl_frequency")
            if not optional and (isinstance(value, bool) or not isinstance(value, Real)):
                raise invalid(
                    f"{name} of an operating point",
                    type(value).__name__,
                    "a number in SI",
                    "give one number, or leave it out",
                )
            # what is not finite is named where it is used
            if isinstance(value, int | float) and abs(value) > largest:
                limit, remedy = f"at most {largest:g} {unit}", "correct its unit or its exponent"
                text = (
                    f"{value:g}"
                    if isinstance(value, float)
                    else f"an integer of {len(str(abs(value)))} digits"
                )
                raise invalid(f"{name} of an operating point", text, limit, remedy)


@dataclass(frozen=True, slots=True, repr=False)
class OperatingRange(Part):
    """All speeds and seal pressures of a rectangle: its corners are operating points, and what lies
    between is judged, too.
    """

    label: Annotated[Words, "its name in reports"]
    speed: Annotated[
        Pair, PairOf("angular rate", "lowest, highest"), "[lowest, highest] spin speed, or one"
    ] = (0.0, 0.0)
    seal_pressure: Annotated[
        Pair, PairOf("pressure", "lowest, highest"), "[lowest, highest] pressure, or one"
    ] = (0.0, 0.0)
    bias_current: Annotated[Current | None, "bias current; default: that of each bearing"] = None

    def at(self, speed: float, seal_pressure: float) -> OperatingPoint:
        """An operating point of the range."""
        label = f"{self.label}: {speed * 30 / math.pi:.6g} rpm, {seal_pressure / 1e5:.6g} bar"
        return OperatingPoint(speed, seal_pressure, self.bias_current, None, label)

    @property
    def corners(self) -> tuple[OperatingPoint, ...]:
        """Its two or four corners, lowest speed and pressure first."""
        return tuple(
            self.at(v, p)
            for v in dict.fromkeys(self.speed)
            for p in dict.fromkeys(self.seal_pressure)
        )


@dataclass(frozen=True, slots=True, repr=False)
class Operation(Part):
    """Where the machine runs."""

    points: Annotated[
        tuple[OperatingPoint, ...],
        "operating points at which the machine is verified; default: standstill",
    ] = field(default=(OperatingPoint(label="standstill"),), metadata={"key": "point"})
    speed_range: Annotated[
        Pair,
        PairOf("angular rate", "lowest, highest", scalar=False),
        "[lowest, highest] spin speed",
    ] = (
        0.0,
        0.0,
    )
    design_point: Annotated[
        Words, "label of the point that controllers are designed for; default: the nominal one"
    ] = ""
    ranges: Annotated[
        tuple[OperatingRange, ...], "ranges of speed and pressure in which the machine runs"
    ] = field(default=(), metadata={"key": "range"})
    pressure_rate: Annotated[
        float | None,
        Quantity("pressure per time"),
        "fastest change of the seal pressure, for a proof while it changes",
    ] = None

    @property
    def envelope(self) -> tuple[OperatingPoint, ...]:
        """The operating points, and the corners of the ranges that are none of them."""

        def place(point: OperatingPoint) -> tuple[float | None, ...]:
            return point.speed, point.seal_pressure, point.bias_current, point.whirl_frequency

        corners = {place(corner): corner for area in self.ranges for corner in area.corners}
        known = {place(point) for point in self.points}
        return (*self.points, *(corner for at, corner in corners.items() if at not in known))

    @property
    def running(self) -> tuple[float, float]:
        """The speeds [rad/s] between which it runs: speed_range, else from the slowest to the
        fastest turning point where those are two; (0, 0): no such range.
        """
        turning = {point.speed for point in self.envelope if point.speed > 0}
        taken = self.speed_range[1] <= 0 and len(turning) > 1
        return (min(turning), max(turning)) if taken else self.speed_range

    @property
    def nominal(self) -> OperatingPoint:
        return self.points[0]

    @property
    def design(self) -> OperatingPoint:
        """The point that controllers are designed for."""
        return next(
            (point for point in self.envelope if point.label == self.design_point and point.label),
            self.nominal,
        )


@dataclass(frozen=True, slots=True, repr=False)
class Tolerance(Part):
    """One uncertain parameter, named by its path ("seal.center.k",
    "bearing.A.negative_stiffness.zeta").

    relative: half-width as a fraction of the nominal value; or absolute: half-width in SI units.
    One of the two. around: labels of the operating points around which it applies; by default every
    one.
    """

    parameter: str
    relative: float | None = None
    absolute: float | None = None
    around: tuple[str, ...] = ()

    @names_wrong_types
    def __post_init__(self) -> None:
        if not isinstance(self.parameter, str):
            raise invalid(
                "the parameter of a tolerance",
                repr(self.parameter),
                "a path",
                '"seal.center.k" is one',
            )
        for name in ("relative", "absolute"):
            width = getattr(self, name)
            if width is not None:
                check_positive(
                    width,
                    f"{name} of the tolerance of {self.parameter}",
                    "give the half-width",
                    zero_allowed=True,
                )


@dataclass(frozen=True, slots=True, repr=False)
class Requirements(Part):
    """What verification demands; a key left out is judged by its standard's default, or not at
    all.
    """

    sensitivity_peak: Annotated[Ratio | None, "largest sensitivity"] = None
    compliance_peak: Annotated[
        float | None, Quantity("compliance"), "largest displacement per force"
    ] = None
    balance_grade: Annotated[
        float | None, Quantity("velocity"), 'balance grade; G2.5 is "2.5 mm/s"'
    ] = None
    balance_speed: Annotated[Rate | None, "speed at which the residual unbalance is set"] = None
    unbalance_orbit: Annotated[Length | None, "largest unbalance response, zero to peak"] = None
    unbalance_to: Annotated[Rate | None, "speed up to which unbalance_orbit applies"] = None
    settling_time: Annotated[Time | None, "longest settling after a disturbance"] = None
    gain_margin: Annotated[Ratio | None, "smallest gain margin, as a factor"] = None
    phase_margin: Annotated[Angle | None, "smallest phase margin"] = None
    log_decrement: Annotated[Ratio | None, "smallest logarithmic decrement"] = None
    damping_above: Annotated[
        Ratio | None, "smallest damping ratio of modes above the top speed"
    ] = None
    max_current: Annotated[Current | None, "largest control current"] = None
    control_gain: Annotated[
        float | None,
        Quantity("current per displacement"),
        "largest gain from measurement to current, K S_o",
    ] = None
    roll_off: Annotated[
        Rate | None, "frequency above which control_gain falls by 20 dB per decade"
    ] = None
    running_speeds: Annotated[
        Pair | None,
        PairOf("angular rate", "lowest, highest", scalar=False),
        "[lowest, highest] running speed, which critical speeds stay away from (API 617)",
    ] = None


@dataclass(frozen=True, slots=True, repr=False)
class DesignWeights(Part):
    """What a robust design (H-infinity, mu) aims at; weights are the inverse of what is allowed.

    With a control_crossover W_u rises from control_level through 1 there to control_limit, with
    control_order (``law/design_problem.py`` makes transfer functions of it).
    """

    error_scale: Annotated[Length, "D_e, the largest acceptable control error"]
    current_scale: Annotated[Current, "D_u, the largest control current"]
    bandwidth: Annotated[Rate, "w_B, below which disturbances are reduced"]
    control_level: Annotated[
        Ratio, "W_u at low frequencies, weight of the current in units of current_scale"
    ]
    peak: Annotated[Ratio, "M, the largest sensitivity; default: 3"] = 3.0
    low_frequency_error: Annotated[
        Ratio, "A_w, what is left of a constant disturbance; default: 0.001"
    ] = 1e-3
    control_crossover: Annotated[
        Rate | None, "frequency above which W_u exceeds 1; default: W_u is constant"
    ] = None
    control_order: Annotated[int, Count(), "order of W_u's rise"] = 1
    control_limit: Annotated[Ratio | None, "W_u far above its crossover; default: 30"] = None
    current_disturbance: Annotated[
        Ratio, "size of the disturbing current, in units of current_scale; default: 1"
    ] = 1.0
    output_disturbance: Annotated[
        Ratio, "size of the disturbance of the measurement, in units of error_scale; default: 1"
    ] = 1.0


@dataclass(frozen=True, slots=True, repr=False)
class MachineDescription(Part):
    """A rotor on magnetic bearings as written down, not yet checked; a Machine is one that was.

    ``assumed`` lists the parameters that were chosen, not measured or published, each with its
    reason. ``effects`` are the parts of registered effects that have no field here, in the file a
    table each (``machine.attachment``). file_text is the file that the machine was read from
    (empty: none), for its comments, order and units; it is not compared.
    """

    name: Annotated[Name, "name of the machine"]
    shaft: Annotated[tuple[ShaftSection, ...], "shaft sections from the left end to the right"]
    bearings: Annotated[tuple[MagneticBearing, ...], "radial magnetic bearings"] = field(
        metadata={"key": "bearing"}
    )
    sensors: Annotated[tuple[Sensor, ...], "displacement sensors, a pair or more per bearing"] = (
        field(metadata={"key": "sensor"})
    )
    amplifier: Annotated[Amplifier, "amplifier and coil of every axis"] = field(
        default_factory=Amplifier, metadata={"required": True}
    )
    discs: Annotated[tuple[Disc, ...], "rigid discs"] = field(default=(), metadata={"key": "disc"})
    seals: Annotated[tuple[Seal, ...], "annular seals"] = field(
        default=(), metadata={"key": "seal"}
    )
    couplings: Annotated[tuple[Coupling, ...], "flexible couplings to ground"] = field(
        default=(), metadata={"key": "coupling"}
    )
    effects: tuple[Part, ...] = ()
    supports: Annotated[tuple[Support, ...], "supports under bearings"] = field(
        default=(), metadata={"key": "support"}
    )
    casing_modes: Annotated[tuple[CasingMode, ...], "modes of the casing"] = field(
        default=(), metadata={"key": "casing_mode"}
    )
    bending_modes: Annotated[tuple[BendingMode, ...], "bending modes of the rotor as measured"] = (
        field(default=(), metadata={"key": "bending_mode"})
    )
    chain: Annotated[tuple[ChainElement, ...], "elements of the signal chain"] = field(
        default=(), metadata={"key": "chain"}
    )
    controller: Annotated[PidSettings | None, "the reference controller"] = None
    operation: Annotated[Operation, "operating points and speed range"] = field(
        default_factory=Operation
    )
    tolerances: Annotated[tuple[Tolerance, ...], "uncertain parameters"] = field(
        default=(), metadata={"key": "tolerance"}
    )
    requirements: Annotated[Requirements, "what verification demands"] = field(
        default_factory=Requirements
    )
    measured_rotor: Annotated[
        MeasuredRotor | None, "the rotor by its modes, in place of shaft and discs"
    ] = None
    coast_down: Annotated[CoastDown | None, "what slows the rotor after the trip"] = None
    weights: Annotated[DesignWeights | None, "what a robust design aims at"] = None
    description: Annotated[Words, "what it is, in a sentence"] = ""
    source: Annotated[Words, "where its figures come from"] = ""
    modal_damping: Annotated[
        Ratio, "damping ratio of every bending mode; the next three take its place"
    ] = MODAL_DAMPING
    rayleigh_alpha: Annotated[
        float,
        Quantity("plain number"),
        "mass-proportional damping of bending modes [1/s]: a ratio alpha/(2 w)",
    ] = 0.0
    rayleigh_beta: Annotated[
        Time, "stiffness-proportional damping of bending modes: a ratio beta w/2"
    ] = 0.0
    loss_factor: Annotated[
        Ratio,
        "hysteretic damping of bending modes: a ratio of half of it",
    ] = 0.0
    rotating_share: Annotated[
        Ratio,
        "share of that damping which turns with the rotor (internal damping), rayleigh_alpha apart",
    ] = 0.0
    beam_theory: Annotated[str, Choice(BEAM_THEORIES), "theory of the shaft's beam elements"] = (
        "bernoulli-euler"
    )
    gravity_direction: Annotated[
        Angle | None,
        "where the rotor's weight points, from the global x towards y; default: no weight",
    ] = None
    assumed: tuple[tuple[str, str], ...] = ()
    file_text: str = field(default="", compare=False)

    @property
    def length(self) -> float:
        """Rotor length [m]."""
        return self.shaft[-1].start + self.shaft[-1].length

    @property
    def attached(self) -> tuple[Any, ...]:
        """The parts of all registered effects, in the order of their ports."""
        return (*self.couplings, *self.effects)

    def parts(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """Those of a kind among ``attached``, such as ``Load``, in their order."""
        return tuple(part for part in self.attached if isinstance(part, kind))

    @property
    def reference(self) -> PidSettings | None:
        """The reference controller; None where there is none, or [controller] states only when
        controllers run.
        """
        return (
            self.controller
            if self.controller is not None and (self.controller.gain or self.controller.channels)
            else None
        )

    @property
    def sensor_pairs(self) -> tuple[Sensor, ...]:
        """The sensors in the order of the bearings, each with its angle [rad], and its share in the
        mean as weight.
        """
        pairs: list[Sensor] = []
        for bearing in self.bearings:
            sensors = [sensor for sensor in self.sensors if sensor.bearing == bearing.name]
            total = sum(sensor.weight for sensor in sensors)
            angles = [bearing.angle if sensor.angle is None else sensor.angle for sensor in sensors]
            pairs += [
                replace(s, angle=angle, weight=s.weight / total)
                for s, angle in zip(sensors, angles, strict=True)
            ]
        return tuple(pairs)

    @property
    def axis_bearings(self) -> tuple[Any, ...]:
        """The bearing of every control axis, in the order of ``axes``."""
        return tuple(bearing for bearing in self.bearings for _ in range(2))

    @property
    def axes(self) -> tuple[str, ...]:
        """The control axes in their fixed order: A_zeta, A_eta, B_zeta, B_eta."""
        return tuple(
            f"{bearing.name}_{axis}" for bearing in self.bearings for axis in ("zeta", "eta")
        )
