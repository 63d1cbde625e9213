"""What every part of a machine can do: show itself in a line, and give its plain data under the
keys of a machine file.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import lru_cache
from math import inf
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np

from ambrose.core.presentation import Presented
from ambrose.machine.kinds import (
    Angle,
    Choice,
    Choices,
    Count,
    Damping,
    Inertia,
    Length,
    ListOf,
    Mass,
    Name,
    NestedOf,
    PairOf,
    Pressure,
    Quantity,
    Rate,
    Ratio,
    Stiffness,
    Text,
    Texts,
    Time,
    Words,
)


@lru_cache(maxsize=256)
def hints_of(part: type) -> dict[str, Any]:
    """The types of a part's fields with what their annotations say, once for each kind of part."""
    return get_type_hints(part, include_extras=True)


class Part(Presented):
    """A noun of the machine file. A field whose key in the file differs names it in its metadata;
    what is not compared is no key of the file.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        """Arrays, which have no truth value and no hash, become the tuples that a file gives."""
        for item in fields(self):  # type: ignore[arg-type]  # every Part is a dataclass
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, _tuples(value.tolist()))

    def facts(self) -> Mapping[str, Any]:
        return {key: _named(value) for key, value in self.to_dict().items()}

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """The values by their keys in a machine file, SI, as plain data; those at their default
        only with ``defaults``.
        """
        table, hints = {}, hints_of(type(self))  # type: ignore[arg-type]  # hashable
        for item in fields(self):  # type: ignore[arg-type]  # every Part is a dataclass
            value = getattr(self, item.name)
            default = (
                item.default_factory() if item.default_factory is not MISSING else item.default
            )
            if (
                item.compare
                and value is not None
                and (defaults or default is MISSING or value != default)
            ):
                key = item.metadata.get("key", item.name)
                table[key] = (
                    int(value)
                    if _counts(hints[item.name])
                    else to_plain_values(value, defaults=defaults)
                )
        return table


def _counts(hint: Any) -> bool:
    """Whether a field is a whole number: Annotated[int, ...], or int | None."""
    kind = next(iter(get_args(hint)), None)
    return int in (kind, *get_args(kind))


def to_plain_values(value: Any, *, defaults: bool = False) -> Any:
    """A value of a field as a file holds it: parts as tables, tuples and arrays as lists, every
    number a float.
    """
    if isinstance(value, Part):
        return value.to_dict(defaults=defaults)
    if isinstance(value, np.ndarray):
        return to_plain_values(value.tolist())
    if isinstance(value, (tuple, list)):
        return [to_plain_values(element, defaults=defaults) for element in value]
    return value if isinstance(value, str) else float(value) + 0.0  # no negative zero


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _named(value: Any) -> Any:
    """A table by its label or name, to keep a line short."""
    if isinstance(value, list):
        return [_named(element) for element in value]
    return value.get("label") or value.get("name") or "{...}" if isinstance(value, dict) else value


# The rotor itself: shaft sections, discs and measured bending modes as the user writes them down;
# and a rotor without bearings, as drawings, spreadsheets and other programs' models have it before
# magnets are chosen for it.


@dataclass(frozen=True, slots=True, repr=False)
class Material(Part):
    """A material, [material.NAME], that shaft sections refer to by name; the name is not
    compared.
    """

    density: Annotated[float, Quantity("density"), "mass density"] = 7850.0
    youngs_modulus: Annotated[float, Quantity("elastic modulus"), "Young's modulus"] = 2.1e11
    poisson_ratio: Annotated[Ratio, "Poisson's ratio"] = 0.3
    name: str = field(default="", compare=False)


# What a [[shaft]] may name without a table of its own, at room temperature: density [kg/m3],
# Young's modulus [Pa], Poisson's ratio. Steel: this package's default. 42CrMo4 (1.7225): a
# supplier's sheet, 7.84 g/cm3 and 190 to 210 GPa, of which the upper end, with steel's ratio.
# Ti-6Al-4V: suppliers' sheets, 4.43 g/cm3 and 114 GPa; ratio recalled. Aluminium: moduli and ratios
# of a published table of measured alloys, densities recalled. Inconel 718, aged: Special Metals
# SMC-045, 0.297 lb/in3, 29.0e6 psi, 0.29.
MATERIALS: Mapping[str, Material] = {
    name: Material(*figures, name)
    for name, figures in {
        "steel": (7850.0, 210e9, 0.3),
        "42CrMo4": (7840.0, 210e9, 0.3),
        "Ti-6Al-4V": (4430.0, 114e9, 0.34),
        "aluminium 6061": (2700.0, 69e9, 0.33),
        "aluminium 7075": (2810.0, 71e9, 0.33),
        "Inconel 718": (8220.0, 200e9, 0.29),
    }.items()
}


@dataclass(frozen=True, slots=True, repr=False)
class ShaftSection(Part):
    """A cylindrical or conical piece of shaft; the sections follow each other from the left end to
    the right, without gap or overlap.

    mass_diameter lets shrunk-on laminations add inertia without stiffness. A cone has other
    diameters at its right end.
    """

    start: Annotated[Length, "where the section starts; default: the end of the previous one"] = (
        field(metadata={"required": False})
    )
    length: Annotated[Length, "axial length"]
    outer_diameter: Annotated[Length, "outer diameter, for the stiffness"]
    inner_diameter: Annotated[Length, "bore"] = 0.0
    mass_diameter: Annotated[
        Length | None,
        "outer diameter for the mass, where laminations add mass without stiffness; default: "
        "outer_diameter",
    ] = None
    elements: Annotated[int, Count(), "number of finite elements"] = 1
    material: Annotated[
        Material,
        Text("the name of a [material.NAME] table"),
        "name of a [material.NAME] table, or of a known material; default: steel",
    ] = field(default_factory=Material)
    label: Annotated[Words, "a name for drawings and messages"] = ""
    end_outer_diameter: Annotated[
        Length | None,
        "outer diameter at the right end of a cone, linear in between; default: outer_diameter",
    ] = None
    end_inner_diameter: Annotated[
        Length | None, "bore at the right end of a cone; default: inner_diameter"
    ] = None

    @property
    def conical(self) -> bool:
        return self.diameters(0.0) != self.diameters(1.0)

    def diameters(self, place: float) -> tuple[float, float, float]:
        """Outer diameter, bore and outer diameter of the mass [m] at a place from 0 (left end) to 1
        (right end).
        """
        outer = _between(self.outer_diameter, self.end_outer_diameter, place)
        mass = outer if self.mass_diameter is None else self.mass_diameter
        return outer, _between(self.inner_diameter, self.end_inner_diameter, place), mass


def _between(start: float, end: float | None, place: float) -> float:
    return start if end is None else start + place * (end - start)


@dataclass(frozen=True, slots=True, repr=False)
class Disc(Part):
    """A rigid disc on the shaft: an impeller, a wheel, a thrust collar."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position of its centre of mass, from the left end"]
    mass: Annotated[Mass, "mass"]
    polar_inertia: Annotated[Inertia, "moment of inertia about the shaft's axis"] = 0.0
    diametral_inertia: Annotated[
        Inertia, "moment of inertia about a diameter through its centre of mass"
    ] = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class BendingMode(Part):
    """A bending mode of the free rotor at standstill as measured, in place of what shaft and discs
    give, in both planes.

    Its shape stays that of shaft and discs. Measured hanging from a soft rope, or found by
    identification. Of a measured rotor all modes are stated, with their shapes.
    """

    number: Annotated[int, Count(), "which one: 1 for the lowest"]
    frequency: Annotated[Rate | None, "natural frequency; default: that of shaft and discs"] = None
    damping: Annotated[Ratio | None, "damping ratio; default: modal_damping"] = None
    shape: Annotated[
        tuple[float, ...],
        ListOf("plain number"),
        "deflections at the measured rotor's places [kg^-1/2], of modal mass one",
    ] = ()
    gyroscopic: Annotated[
        tuple[float, float],
        PairOf("plain number", "with tilting, of itself", scalar=False),
        "[with tilting, of itself], a measured rotor's gyroscopic matrix over the speed",
    ] = (0.0, 0.0)


