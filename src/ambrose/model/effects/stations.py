"""Thrust bearing: along the shaft an axis of its own (``ambrose.model.axial``); against the radial
motion the negative stiffness of its collar's tilting.

The moment k_t phi_t on the collar (``magnet.tilt_stiffness``) acts as two equal and opposite forces
at its faces, a thickness t apart: f = K (q_left, q_right) with K = k_t/t^2 [[1, -1], [-1, 1]] in
each plane, and phi_t = (q_right - q_left)/t.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.machine.attachment import TILTED, Station
from ambrose.machine.description import Coupling, MachineDescription, OperatingPoint
from ambrose.machine.kinds import Angle, Choice, Length, ListOf, Name, Quantity, Rate, Ratio, Time
from ambrose.machine.machine import axial_machine
from ambrose.machine.part import Part
from ambrose.machine.thrust import ThrustBearing
from ambrose.machine.units import as_written, complaint
from ambrose.machine.validation.machine import findings
from ambrose.machine.validation.parts import not_positive
from ambrose.model.effect import Action, Effect, Reaction

# Probe: a place on the rotor whose motion is wanted, in x and y. It pulls at nothing.
#
# The rotor has ports there: what the plant can be pushed at, and whose displacement it gives.


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


# Flexible coupling to ground: f = -stiffness x - damping x' on the rotor, in the coupling's axes.


def matrices(coupling: Coupling) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (2, 2) [N/m] and damping (2, 2) [N s/m] in (zeta, eta). Raises InvalidInput for
    figures that are not finite.
    """
    stiffness = check_shape(coupling.stiffness, f"the stiffness of coupling {coupling.name}", "(2)")
    damping = check_shape(coupling.damping, f"the damping of coupling {coupling.name}", "(2)")
    return np.diag(stiffness.astype(float)), np.diag(damping.astype(float))


def _reaction(coupling: Coupling, point: OperatingPoint) -> Reaction:
    return Reaction(*matrices(coupling))


def _findings(where: str, coupling: Coupling) -> Iterator[str]:
    remedy = "a passive coupling holds back"
    yield from not_positive(where, coupling, remedy, "stiffness", "damping", zero=True)


