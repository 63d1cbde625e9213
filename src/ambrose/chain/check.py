"""What a machine can do at a glance, and what about it is implausible: every doubt says cause and
remedy.

A file that is well-formed may still hold 600 for 600 mm. What a commissioning engineer would notice
on the first page is looked at here: sizes, loads against forces, gains against negative stiffness,
nodes, speeds, and what delay makes unavoidable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.chain.check_entries import block_doubts, corner_doubts, entry_doubts, load_doubts
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.judge.rotor_modes import PLANAR, whirl_measure
from ambrose.judge.stability import judge_stability
from ambrose.judge.static_stiffness import below_stiffness, stiffness_margin
from ambrose.judge.unavoidable import beyond_reach, unavoidable_sensitivity, unavoidable_words
from ambrose.law.pid import axes_mixings, channel_chains, first_settings, mixings, pid_controller
from ambrose.law.timing import machine_timing
from ambrose.machine.attachment import attached
from ambrose.machine.criteria import demand
from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.seals import Seal
from ambrose.model.assemble import assemble, attached_rotor
from ambrose.model.basis import bending_modes_of, judged_bending, modes_judged
from ambrose.model.effects.clearance import Clearance
from ambrose.model.effects.rotor import (
    STANDARD_GRAVITY,
    MassProperties,
    Rotor,
    finite_element_rotor,
    free_modes,
    mass_properties,
    mesh_error,
    plane_rows,
)
from ambrose.model.plant import Plant, top_speed
from ambrose.model.ports import measured_ports, sensor_turn
from ambrose.model.reduce import free_mode_reduction
from ambrose.model.static_load import magnet_coefficients, operating_magnets, static_sag

HERTZ = 2 * math.pi  # rad/s per Hz
# [kg], [m], [m] of rotors on magnetic bearings
_MASS = (1e-3, 5e3)
_LENGTH = (0.02, 12.0)  # [m] of a rotor; outside, a unit is probably wrong
_DIAMETER = (1e-3, 2.0)  # [m] of a shaft; outside, a unit is probably wrong
_LANDING = 0.6  # of the air gap, up to which touchdown gaps are usual (half); assumed
_RATIO = (0.3, 3.0)  # k_s gap / (k_i bias): 1 for magnets without iron
_NODE = 0.05  # of a mode's largest deflection
_SHORT = 3.0  # diameters of length that one bearing may hold
_MARGIN = 1.2  # K_p k_i / k_s below which stiffness is left to chance
_MODES = 12  # bending modes that are looked at
_APART = 1e-9  # of the squared critical speeds: no figure shows it
_COARSE = 0.01  # of a bending frequency, that the mesh may be above a finer one
_SHOWN = 3  # bending modes that are looked at in any case
_POINTS = 8  # at most, at which the reference controller is looked at


@dataclass(frozen=True, slots=True)
class Capacity:
    """What a bearing has, SI: force_per_current and negative_stiffness (the weaker, the larger
    axis), largest force of an axis (of the file, else k_i times the smaller of largest and bias
    current), what it carries of the rotor's weight on both axes and on the one that carries more,
    and the larger static current that this takes. Where no weight counts, load is its share if the
    rotor lies, and axis_load None.
    """

    name: str
    force_per_current: float
    negative_stiffness: float
    force: float
    load: float
    axis_load: float | None
    current: float


def shares(weight: float, centre: float, places: Any) -> np.ndarray:
    """What every bearing carries of the weight [N] of a rotor that lies: by levers, of more than
    two the evenest.
    """
    at = np.asarray(places, dtype=float) - centre
    if np.ptp(at) <= 0:
        return np.full(len(at), weight / len(at))
    rows = np.stack([np.ones(len(at)), at / np.ptp(at)])
    return np.abs(np.linalg.lstsq(rows, np.array([weight, 0.0]), rcond=None)[0])


def springs(machine: Machine) -> dict[str, tuple[float, float]]:
    """Stiffness K_p k_i - k_s [N/m] and damping K_p k_i T_d [N s/m] of every bearing under the
    reference controller.

    Without one under ``first_settings``. Raises InvalidInput where that has no answer.
    """
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    settings = machine.reference or first_settings(machine)
    chains = channel_chains(settings, machine.axes)
    into, out = axes_mixings(settings, machine.axes, mixings(settings, machine))
    times = np.array(
        [sum(item.derivative_time or 0.0 for item in sections) for _, sections in chains]
    )
    terms = np.array([[gain for gain, _ in chains], times * [gain for gain, _ in chains]])
    # of every axis over its own displacement
    stiffnesses = np.einsum("ic,tc,ci->ti", out, terms, into @ sensor_turn(machine).T)
    k, c = (
        (part.reshape(-1, 2)).mean(axis=1)
        for part in (stiffnesses[0] * k_i - k_s, stiffnesses[1] * k_i)
    )
    return {
        bearing.name: (float(a), float(b))
        for bearing, a, b in zip(machine.bearings, k, c, strict=True)
    }


def critical_speeds(machine: Machine, count: int = 4) -> list[float]:
    """The lowest undamped critical speeds [rad/s], forward, of the rotor on ``springs``, couplings,
    supports and films at the design point, without seals.

    (K - W^2 (M - j G)) q = 0: whirl as fast as spin; forward, or planar where a support is stiffer
    one way than the other. K is the symmetric part of the stiffness alone: the rest, a stage's q or
    a film's (K_xy - K_yx)/2, is a force along the whirl. It drives or brakes, as damping does, and
    no undamped speed is its.
    """
    rotor = finite_element_rotor(machine)
    supports = springs(machine)
    point = machine.operation.design
    bending = min(_MODES, bending_modes_of(rotor))
    bare = replace(
        machine,
        seals=tuple(Seal(item.name, item.position) for item in machine.seals),
        tolerances=(),
    )
    model = attached_rotor(bare, point, rotor, bending)
    N = model.C[: len(machine.axes)]
    extra = (
        np.repeat([supports[b.name][0] for b in machine.bearings], 2)
        + magnet_coefficients(machine, point)[1]
    )
    planes = np.kron(np.eye(2 + bending), [[0.0, 1.0], [-1.0, 0.0]])
    # parts what whirls alike either way
    apart = _APART * sla.block_diag(planes, np.zeros((model.n - len(planes),) * 2))
    stiffness = model.stiffness + N.T @ np.diag(extra) @ N
    stiffness = (stiffness + stiffness.T) / 2  # with it, roots of lightest q are complex already
    values, vectors = sla.eig(stiffness, model.mass - 1j * (model.gyroscopic + apart))
    names = tuple(f"{k}_{plane}" for k in range(2 + bending) for plane in "xy")
    forward = whirl_measure(vectors[: len(names)], names) > -PLANAR
    real = np.isfinite(values) & (np.abs(values.imag) < 1e-6 * np.abs(values)) & (values.real > 0)
    return [float(speed) for speed in np.sqrt(np.sort(values[real & forward].real))[:count]]


def _plane(shapes: np.ndarray) -> np.ndarray:
    """Mode shapes of the x plane, [w, theta] per node."""
    plane = np.empty((len(shapes) // 2, shapes.shape[1] // 2))
    plane[0::2], plane[1::2] = shapes[0::4, 0::2], shapes[3::4, 0::2]
    return plane


def capacities(machine: Machine, properties: MassProperties) -> list[Capacity]:
    weight = static_sag(machine)[1]
    loads = np.linalg.norm(weight, axis=1)
    if machine.gravity_direction is None:
        loads = shares(
            properties.mass * STANDARD_GRAVITY,
            properties.centre,
            [b.position for b in machine.bearings],
        )
    magnets = operating_magnets(machine, machine.operation.design.bias_current)
    k_i, k_s = (
        values.reshape(-1, 2) for values in magnet_coefficients(machine, machine.operation.design)
    )
    rows = []
    for number, bearing in enumerate(machine.bearings):
        current = min(bearing.max_current or bearing.bias_current, bearing.bias_current)
        force = bearing.max_force or float(k_i[number].min() * current)
        rows.append(
            Capacity(
                bearing.name,
                float(k_i[number].min()),
                float(k_s[number].max()),
                force,
                float(loads[number]),
                None if machine.gravity_direction is None else float(np.abs(weight[number]).max()),
                float(np.abs(magnets[number].currents).max()),
            )
        )
    return rows


def insight(plant: Plant) -> dict[str, Any]:
    """``doubts`` and the figures that they rest on, for `ambrose check`, SI. plant: the full one at
    the design point.
    """
    machine, rotor = plant.machine, plant.rotor_model
    properties = mass_properties(rotor)
    bending, errors = mesh_error(machine, _judged_modes(machine, rotor))
    free = {"bending_rad_s": bending.tolist(), "mesh_error": errors.tolist()}
    if not machine.bearings:
        return {
            **free,
            "bearings": [],
            "stiffness_margin": None,
            "critical_speeds_rad_s": [],
            "least_sensitivity": None,
            "doubts": [
                *_sizes(machine, properties),
                *entry_doubts(machine),
                *_mesh(bending, errors),
            ],
            "remarks": ["no magnetic bearings: ambrose lateral analyses the rotor as it stands"],
        }
    bearings = capacities(machine, properties)
    margin = stiffness_margin(machine)
    least, pole, delay = unavoidable_sensitivity(plant)
    try:
        critical = critical_speeds(machine)
    except AmbroseError:
        critical = []
    return {
        "bearings": [
            {
                "name": b.name,
                "k_i": b.force_per_current,
                "k_s": b.negative_stiffness,
                "max_force": b.force,
                "weight": b.load,
                "weight_of_axis": b.axis_load,
                "static_current": b.current,
            }
            for b in bearings
        ],
        "stiffness_margin": margin,
        "critical_speeds_rad_s": critical,
        "unstable_pole_rad_s": pole,
        "delay_s": delay,
        "least_sensitivity": least,
        **free,
        "doubts": [
            *_sizes(machine, properties),
            *entry_doubts(machine),
            *_mesh(bending, errors),
            *_forces(machine, bearings),
            *load_doubts(machine, sum(item.force for item in bearings)),
            *_stiffness(machine, margin),
            *_places(machine, rotor),
            *_operation(machine, critical),
            *_timing(machine, rotor, least, pole, delay),
            *corner_doubts(machine, critical[0] if critical else pole),
            *block_doubts(machine),
        ],
        "remarks": [*_remarks(machine), *_not_held(machine)],
    }


def _judged_modes(machine: Machine, rotor: Rotor) -> int:
    """How many bending modes lie where the sensitivity is judged; the first three in any case."""
    return min(max(len(judged_bending(machine)), _SHOWN), bending_modes_of(rotor))


def _mesh(bending: np.ndarray, errors: np.ndarray) -> Iterator[str]:
    """The mode that the mesh has furthest off."""
    worst = int(errors.argmax())
    if errors[worst] >= _COARSE:
        what = f"bending mode {worst + 1} ({bending[worst] / HERTZ:.4g} Hz)"
        yield (
            f"the mesh is too coarse: {what} is {100 * errors[worst]:.2g} % above that of a finer "
            "one; raise elements of the longest [[shaft]] sections"
        )


def _outside(value: float, span: tuple[float, float]) -> bool:
    return not span[0] <= value <= span[1]


def _sizes(machine: Machine, properties: MassProperties) -> Iterator[str]:
    remedy = "look for a length without its unit, a bare number is in metres"
    thick = max(max(item.outer_diameter, item.mass_diameter or 0.0) for item in machine.shaft)
    if _outside(properties.mass, _MASS):
        weight = f"the rotor weighs {properties.mass:,.4g} kg"
        yield f"{weight}, unheard of on magnetic bearings; {remedy}"
    if _outside(machine.length, _LENGTH):
        yield f"the rotor is {machine.length:,.4g} m long; {remedy}"
    if _outside(thick, _DIAMETER):
        yield f"the shaft is {thick:,.4g} m in diameter; {remedy}"
    for bearing in machine.bearings:
        yield from _gaps(bearing)
        yield from _touchdown(machine, bearing)
    yield from clearance_doubts(machine)


def clearance_doubts(machine: Machine) -> Iterator[str]:
    """Clearances that the rotor uses up before it lands in the touchdown bearing nearest to them: a
    radial one given for the diametral, or a diametral touchdown_gap for the radial.
    """
    landing = [bearing for bearing in machine.bearings if bearing.touchdown_gap]
    parts = [part for _, part in attached(machine) if isinstance(part, Clearance)]
    for bearing in landing:
        beside = [
            part
            for part in parts
            if min(landing, key=lambda item: abs(item.position - part.position)) is bearing
        ]
        gap = bearing.touchdown_gap or 0.0
        tight = [part for part in beside if part.diametral < 2 * gap]
        if not tight:
            continue
        # half of it would leave room, and it takes more of the air gap than is usual
        halved = all(part.diametral >= gap for part in tight)
        if halved and bearing.gap is not None and gap > _LANDING * bearing.gap:
            alike = [
                item.name
                for item in landing
                if item is not bearing and (item.touchdown_gap, item.gap) == (gap, bearing.gap)
            ]
            also = f", and so at bearing {', '.join(alike)}" if alike else ""
            each = ", ".join(f"{part.name} ({1e3 * part.diametral:,.4g} mm)" for part in tight)
            yield (
                f"touchdown_gap of bearing {bearing.name}, {1e3 * gap:,.4g} mm of an air gap of "
                f"{1e3 * bearing.gap:,.4g} mm, leaves {2e3 * gap:,.4g} mm in diameter, more than "
                f"the clearances beside it, {each}: the rotor would rub there before it lands; "
                f'touchdown_gap is radial, write "{500 * gap:.4g} mm" where it is a diametral one'
                f"{also}"
            )
            continue
        for part in tight:
            yield (
                f"the diametral clearance of {part.name}, {1e3 * part.diametral:,.4g} mm, is below "
                f"that of touchdown bearing {bearing.name}, {2e3 * gap:,.4g} mm, twice its "
                "touchdown_gap: the rotor would rub there before it lands; give the diametral "
                "clearance, not the radial one"
            )


def _touchdown(machine: Machine, bearing: MagneticBearing) -> Iterator[str]:
    """A touchdown bearing that the rotor reaches too late, or whose numbers no bearing has."""
    gap, table = bearing.touchdown_gap, bearing.touchdown
    for seal in machine.seals:
        sides = [
            getattr(seal.geometry, name, None) for name in ("inlet_clearance", "exit_clearance")
        ]
        narrowest = min((side for side in sides if side), default=math.inf)
        if gap is not None and gap > narrowest:
            yield (
                f"the touchdown gap of bearing {bearing.name}, {1e3 * gap:,.4g} mm, is above the "
                f"clearance of seal {seal.name}, {1e3 * narrowest:,.4g} mm: the rotor lands in the "
                "seal; check both"
            )
    if table is None:
        return
    if table.race is not None and table.radius is not None:
        ratio = table.race.inertia / (table.race.mass * table.radius**2)
        if _outside(ratio, (0.2, 5.0)):
            yield (
                f"the race of bearing {bearing.name} has {ratio:.3g} times the inertia of its mass "
                "at the contact's radius, where 1 to 2 are usual; check the units of the three"
            )


def _gaps(bearing: MagneticBearing) -> Iterator[str]:
    gap = bearing.gap
    if (
        gap is not None
        and bearing.geometry is None
        and bearing.magnet is None
        and bearing.force_per_current
        and bearing.negative_stiffness
    ):
        ratio = (
            bearing.negative_stiffness[0]
            * gap
            / (bearing.force_per_current[0] * bearing.bias_current)
        )
        if _outside(ratio, _RATIO):
            rule = "k_s = k_i bias / gap holds for every magnet but for its iron"
            yield (
                f"k_s of bearing {bearing.name} is {ratio:.3g} times k_i bias / gap; {rule}: check "
                "the units of the four"
            )


def _forces(machine: Machine, bearings: list[Capacity]) -> Iterator[str]:
    yield from (
        item.doubt
        for item in operating_magnets(machine, machine.operation.design.bias_current)
        if item.doubt
    )
    for item in bearings:
        what = f"bearing {item.name} reaches {item.force:,.4g} N per axis and carries "
        load = item.axis_load
        if load is None:
            if item.force <= 0.2 * item.load:
                yield (
                    f"{what}{item.load:,.4g} N of the weight if the rotor lies: check the units of "
                    "its coefficients and currents"
                )
            continue
        what += f"{load:,.4g} N of the weight on one"
        if item.force <= load:
            yield (
                f"{what}: the rotor cannot be lifted; give a stronger magnet, a larger current or "
                "another place"
            )
        elif item.force < 1.5 * load:
            yield (
                f"{what}: less than half of that is left for unbalance; three times the load is "
                "usual"
            )


def _stiffness(machine: Machine, margin: float | None) -> Iterator[str]:
    if margin is not None and margin < 1:
        yield below_stiffness(margin)
    elif margin is not None and margin < _MARGIN:
        yield (
            f"K_p k_i is only {margin:.3g} times k_s: hardly any stiffness is left; twice k_s/k_i "
            "is a good gain"
        )


def _places(machine: Machine, rotor: Rotor) -> Iterator[str]:
    places = [bearing.position for bearing in machine.bearings]
    thick = max(section.outer_diameter for section in machine.shaft)
    if len(places) == 1 and machine.length > _SHORT * thick:
        yield (
            f"one bearing cannot hold the tilting of a rotor {machine.length:.3g} m long; add a "
            "second with its sensor"
        )
    elif len(places) > 1 and np.ptp(places) < 0.05 * machine.length:
        yield (
            f"the bearings stand {1e3 * np.ptp(places):.3g} mm apart: nothing holds the rotor's "
            "tilting; check position"
        )
    modes = free_modes(rotor, min(1, bending_modes_of(rotor)))
    shape = _plane(modes.shapes)[:, 2:]
    if not shape.size:
        return
    largest = float(np.abs(shape[0::2]).max())
    what = f"the first bending mode ({modes.frequencies[-1] / HERTZ:.4g} Hz)"
    for bearing in machine.bearings:
        pairs = [pair for pair in machine.sensor_pairs if pair.bearing == bearing.name]
        at, *each = (
            plane_rows(rotor, [bearing.position, *(pair.position for pair in pairs)])[0] @ shape
        )[:, 0] / largest
        measured = sum(pair.weight * value for pair, value in zip(pairs, each, strict=True))
        if abs(measured) < _NODE:
            yield (
                f"the sensor of bearing {bearing.name} is at a node of {what} and hardly sees it; "
                "move it along the shaft"
            )
        elif at * measured < 0 and abs(at) > _NODE:
            yield (
                f"the sensor of bearing {bearing.name} is across a node of {what}: what damps "
                "other modes drives this one; "
                "move it to the bearing's side, or design with the mode in the model"
            )


def _operation(machine: Machine, critical: list[float]) -> Iterator[str]:
    low, high = machine.operation.speed_range
    for point in machine.operation.envelope:
        if high > 0 and not low - 1e-9 <= point.speed <= high * (1 + 1e-9):
            span = f"{low / HERTZ * 60:.6g} to {high / HERTZ * 60:.6g} rpm"
            turns = f"turns at {point.speed / HERTZ * 60:.6g} rpm"
            yield (
                f'operating point "{point.label}" {turns}, outside of speed_range, {span}; correct '
                "one of the two"
            )
    thick = max(section.outer_diameter for section in machine.shaft)
    tip = top_speed(machine) * thick / 2
    if tip > 700:
        yield (
            f"the shaft's surface runs at {tip:,.4g} m/s, which no steel stands; check the unit of "
            "the speed"
        )


def _timing(
    machine: Machine, rotor: Rotor, least: float, pole: float, delay: float
) -> Iterator[str]:
    timing = machine_timing(machine)
    limit = demand("maximum singular value of a sensitivity", machine.requirements).limit or 3.0
    if line := beyond_reach(least, pole, delay, limit):
        yield line
    elif least > 0.7 * limit:
        yield (
            f"{unavoidable_words(least, pole, delay)}: little is left below the {limit:g} that is "
            "asked; sample faster"
        )
    if timing is not None and timing.rate * HERTZ < 10 * max(top_speed(machine), pole):
        what = f"the {max(top_speed(machine), pole) / HERTZ:.4g} Hz of speed or unstable pole"
        rate = f"the controller runs at {timing.rate:.4g} Hz"
        yield f"{rate}, less than 10 times {what}; sample faster"


def _not_held(machine: Machine) -> Iterator[str]:
    """Operating points at which the reference controller loses the loop, as it runs: a start for
    tuning, but no controller.
    """
    if machine.reference is None:
        return
    law, timing = pid_controller(machine.reference, machine), machine_timing(machine)
    lost = []
    for point in machine.operation.envelope[:_POINTS]:
        try:
            plant = assemble(machine, point)
        except InvalidInput as error:  # outside a seal's table, or of the measured bias currents
            yield f"no model: {error}"
            continue
        modes = min(bending_modes_of(plant.rotor_model), modes_judged(plant) + _MODES)
        if not judge_stability(free_mode_reduction(plant, modes), law, timing).stable:
            lost.append(point.label)
    if lost:
        yield (
            f"the [controller] does not hold {', '.join(lost)}: tuned may start from it, method "
            "pid cannot be used there"
        )


def _remarks(machine: Machine) -> Iterator[str]:
    """What is missing and has a default, or is left out of the model: no doubts."""
    if not machine.requirements.to_dict():
        yield "no [requirements]: the standards' defaults apply"
    if machine.weights is None:
        yield "no [weights]: methods hinf, mu and polish need them"
    if machine.reference is None:
        yield "no reference controller: method pid needs one, tuned starts from a first guess"
    if machine_timing(machine) is None:
        yield (
            "no sample_time in [controller]: loops are judged as continuous unless a rate is given"
        )
    if machine.gravity_direction is None:
        yield "no gravity_direction: the rotor has no weight on the rig"
    if machine.operation.speed_range[1] == 0 and top_speed(machine) > 0:
        yield "no speed_range: nothing is judged between the operating points"
    turned = [
        p
        for p, b in zip(measured_ports(machine)[0::2], machine.bearings, strict=True)
        if p.direction != b.angle
    ]
    if turned:
        names = ", ".join(port.name.removesuffix("_zeta") for port in turned)
        yield (
            f"sensors of {names} at another angle than the magnets: y_ is along the sensors, a PID "
            "turns it to the magnets"
        )
    if not machine.tolerances:
        yield "no [[tolerance]]: what is verified holds for these very numbers"