_SAME_SPEED = 0.01  # relative


@dataclass(frozen=True, slots=True, repr=False)
class MeasuredRotor(Part):
    """The rotor by its modes, in place of shaft and discs, which then only draw it: as a rigid body
    and by every [[bending_mode]] with its shape. It holds at the speed at which it was measured.
    """

    mass: Annotated[Mass, "mass, as weighed"]
    diametral_inertia: Annotated[
        Inertia | None, "about the centre of mass; default: a bar's of this mass and length"
    ] = None
    centre: Annotated[Length | None, "place of the centre of mass; default: the middle"] = None
    polar_inertia: Annotated[Inertia, "about the axis"] = 0.0
    speed: Annotated[Rate, "speed at which it was measured, and alone holds"] = 0.0
    places: Annotated[tuple[float, ...], ListOf("length"), "where the shapes are stated"] = ()

    def holds_at(self, speed: float) -> bool:
        """Whether it tells anything at a speed [rad/s]: within a hundredth of its own."""
        return abs(speed - self.speed) <= max(_SAME_SPEED * self.speed, 1e-9)


@dataclass(frozen=True, slots=True)
class RotorModel:
    """shaft and discs as in a machine; bearings [m]: where they stand (empty: not said); speed
    [rad/s]: the highest (None: not said). assumed: what was chosen on the way and why, by key;
    left_out: what the source holds and this does not, in words. magnets: what the source says of
    those at a place [m]: turns, pole_area [m^2], gap [m], bias_current [A], pole_half_angle and
    angle [rad].
    """

    name: str
    shaft: tuple[ShaftSection, ...]
    discs: tuple[Disc, ...] = ()
    bearings: tuple[float, ...] = ()
    speed: float | None = None
    beam_theory: str = "timoshenko"
    source: str = ""
    assumed: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    magnets: Mapping[float, Mapping[str, float]] = field(default_factory=dict)