def _actions(coupling: Coupling, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    """-stiffness q, or -damping q', along either axis."""
    signal = "q" if quantity == "stiffness" else "qdot"
    for axis, value in zip(TILTED, getattr(coupling, quantity), strict=True):
        port = f"{coupling.name}_{axis}"
        yield Action(port, float(value), ((f"{signal}_{port}", -1.0),))


COUPLING = Effect(
    table="coupling",
    part=Coupling,
    findings=_findings,
    quantities={"stiffness": ("stiffness", TILTED), "damping": ("damping", TILTED)},
    reaction=_reaction,
    actions=_actions,
)


# Journal bearing: the oil film's force, f = -([[K_xx, K_xy], [K_yx, K_yy]] q + [[C_xx, C_xy],
# [C_yx, C_yy]] q') on the rotor, in x and y.
#
# q is the journal's displacement from where it rests under its load; the coefficients are those of
# a table over the spin speed, as bearing programs write it, linear between its speeds. With x the
# horizontal and y the vertical axis K_xy > 0 > K_yx drives forward whirl. A film at rest carries
# nothing, so nothing is extrapolated.


_ENTRIES = ("xx", "xy", "yx", "yy")
_SLACK = 1e-9  # of the highest speed: what rounding of units may add

_Stiffnesses = Annotated[tuple[float, ...], ListOf("stiffness", scalar=True)]
_Dampings = Annotated[tuple[float, ...], ListOf("damping", scalar=True)]


@dataclass(frozen=True, slots=True, repr=False)
class JournalBearing(Part):
    """A journal bearing: stiffness and damping of its oil film over the speed."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    K_xx: Annotated[_Stiffnesses, "force along -x per displacement along x, one per speed"]
    K_yy: Annotated[_Stiffnesses, "the same along y"]
    C_xx: Annotated[_Dampings, "force along -x per velocity along x, one per speed"]
    C_yy: Annotated[_Dampings, "the same along y"]
    speed: Annotated[
        tuple[float, ...],
        ListOf("angular rate"),
        "spin speeds of the table, ascending; left out for one row that holds at every speed",
    ] = ()
    K_xy: Annotated[_Stiffnesses, "force along -x per displacement along y; default: 0"] = ()
    K_yx: Annotated[_Stiffnesses, "force along -y per displacement along x; default: 0"] = ()
    C_xy: Annotated[_Dampings, "force along -x per velocity along y; default: 0"] = ()
    C_yx: Annotated[_Dampings, "force along -y per velocity along x; default: 0"] = ()


def coefficients(bearing: JournalBearing, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness K (2, 2) [N/m] and damping C (2, 2) [N s/m] at a spin speed [rad/s], in (x, y).

    Raises InvalidInput for a speed outside the table.
    """
    grid = np.asarray(bearing.speed, dtype=float)
    if len(grid):
        slack = _SLACK * grid[-1]
        if not grid[0] - slack <= speed <= grid[-1] + slack:
            raise invalid(
                f"the speed of journal bearing {bearing.name}",
                as_written(speed, "speed"),
                f"within its table, {as_written(grid[0], 'speed', False)} to "
                f"{as_written(grid[-1], 'speed')}",
                "extend the table or choose an operating point inside",
            )

    def at(letter: str, entry: str) -> float:
        column = getattr(bearing, f"{letter}_{entry}")
        if not column:
            return 0.0
        return float(np.interp(speed, grid, column)) if len(grid) else float(column[0])

    K, C = (np.array([at(letter, e) for e in _ENTRIES]).reshape(2, 2) for letter in "KC")
    return K, C


def _film_findings(where: str, bearing: JournalBearing) -> Iterator[str]:
    rows = len(bearing.speed) or 1
    for key in (f"{letter}_{entry}" for letter in "KC" for entry in _ENTRIES):
        column = getattr(bearing, key)
        required = key[2] == key[3]
        if len(column) != rows and (column or required):
            wanted = f"a list of {rows}, one per speed"
            remedy = "complete the table, or leave speed out for one row"
            yield complaint(where, key, f"a list of {len(column)}", wanted, remedy)
    if min(bearing.speed, default=0.0) < 0 or np.any(np.diff(bearing.speed) <= 0):
        remedy = "sort the rows by speed and keep one of each"
        yield complaint(where, "speed", "not ascending", "ascending, none negative", remedy)


def _film_reaction(bearing: JournalBearing, point: OperatingPoint) -> Reaction:
    return Reaction(*coefficients(bearing, point.speed))


def _film_actions(
    bearing: JournalBearing, point: OperatingPoint, quantity: str
) -> Iterator[Action]:
    """-K_rc q_c, or -C_rc q'_c, along r."""
    row, column = quantity[2], quantity[3]
    matrix = coefficients(bearing, point.speed)[quantity[0] == "C"]
    nominal = float(matrix["xy".index(row), "xy".index(column)])
    signal = "q" if quantity[0] == "K" else "qdot"
    yield Action(f"{bearing.name}_{row}", nominal, ((f"{signal}_{bearing.name}_{column}", -1.0),))


JOURNAL_BEARING = Effect(
    table="journal_bearing",
    part=JournalBearing,
    findings=_film_findings,
    quantities={
        f"{letter}_{entry}": (dimension, ())
        for letter, dimension in (("K", "stiffness"), ("C", "damping"))
        for entry in _ENTRIES
    },
    on_stator=True,
    carries=True,
    reaction=_film_reaction,
    over_speed=True,
    knots=lambda bearing: bearing.speed,
    actions=_film_actions,
)


# Load: a radial force on the rotor that the magnets must carry beside weight and unbalance: a
# lasting one, an impulse, or a surge. It pulls at nothing in the model of the machine; load
# capacity (``judge.unbalance``, the lateral report, ``size``) holds the magnets against it.
#
#     static    f(t) = F
#     impulse   f(t) = F sin(pi t/T),  0 <= t <= T        duration T
#     surge     f(t) = F sin(w t)                         frequency w


STATIC = "static"
IMPULSE, SURGE = "impulse", "surge"
_NEEDS = {STATIC: None, IMPULSE: "duration", SURGE: "frequency"}


@dataclass(frozen=True, slots=True, repr=False)
class Load(Part):
    """A force that the magnets must be able to carry."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    kind: Annotated[
        str, Choice(tuple(_NEEDS)), "static (lasting), impulse (half a sine) or surge (a sine)"
    ]
    force: Annotated[float, Quantity("force"), "its amplitude, zero to peak"]
    duration: Annotated[Time | None, "of the half sine, of an impulse"] = None
    frequency: Annotated[Rate | None, "of the sine, of a surge"] = None
    direction: Annotated[
        Angle | None, "from the global x towards y; default: the worst one for every axis"
    ] = None


def _findings_of_load(where: str, part: Load) -> Iterator[str]:
    yield from not_positive(where, part, "give what the machine must withstand", "force")
    needed = _NEEDS[part.kind]
    for key in ("duration", "frequency"):
        value = getattr(part, key)
        if key == needed and value is None:
            yield complaint(where, key, "missing", f"given for kind '{part.kind}'", "add it")
        elif key != needed and value is not None:
            yield complaint(where, key, "given", f"left out for kind '{part.kind}'", "remove it")
        elif value is not None:
            yield from not_positive(where, part, "it is a time or a rate", key)


LOAD = Effect(
    table="load",
    part=Load,
    findings=_findings_of_load,
    most=20,
    symbol="load",
    reach=34.0,
    reaction=no_reaction,
)


# Clearance: a place where rotor and stator must not touch: a labyrinth, an impeller eye, a motor's
# air gap. It pulls at nothing; reports hold the rotor's motion there against it.
#
# Seals are held against what their own table says (``clearance`` of a bulk-flow seal), touchdown
# bearings against their gap: neither needs a row here.


LARGEST = 0.05  # [m], diametral: beyond any running clearance of a rotor


@dataclass(frozen=True, slots=True, repr=False)
class Clearance(Part):
    """A running clearance that must not be used up."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    diametral: Annotated[Length, "diametral running clearance: bore minus journal, hot and turning"]
    limit_share: Annotated[Ratio, "share of it that peak-to-peak motion may take"] = 0.75


def _findings_of_clearance(where: str, part: Clearance) -> Iterator[str]:
    yield from not_positive(where, part, "give the clearance as built", "diametral", "limit_share")
    if part.diametral > LARGEST:
        remedy = "a bare number is in metres: write the unit, such as 0.4 mm"
        yield complaint(
            where,
            "diametral",
            f"{part.diametral:g} m",
            f"at most {LARGEST:g} m",
            remedy,
        )
    if part.limit_share > 1:
        yield complaint(
            where, "limit_share", f"{part.limit_share:g}", "at most 1", "0.75 is usual (API 617)"
        )


CLEARANCE = Effect(
    table="clearance",
    part=Clearance,
    findings=_findings_of_clearance,
    most=100,
    symbol="clearance",
    reach=10.0,
    reaction=no_reaction,
)


# Unbalance: the force of a mass off the shaft's centre line while the rotor turns, at any speed
# profile.
#
# The mass m at radius e and angle theta + phase sits at e (cos, sin); minus m times its
# acceleration acts on the rotor. The linear view at constant speed is the rotating force m e
# Omega^2 (verify and simulate.linear use that); here the angular acceleration adds the tangential
# part.


def linearised(amount: float, speed: float) -> complex:
    """The force m e Omega^2 [N] as a phasor on exp(j Omega t): along x as it stands, along y times
    -j.

    amount m e [kg m]; speed [rad/s], constant.
    """
    return complex(amount * speed**2)


def force(
    angle: float, speed: float, acceleration: float, p: tuple[float, ...]
) -> tuple[float, float]:
    """Force (x, y) [N] on the rotor at a spin angle [rad], speed [rad/s] and angular acceleration
    [rad/s2].

    p: (amount m e [kg m], phase [rad] of the mass from x at angle zero). Compiles with numba as it
    stands.
    """
    cosine, sine = math.cos(angle + p[1]), math.sin(angle + p[1])
    radial, tangential = p[0] * speed * speed, p[0] * acceleration
    return radial * cosine + tangential * sine, radial * sine - tangential * cosine


# Stage: the aerodynamic cross-coupling of an impeller or a row of blades,
#
#     f = -[[0, q], [-q, 0]] (x, y),    q > 0 drives forward whirl.
#
# Rated stiffness (Wachel & von Nimitz 1981 for impellers, Alford 1965 for blade rows), as API 617
# takes it for its Level I stability analysis (recalled), with torque = power/speed:
#
#     radial  q = 3.0 torque (rho_d/rho_s) / (D H)      D, H: impeller's diameter, narrowest width
#     axial   q = 1.5 torque / (D H)                    D, H: mean diameter, blade height
#
# The usual form, q [kN/mm] = P [W] B 9.55 (rho_d/rho_s) / (D [mm] H [mm] N [rpm]), is this one:
# 9.55 = 30/pi. At another speed power goes with its cube (affinity laws), so that q goes with its
# square; at rest nothing is left.


KINDS = ("radial", "axial")
_BETA = {"radial": 3.0, "axial": 1.5}
_DIAMETER = (0.01, 5.0)  # [m]: outside of it a unit was forgotten


@dataclass(frozen=True, slots=True, repr=False)
class Stage(Part):
    """An impeller or a row of blades that does work on the gas."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    power: Annotated[float, Quantity("power"), "rated power that the stage takes"]
    speed: Annotated[Rate, "speed at that power"]
    diameter: Annotated[Length, "impeller diameter; of blades the mean diameter"]
    width: Annotated[
        Length, "least of impeller discharge width and diffuser width; of blades their height"
    ]
    density_ratio: Annotated[
        Ratio, "gas density at discharge over that at suction; not used of blades"
    ] = 1.0
    kind: Annotated[str, Choice(KINDS), "radial (impeller) or axial (blades)"] = "radial"


def rated_cross_coupling(stage: Stage) -> float:
    """q [N/m] at the rated speed, the formula of this file's head."""
    torque = stage.power / stage.speed
    density = stage.density_ratio if stage.kind == "radial" else 1.0
    return _BETA[stage.kind] * torque * density / (stage.diameter * stage.width)


def cross_coupling(stage: Stage, speed: float) -> float:
    """q [N/m] at a speed [rad/s]: of the rated one, by the square of the speeds' ratio."""
    return rated_cross_coupling(stage) * (speed / stage.speed) ** 2


def _findings_of_stage(where: str, stage: Stage) -> Iterator[str]:
    sizes = ("power", "speed", "diameter", "width", "density_ratio")
    yield from not_positive(where, stage, "give what the stage was rated for", *sizes)
    low, high = _DIAMETER
    if not low <= stage.diameter <= high:
        yield complaint(
            where,
            "diameter",
            f"{stage.diameter:g} m",
            f"from {low:g} to {high:g} m",
            "a bare number is in metres: write the unit, such as 400 mm",
        )
    if stage.width >= stage.diameter:
        yield complaint(
            where,
            "width",
            f"{stage.width:g} m",
            f"below the diameter, {stage.diameter:g} m",
            "it is the narrowest axial width of the flow at discharge",
        )
    if 0 < stage.density_ratio < 1:
        yield complaint(
            where,
            "density_ratio",
            f"{stage.density_ratio:g}",
            "at least 1",
            "it is discharge over suction",
        )


def _reaction_of_stage(stage: Stage, point: OperatingPoint) -> Reaction:
    q = cross_coupling(stage, point.speed)
    return Reaction(np.array([[0.0, q], [-q, 0.0]]), np.zeros((2, 2)))


def _actions_of_stage(stage: Stage, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    """Where q acts: f_x = -q y and f_y = +q x."""
    q = cross_coupling(stage, point.speed)
    yield Action(f"{stage.name}_x", q, ((f"q_{stage.name}_y", -1.0),))
    yield Action(f"{stage.name}_y", q, ((f"q_{stage.name}_x", 1.0),))


STAGE = Effect(
    table="stage",
    part=Stage,
    findings=_findings_of_stage,
    quantities={"cross_coupling": ("stiffness", ())},
    most=40,
    symbol="stage",
    reach=18.0,
    reaction=_reaction_of_stage,
    over_speed=True,
    actions=_actions_of_stage,
)


def _stations(part: ThrustBearing) -> tuple[Station, ...]:
    half = part.collar_thickness / 2
    return (
        Station(f"{part.name}_left", part.position - half),
        Station(f"{part.name}_right", part.position + half),
    )


def _reaction_of_thrust_bearing(part: ThrustBearing, point: OperatingPoint) -> Reaction:
    """f = -K q with the negative stiffness in K; ports left x, y, right x, y."""
    # a file without a thrust bearing is read without its mathematics
    from ambrose.model.axial import tilt_stiffness

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
    reaction=_reaction_of_thrust_bearing,
    actions=_no_action,
    axis=axial_machine,
)


# What bearings and seals stand on: every support and every mode of the casing as coordinates of
# second order.
#
# q'' + 2 d w q' + w^2 q = -row . f, f [N] the force of stator on rotor; the stator moves by row q.
# A support is two coordinates, one per direction, of its own mass; the receptances of all that
# moves one stator add.


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