# Annular seals as the user writes them down: constants, tables, or the geometry from which a flow
# model computes them.


SEAL_COEFFICIENTS = ("K", "k", "C", "c", "M")
SEAL_AXES = ("pressure", "speed", "frequency")
FREQUENCY_DEPENDENCE = ("synchronous", "states")
_STRAIGHT = 1e-6  # how far a table may be off a line over the pressure, of its largest value
Friction = Annotated[
    tuple[float, float], PairOf("plain number", "coefficient, exponent", scalar=False)
]


@dataclass(frozen=True, slots=True, repr=False)
class SealTable(Part):
    """Seal coefficients on a grid: any of the axes pressure [Pa], speed [rad/s], frequency [rad/s],
    each ascending.

    values: coefficient name -> array nested in the order of ``axes``.
    """

    axes: tuple[tuple[str, tuple[float, ...]], ...]
    values: tuple[tuple[str, object], ...]

    def facts(self) -> Mapping[str, Any]:
        axes = {name: len(grid) for name, grid in self.axes}
        return {
            "axes": " x ".join(f"{size} {name}" for name, size in axes.items()),
            "values": [name for name, _ in self.values],
        }

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """The axes' names in the order of nesting, then axes and coefficients as lists, SI."""
        return {
            "axes": [name for name, _ in self.axes],
            **{key: to_plain_values(x) for key, x in (*self.axes, *self.values)},
        }


@dataclass(frozen=True, slots=True, repr=False)
class GasSealGeometry(Part):
    """An annular gas seal, smooth or with holes in its stator, from which a bulk-flow model
    computes K, k, C and c.

    Friction of a wall (coefficient, exponent) [-]: f = coefficient Re^exponent, Blasius' smooth
    wall by default. Of the gas' absolute pressures one is given; the operating point's differential
    pressure yields the other.
    """

    length: Annotated[Length, "axial length of the gap"]
    diameter: Annotated[Length, "diameter of the rotor there"]
    inlet_clearance: Annotated[Length, "radial clearance on the high-pressure side"]
    exit_clearance: Annotated[Length, "radial clearance on the low-pressure side"]
    temperature: Annotated[float, Quantity("temperature"), "temperature of the gas, absolute"]
    exit_pressure: Annotated[
        Pressure | None,
        "absolute pressure behind the seal; before it, the point's seal_pressure is added; or "
        "give inlet_pressure",
    ] = None
    inlet_pressure: Annotated[
        Pressure | None,
        "absolute pressure before the seal; behind it, the point's seal_pressure is taken off",
    ] = None
    hole_depth: Annotated[
        Length, "depth of the stator's holes or honeycomb cells; 0: a smooth seal"
    ] = 0.0
    hole_area_ratio: Annotated[Ratio, "area of the holes over the stator's"] = 0.0
    stator_friction: Annotated[
        Friction,
        "Fanning factor coefficient Re^exponent of the stator; the default is a smooth wall's",
    ] = (0.079, -0.25)
    rotor_friction: Annotated[Friction, "the same of the rotor"] = (0.079, -0.25)
    inlet_loss: Annotated[Ratio, "pressure lost at the inlet, in dynamic pressures"] = 0.1
    exit_recovery: Annotated[
        Ratio, "share of the dynamic pressure that comes back behind the exit"
    ] = 0.0
    preswirl: Annotated[
        Ratio, "circumferential speed of the gas at the inlet over the rotor's surface speed"
    ] = 0.0
    speed: Annotated[
        Rate | None, "spin speed for which the flow is computed; default: the operating point's"
    ] = None
    max_frequency: Annotated[
        Rate, "highest whirl frequency at which the coefficients may be asked for"
    ] = 9424.77796076938
    gas_constant: Annotated[
        float, Quantity("specific gas constant"), "specific gas constant; the default is air's"
    ] = 287.05
    viscosity: Annotated[
        float | None, Quantity("viscosity"), "dynamic viscosity of the gas; default: air's"
    ] = None
    compressibility: Annotated[Ratio, "compressibility factor of the gas"] = 1.0


@dataclass(frozen=True, slots=True, repr=False)
class Seal(Part):
    """An annular seal: f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x''), k > 0 drives
    forward whirl.

    A ``table`` replaces the constants it lists; a ``geometry`` replaces K, k, C and c.
    frequency_dependence of either: "synchronous" reads the coefficients at the operating point's
    whirl frequency (by default its speed) and holds them constant; "states" keeps the dependence,
    as a rational function with ``poles`` poles, two states each, in the plant and on the virtual
    rig.
    """

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    K: Annotated[Stiffness, "direct stiffness"] = 0.0
    k: Annotated[Stiffness, "cross-coupled stiffness, positive where it drives forward whirl"] = 0.0
    C: Annotated[Damping, "direct damping"] = 0.0
    c: Annotated[Damping, "cross-coupled damping"] = 0.0
    M: Annotated[Mass, "added mass"] = 0.0
    reference_pressure: Annotated[Pressure | None, "differential pressure of the coefficients"] = (
        None
    )
    scales_with_pressure: Annotated[
        tuple[str, ...],
        Choices(SEAL_COEFFICIENTS),
        "coefficients proportional to the pressure; the others stay",
    ] = ()
    table: Annotated[SealTable | None, "coefficients over pressure, speed, frequency"] = None
    geometry: Annotated[
        GasSealGeometry | None, "geometry and gas, from which K, k, C and c are computed"
    ] = None
    frequency_dependence: Annotated[
        str,
        Choice(FREQUENCY_DEPENDENCE),
        "what becomes of coefficients that depend on the whirl frequency: "
        "constants read at the point's, or states of the plant",
    ] = "synchronous"
    poles: Annotated[
        int, Count(), "poles of the rational function behind the states, two states each"
    ] = 3


def constant_under_pressure(seal: Seal) -> tuple[str, ...]:
    """The coefficients K, k, C, c of a seal that are not zero and stay as they are while others
    follow the pressure.
    """
    tabulated = {} if seal.table is None else dict(seal.table.values)
    stated = [
        name
        for name in SEAL_COEFFICIENTS
        if name != "M" and (name in tabulated or getattr(seal, name) != 0)
    ]
    follow = {
        *seal.scales_with_pressure,
        *(tabulated if seal.table and "pressure" in dict(seal.table.axes) else ()),
    }
    return tuple(name for name in stated if name not in follow) if follow & set(stated) else ()


def not_straight(seal: Seal) -> str:
    """Why, and what to do, where the seal's force is no straight line over the pressure that one
    real block could follow.
    """
    axes = {} if seal.table is None else dict(seal.table.axes)
    values = {} if seal.table is None else dict(seal.table.values)
    over_pressure = len(axes.get("pressure", ())) > 1
    points = "leave the tolerance out and give operating points at several pressures"
    if seal.geometry is not None:
        return f"the flow of [seal.geometry] is not proportional to the pressure; {points}"
    if "M" in seal.scales_with_pressure or (over_pressure and "M" in values):
        return (
            "the added mass follows the pressure, and no port of the plant carries the "
            "acceleration; keep M constant"
        )
    if not (over_pressure or seal.scales_with_pressure):
        return (
            "no coefficient of the seal follows the pressure; name those that do in "
            "scales_with_pressure"
        )
    if seal.frequency_dependence == "states" and (over_pressure or constant_under_pressure(seal)):
        return (
            "the seal's states are not proportional to the pressure; name all coefficients in "
            "scales_with_pressure"
        )
    if over_pressure:
        bent = [
            name
            for name, array in values.items()
            if not _on_a_line(axes["pressure"], array, list(axes).index("pressure"))
        ]
        if bent:
            return (
                f"not on a straight line over the pressure in [seal.table]: {', '.join(bent)}; "
                f"{points}"
            )
    return ""


def _on_a_line(grid: tuple[float, ...], array: object, axis: int) -> bool:
    """Whether a table's array is affine along one axis, to a millionth of its largest value; what
    is ill-formed passes here.
    """
    try:
        rows = np.moveaxis(np.asarray(array, dtype=float), axis, 0)
        share = (np.asarray(grid) - grid[0]) / ((grid[-1] - grid[0]) or 1.0)
        line = rows[0] + np.multiply.outer(share, rows[-1] - rows[0])
        return bool(
            np.abs(rows - line).max(initial=0.0) <= _STRAIGHT * np.abs(rows).max(initial=0.0)
        )
    except (TypeError, ValueError, IndexError):
        return True


# What a radial magnet is made of, as the machine file has it: the table [bearing.magnet].


KINDS = ("heteropolar", "e-core", "homopolar")
POLARITIES = ("NSNS", "NNSS")
BIASES = ("coil", "permanent-magnet")
POLES = {"heteropolar": (8, 12, 16), "e-core": (12,), "homopolar": (3, 4, 6, 8)}


@dataclass(frozen=True, slots=True, repr=False)
class Magnet(Part):
    """A radial magnet's poles, coils, iron and permanent magnets; its coefficients follow from the
    magnetic network (``ambrose.model.magnetics``).

    "heteropolar": poles around the journal, a quarter of them for each half-axis. "e-core": twelve
    poles, of each three the middle one twice as wide and with the coil. "homopolar": two planes of
    poles, the bias flux enters the journal in one and leaves it in the other.
    """

    kind: Annotated[str, Choice(KINDS), "how the flux runs"] = field(metadata={"required": True})
    turns: Annotated[
        float, Quantity("plain number"), "turns on one pole (e-core: on a middle pole)"
    ]
    pole_area: Annotated[
        float, Quantity("area"), "face of one pole (e-core: of a side pole; the middle one has two)"
    ]
    gap: Annotated[Length, "radial air gap at the centre"]
    poles: Annotated[
        int | None, Count(), "poles, of a homopolar magnet in one plane; default: 8, 12 or 4"
    ] = None
    polarity: Annotated[
        str, Choice(POLARITIES), "order of the poles around a heteropolar magnet"
    ] = "NSNS"
    leakage: Annotated[
        Ratio, "flux beside each gap (with a permanent magnet: beside it), over that through it"
    ] = 0.0
    iron_path: Annotated[Length | None, "length of a pole in its iron; default: ideal iron"] = None
    iron_permeability: Annotated[Ratio, "relative permeability of the iron without field"] = 3000.0
    iron_flux_density: Annotated[
        float, Quantity("magnetic flux density"), "flux density that the iron never reaches"
    ] = 1.9
    journal_radius: Annotated[Length | None, "radius of the journal, for the back iron"] = None
    back_iron_area: Annotated[
        float | None, Quantity("area"), "section of the yoke and of the journal's laminations"
    ] = None
    bias: Annotated[str, Choice(BIASES), "what drives the bias flux of a homopolar magnet"] = "coil"
    bias_turns: Annotated[
        float | None, Quantity("plain number"), "turns of the bias coil of a homopolar magnet"
    ] = None
    remanence: Annotated[
        float | None, Quantity("magnetic flux density"), "remanence of the permanent magnet"
    ] = None
    magnet_permeability: Annotated[Ratio, "relative permeability of the permanent magnet"] = 1.05
    magnet_length: Annotated[Length | None, "length of the permanent magnet along its flux"] = None
    magnet_area: Annotated[float | None, Quantity("area"), "section of the permanent magnet"] = None

    @property
    def pole_count(self) -> int:
        """The poles of one plane."""
        usual = {"heteropolar": 8, "e-core": 12, "homopolar": 4}
        return usual[self.kind] if self.poles is None else self.poles


# The touchdown bearing, as the machine file has it: the table [bearing.touchdown] with what lies
# behind its contact, and [coast_down], what slows the rotor that has landed.
#
# From the rotor outwards: contact with friction, inner race (its mass moves, it spins up), rolling
# elements, outer race, soft mount with its stop, housing. Each table is optional: without
# [bearing.touchdown.race] the rotor lands on a fixed bush.


Force = Annotated[float, Quantity("force")]
Torque = Annotated[float, Quantity("torque")]


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownRace(Part):
    """The rolling bearing of a touchdown bearing: rings and rolling elements; for landing.

    The elements carry F = K d^1.5 (Hertz, balls) at a deflection d of the rings; K is that of the
    secant stiffness element_stiffness = F/d at F = element_load.
    """

    mass: Annotated[Mass, "mass of the inner race"]
    inertia: Annotated[Inertia, "its moment of inertia about the axis"]
    element_stiffness: Annotated[Stiffness, "stiffness F/d of the rolling elements"]
    element_load: Annotated[Force, "load at which it applies"]
    preload: Annotated[Force, "radial preload"] = 0.0
    element_damping: Annotated[Damping, "their damping; the default is assumed"] = 1e3
    pitch_diameter: Annotated[Length | None, "pitch diameter; default: three times the radius"] = (
        None
    )
    friction_moment: Annotated[Torque, "friction moment without load, M_0"] = 0.0
    load_friction: Annotated[
        Ratio, "mu_b of the friction moment mu_b F d/2; the default is usual"
    ] = 0.0015
    static_capacity: Annotated[Force | None, "static load rating C_0"] = None
    specific_heat: Annotated[float, Quantity("specific heat"), "of the race; default: steel"] = (
        460.0
    )
    temperature: Annotated[float, Quantity("temperature"), "of the race before landing"] = 293.15


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownMount(Part):
    """The soft mount between outer race (or bush) and housing, with its stop; for landing."""

    mass: Annotated[Mass, "mass of outer race or bush"]
    stiffness: Annotated[Stiffness, "radial stiffness"]
    damping: Annotated[Damping, "radial damping"]
    travel: Annotated[Length | None, "way to its stop; default: none is met"] = None
    stop_stiffness: Annotated[Stiffness, "stiffness of the stop; the default is assumed"] = 1e9


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownLimits(Part):
    """What a landing may cost; a key left out is not judged."""

    landings: Annotated[int | None, Count(), "landings it must stand"] = None
    max_force: Annotated[Force | None, "largest contact force"] = None
    temperature: Annotated[
        float | None, Quantity("temperature"), "largest temperature of the race"
    ] = None
    energy: Annotated[float | None, Quantity("energy"), "slip energy of its life"] = None
    static_factor: Annotated[Ratio | None, "smallest C_0 over the largest contact force"] = None


@dataclass(frozen=True, slots=True, repr=False)
class Touchdown(Part):
    """Contact in the touchdown bearing, for the virtual rig; the defaults are assumed, not
    measured.
    """

    stiffness: Annotated[Stiffness, "contact stiffness; the default is assumed"] = 1e8
    damping: Annotated[Damping, "contact damping; the default is assumed"] = 1e4
    friction: Annotated[Ratio, "Coulomb friction; the default is assumed"] = 0.2
    radius: Annotated[Length | None, "radius of the contact; default: the shaft's there"] = None
    sliding_speed: Annotated[
        float, Quantity("velocity"), "sliding speed below which friction fades to zero"
    ] = 0.01
    static_friction: Annotated[Ratio | None, "friction at low sliding speed; default: friction"] = (
        None
    )
    stribeck_speed: Annotated[
        float, Quantity("velocity"), "sliding speed over which static_friction falls to friction"
    ] = 0.1
    race: Annotated[TouchdownRace | None, "rings and rolling elements; default: a fixed bush"] = (
        None
    )
    mount: Annotated[TouchdownMount | None, "soft mount; default: rigid"] = None
    limits: Annotated[TouchdownLimits | None, "what a landing may cost"] = None


@dataclass(frozen=True, slots=True, repr=False)
class CoastDown(Part):
    """What slows the rotor after the trip, besides its touchdown bearings; for landing."""

    brake_torque: Annotated[Torque, "braking torque of the drive"] = 0.0
    friction_torque: Annotated[Torque, "constant friction torque"] = 0.0
    windage_torque: Annotated[Torque, "windage at windage_speed; goes with its square"] = 0.0
    windage_speed: Annotated[Rate | None, "speed of windage_torque; default: the top speed"] = None


# A synchronous block of the controller: what it does to the unbalance's signal, in which band of
# speed.
#
# The amplitudes a of the block turn with the rotor: a' = (2/time_constant) T exp(-j theta) z, c =
# Re(exp(j theta) a) is added to what the controller measures; z is what the mode drives to zero
# (block_loop.py). T over speed is a table of matrices, "phase only" one angle per speed, or,
# where neither is given, one.


SYNCHRONOUS_UPDATES = ("sample", "turn")
SYNCHRONOUS_MODES = ("current-free", "force-free", "vibration-free", "damping")
SYNCHRONOUS_COORDINATES = ("axes", "tilt-translate")


@dataclass(frozen=True, slots=True, repr=False)
class Synchronous(Part):
    """A block at a harmonic of the speed: mode, band of speed, and T over speed.

    T acts on complex amplitudes, in the order of the machine's axes: matrices ``real`` + j
    ``imaginary`` at ``speeds``, linear between; or exp(j ``phase``) at ``speeds``; or, with
    neither, 1. In coordinates "tilt-translate" its rows and columns are translate_x, translate_y,
    tilt_x, tilt_y.
    """

    mode: Annotated[str, Choice(SYNCHRONOUS_MODES), "what is driven to zero"]
    band: Annotated[
        tuple[float, float],
        PairOf("angular rate", "lowest, highest", scalar=False),
        "speeds in which it is on",
    ]
    time_constant: Annotated[Time, "in which the amplitude settles, 2/eps"]
    speeds: Annotated[
        tuple[float, ...] | None, ListOf("angular rate"), "ascending speeds of the table of T"
    ] = None
    real: Annotated[Any, NestedOf("plain number"), "real part of T: speeds, rows, columns"] = None
    imaginary: Annotated[
        Any, NestedOf("plain number"), "imaginary part of T: speeds, rows, columns; default: none"
    ] = None
    phase: Annotated[
        tuple[float, ...] | None,
        ListOf("angle"),
        "the angle of T = exp(j phase) at every speed, in place of matrices",
    ] = None
    coordinates: Annotated[str, Choice(SYNCHRONOUS_COORDINATES), "of the rows and columns of T"] = (
        "axes"
    )
    harmonic: Annotated[int, Count(), "multiple of the speed"] = 1
    hysteresis: Annotated[
        Rate, "by which the speed has to be within the band before it is switched on"
    ] = 5.0
    limit: Annotated[
        Length | None, "largest amplitude of a channel; default: a quarter of the smallest gap"
    ] = None
    hold: Annotated[
        Time, "for which amplitudes are held after a fault before they are released"
    ] = 0.5
    release: Annotated[Time, "time constant in which released amplitudes decay"] = 0.2
    leak: Annotated[
        Rate, 'rate at which amplitudes fade all the time; needed by mode "damping"'
    ] = 0.0
    update: Annotated[
        str,
        Choice(SYNCHRONOUS_UPDATES),
        "when amplitudes move: every sample, or once a turn by its mean (convergent control)",
    ] = "sample"

    @property
    def gain(self) -> float:
        """eps = 2/time_constant [1/s]."""
        return 2 / self.time_constant

    def knots(self) -> tuple[float, ...]:
        """The speeds at which the table bends [rad/s]."""
        return self.speeds or ()

    def table(self, axes: int) -> tuple[np.ndarray, np.ndarray]:
        """Speeds (s,) [rad/s] and T (s, n, n) complex in the file's own coordinates; one speed
        where T is constant.
        """
        if self.speeds is None:
            turn = np.exp(1j * (self.phase[0] if self.phase else 0.0))
            return np.array([self.band[0]]), turn * np.eye(axes, dtype=complex)[None]
        speeds = np.array(self.speeds)
        if self.phase is not None:
            return speeds, np.exp(1j * np.array(self.phase))[:, None, None] * np.eye(axes)
        T = np.array(self.real, dtype=complex)
        if self.imaginary is not None:
            T = T + 1j * np.array(self.imaginary)
        return speeds, T


# What stands between the displacement and the current, as the machine file has it: [[chain]].


CHAIN_KINDS = ("demodulation", "anti-alias", "adc", "computation", "pwm")


@dataclass(frozen=True, slots=True, repr=False)
class ChainElement(Part):
    """One element of the signal chain: a dead time, or a Butterworth filter that counts in the loop
    by its delay at low frequencies.

    Together they are what the loop's delay is made of (``law.loop``); lags of sensors and
    amplifiers stand in their own tables.
    """

    name: Annotated[Name, "name, different from the other elements'"]
    kind: Annotated[str, Choice(CHAIN_KINDS), "what it is"] = field(metadata={"required": True})
    delay: Annotated[Time | None, "its dead time; or give a corner"] = None
    corner: Annotated[Rate | None, "corner frequency of a filter; or give a delay"] = None
    order: Annotated[int, Count(), "order of the filter (Butterworth)"] = 2

    @property
    def dead_time(self) -> float:
        """Its delay at low frequencies [s].

        The poles of a Butterworth filter give tau(0) = sum of -1/p = 1/(w_c sin(pi/(2 n))).
        """
        if self.corner is None:
            return self.delay or 0.0
        return 1 / (self.corner * math.sin(math.pi / (2 * self.order)))

    def phase(self, omega: float) -> float:
        """Its phase [rad] at omega [rad/s], as it is; negative: late."""
        if self.corner is None:
            return -omega * (self.delay or 0.0)
        # poles p = w_c e^{j theta}, theta = pi/2 + pi (2 k - 1)/(2 n): arg(-p/(j w - p)), summed
        total = 0.0
        for k in range(1, self.order + 1):
            angle = math.pi / 2 + math.pi * (2 * k - 1) / (2 * self.order)
            real = -self.corner * math.cos(angle)
            total -= math.atan2(omega - self.corner * math.sin(angle), real)
        return total


# What stands around the rotor, as the user writes it down: sensors, supports under bearings, modes
# of a casing.


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

    bearing: Annotated[str, Text("the name of a [[bearing]]"), "name of the bearing mounted on it"]
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


# The controller as vendors ship it: settings of a PID for all axes, or for every channel a chain of
# filter sections.
#
# A channel is a bearing axis ("A_zeta"), or with coordinates "tilt-translate" a translation, a tilt
# or a bending (``modal_channels``). Formulas and state-space forms of the sections are in
# ``law/pid.py``.


CONTROLLER_COORDINATES = ("axes", "tilt-translate")
MODES = ("translate_x", "translate_y", "tilt_x", "tilt_y")


def modal_channels(bearings: int) -> tuple[str, ...]:
    """The channels of "tilt-translate" for so many bearings: one cannot tilt, three and more bend
    as well.
    """
    bent = tuple(f"bend_{k}_{plane}" for k in range(1, bearings - 1) for plane in "xy")
    return (MODES if bearings > 1 else MODES[:2]) + bent


SECTIONS: Mapping[str, tuple[str, ...]] = {  # the keys of every kind; of a PID's those in use
    "pid": ("integral_time", "derivative_time", "derivative_filter"),
    "notch": ("zero_frequency", "zero_damping", "pole_frequency", "pole_damping"),
    "phase-bump": ("frequency", "phase", "damping"),
    "lead-lag": ("zero_frequency", "pole_frequency"),
    "low-pass": ("frequency", "damping"),
    "sos": ("numerator", "denominator"),
}


@dataclass(frozen=True, slots=True, repr=False)
class Section(Part):
    """One section of a channel's chain, of order two at most; all but "sos" have unit gain at DC (a
    PID: without its integral).

    "pid": 1 + 1/(T_i s) + T_d s/(eps T_d s + 1). "notch": (s^2/w_z^2 + 2 d_z s/w_z + 1)/(s^2/w_p^2
    + 2 d_p s/w_p + 1). "phase-bump": a notch whose zeros and poles have one damping and lie on
    either side of a frequency, turned by ``phase``. "lead-lag": (s/w_z + 1)/(s/w_p + 1).
    "low-pass": 1/(s^2/w^2 + 2 d s/w + 1). "sos": any, by coefficients of s^2, s and 1.
    """

    kind: Annotated[str, Choice(tuple(SECTIONS)), "which filter it is"]
    integral_time: Annotated[Time | None, 'T_i of a "pid"; default: no integral part'] = None
    derivative_time: Annotated[Time | None, 'T_d of a "pid"; default: no derivative part'] = None
    derivative_filter: Annotated[Ratio | None, 'eps of a "pid"; default: 0.1'] = None
    frequency: Annotated[Rate | None, 'corner w of a "low-pass", centre of a "phase-bump"'] = None
    damping: Annotated[Ratio | None, 'damping ratio of a "low-pass" or a "phase-bump"'] = None
    phase: Annotated[
        Angle | None, 'phase that a "phase-bump" adds at its frequency, negative: a lag'
    ] = None
    zero_frequency: Annotated[Rate | None, 'w_z of a "notch" or a "lead-lag"'] = None
    zero_damping: Annotated[Ratio | None, 'd_z of a "notch"'] = None
    pole_frequency: Annotated[Rate | None, 'w_p of a "notch" or a "lead-lag"'] = None
    pole_damping: Annotated[Ratio | None, 'd_p of a "notch"'] = None
    numerator: Annotated[
        tuple[float, ...] | None, ListOf("plain number"), '[b2, b1, b0] of an "sos", s in rad/s'
    ] = None
    denominator: Annotated[
        tuple[float, ...] | None, ListOf("plain number"), '[a2, a1, a0] of an "sos", s in rad/s'
    ] = None


@dataclass(frozen=True, slots=True, repr=False)
class Channel(Part):
    """A chain of filter sections, for the channels that it names; it replaces all that [controller]
    says for them.

    Names are those of the axes, or with coordinates "tilt-translate" translate_x, translate_y,
    tilt_x, tilt_y; of three bearings and more bend_1_x, bend_1_y and so on, which do nothing
    without a chain.
    """

    names: Annotated[tuple[str, ...], Texts(), "channels that it is for"]
    gain: Annotated[float, Quantity("current per displacement"), "gain of the chain"]
    sections: Annotated[tuple[Section, ...], "its sections in series"] = field(
        default=(), metadata={"key": "section"}
    )


@dataclass(frozen=True, slots=True, repr=False)
class Notch(Part):
    """A notch filter (s^2 + 2 zero_damping w s + w^2)/(s^2 + 2 pole_damping w s + w^2)."""

    frequency: Annotated[Rate, "centre frequency w"]
    pole_damping: Annotated[Ratio, "damping ratio of the poles"]
    zero_damping: Annotated[Ratio, "damping ratio of the zeros"]


@dataclass(frozen=True, slots=True, repr=False)
class PidSettings(Part):
    """The reference controller K_p (1 + 1/(T_i s) + T_d s/(eps T_d s + 1)) per axis.

    gain in the order of the machine's axes; coordinates "axes" (decentralised) or "tilt-translate";
    sample_time and delay are those of every controller that runs on the machine (``law.loop``).
    """

    gain: Annotated[
        tuple[float, ...],
        ListOf("current per displacement", scalar=True),
        "K_p, one for all axes or one per axis; not needed where every channel has a chain, nor "
        "to state sample_time and delay",
    ] = field(default=(), metadata={"required": False})
    integral_time: Annotated[Time | None, "T_i; default: no integral part"] = None
    derivative_time: Annotated[Time | None, "T_d; default: no derivative part"] = None
    derivative_filter: Annotated[Ratio, "eps"] = 0.1
    notches: Annotated[tuple[Notch, ...], "notch filters in series"] = field(
        default=(), metadata={"key": "notch"}
    )
    lead: Annotated[
        Pair | None, PairOf("angular rate", "zero, pole", scalar=False), "lead filter [zero, pole]"
    ] = None
    low_pass: Annotated[Rate | None, "corner frequency of a second-order low pass"] = None
    low_pass_damping: Annotated[Ratio, "damping ratio of the low pass"] = 0.7071067811865476
    coordinates: Annotated[str, Choice(CONTROLLER_COORDINATES), "controlled coordinates"] = "axes"
    tilt_gain: Annotated[Ratio, "gain of the tilting part relative to the translating part"] = 1.0
    sample_time: Annotated[
        Time | None, "sample time of the deployed controller; default: continuous"
    ] = None
    delay: Annotated[
        Time | None,
        "from the displacements read to the currents set, rounded up to whole samples; default: "
        "one sample",
    ] = None
    channels: Annotated[tuple[Channel, ...], "chains of filters of single channels"] = field(
        default=(), metadata={"key": "channel"}
    )
    synchronous: Annotated[tuple[Synchronous, ...], "blocks that reject the unbalance's signal"] = (
        field(default=(), metadata={"key": "synchronous"})
    )
    sample_rate: Annotated[
        float | None, Quantity("frequency"), "in place of sample_time: samples per second"
    ] = None

    def __post_init__(self) -> None:
        Part.__post_init__(self)
        rate = self.sample_rate
        if self.sample_time is None and isinstance(rate, int | float) and 0 < rate < inf:
            object.__setattr__(self, "sample_time", 1 / rate)

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """As of every part; a sample time that follows from the rate is not said a second time."""
        # slots: the class that super() means is another one
        table = super(PidSettings, self).to_dict(defaults=defaults)
        if self.sample_rate and self.sample_time == 1 / self.sample_rate:
            del table["sample_time"]
        return table
