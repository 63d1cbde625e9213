"""What a machine can do at a glance, and what about it is implausible: every doubt says cause and
remedy.

A file that is well-formed may still hold 600 for 600 mm. What a commissioning engineer would notice
on the first page is looked at here: sizes, loads against forces, gains against negative stiffness,
nodes, speeds, and the limits that delay sets.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import AmbroseError, InvalidInput, named_failure
from ambrose.core.statespace import StateSpace, poles
from ambrose.judge.campbell import BEYOND_TOP, PLANAR, threshold_speed, whirl_measure
from ambrose.judge.loop_response import beyond_reach, unavoidable_sensitivity, unavoidable_words
from ambrose.judge.nominal import below_stiffness, stiffness_margin
from ambrose.judge.plants import judge_stability
from ambrose.law.law import extension
from ambrose.law.loop import closed_loop, machine_timing, running_law
from ambrose.law.pid import axes_mixings, channel_chains, first_settings, mixings, pid_controller
from ambrose.machine.attachment import attached
from ambrose.machine.criteria import demand
from ambrose.machine.description import MagneticBearing, OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Seal
from ambrose.machine.thrust import ThrustBearing
from ambrose.machine.units import listed
from ambrose.machine.validation.machine import least_radius
from ambrose.machine.validation.ranges import implausible, rows
from ambrose.model.assemble import (
    assemble,
    attached_rotor,
    bending_modes_of,
    constant_coefficients,
    judged_bending,
    modes_judged,
    named_point,
    seal_coefficients,
    seen_modes,
)
from ambrose.model.axial import CORNER, at_point, core_lags, rotor_mass, sides, tilt_stiffness
from ambrose.model.effect import Effect
from ambrose.model.effects.rotor import (
    STANDARD_GRAVITY,
    MassProperties,
    Rotor,
    finite_element_rotor,
    mass_properties,
    mesh_error,
)
from ambrose.model.effects.seal import celsius_for_kelvin
from ambrose.model.effects.stations import Clearance, Load, Stage
from ambrose.model.plant import Plant, measured_ports, sensor_turn, top_speed
from ambrose.model.static_load import magnet_coefficients, operating_magnets, static_sag
from ambrose.model.uncertainty import channels, free_mode_reduction, reduce_from
from ambrose.report.theme import quantity

# What `ambrose check` tells about a machine, as rows of words.


def rows_of(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """The facts of a machine (``chain.check.facts``) in words, as rows of quantity and value."""
    if not facts:
        return []
    if "axis" in facts:
        return list(axial_rows(facts, quantity))
    unstable = ", ".join(f"{re:.1f}{im + 0.0:+.1f}j" for re, im in facts["unstable_poles_rad_s"])
    margin, least = facts["stiffness_margin"], facts["least_sensitivity"]
    held = []
    if facts["bearings"]:  # nothing of a rotor that no magnet holds
        held = [
            (
                "static stiffness margin, K_p k_i / k_s",
                "no reference controller" if margin is None else f"{margin:.3g}",
            ),
            (
                "critical speeds, undamped, no cross-coupling",
                ", ".join(quantity(w, "rad/s") for w in facts["critical_speeds_rad_s"]) or "none",
            ),
            *_threshold_row(**{k: v for k, v in facts.items() if k.startswith("threshold_")}),
            (
                "lowest achievable sensitivity peak (delay)",
                "none" if least is None else f"{least:.3g}",
            ),
        ]
    return [
        ("rotor mass", quantity(facts["mass_kg"], "kg")),
        ("centre of mass", quantity(facts["centre_m"], "m")),
        (
            "inertia, diametral and polar",
            f"{facts['diametral_inertia_kg_m2']:.4g} and {facts['polar_inertia_kg_m2']:.4g} kg m²",
        ),
        *(_bearing(item) for item in facts["bearings"]),
        *held,
        ("free-free bending", ", ".join(quantity(w, "rad/s") for w in facts["bending_rad_s"])),
        ("error of the mesh in the modes that matter", _mesh(facts["mesh_error"])),
        ("unstable open-loop poles", f"{unstable} rad/s" if unstable else "none"),
        (
            "rotor states, full and reduced",
            f"{facts['rotor_states']} and {facts['reduced_rotor_states']}",
        ),
        (
            "plant states, full and reduced",
            f"{facts['plant_states']} and {facts['reduced_plant_states']}",
        ),
        ("operating points", ", ".join(facts["operating_points"])),
        ("uncertain parameters", ", ".join(facts["tolerances"]) or "none"),
        ("assumed entries", f"{facts['assumed']}, listed with their reasons in the report"),
        *((f"thrust axis: {name}", value) for name, value in rows_of(facts.get("thrust", {}))),
    ]


def _threshold_row(
    threshold_speed_rad_s: float | None = None, threshold_searched_rad_s: float | None = 0.0
) -> Iterator[tuple[str, str]]:
    found, end = threshold_speed_rad_s, threshold_searched_rad_s
    if end or found is not None:
        row = f"none up to {quantity(end or 0.0, 'rad/s')}"
        row = row if found is None else quantity(found, "rad/s") if found else "unstable at rest"
        yield "threshold speed, rotating damping, reference controller", row


def _mesh(errors: list[float]) -> str:
    if not errors:
        return "no mesh: the rotor is as measured"
    worst = max(range(len(errors)), key=errors.__getitem__)
    return f"at most {100 * errors[worst]:.2g} %, of mode {worst + 1}"


def _bearing(item: dict[str, Any]) -> tuple[str, str]:
    force = f"{item['max_force']:.4g} N per axis for {item['weight']:.4g} N of the weight"
    if item["weight_of_axis"] is not None:
        force += f", at most {item['weight_of_axis']:.4g} N on an axis"
    if item["static_current"]:
        force += f", which takes {item['static_current']:.3g} A"
    return (
        f"bearing {item['name']}",
        f"k_i {item['k_i']:.4g} N/A, k_s {item['k_s'] / 1e6:.4g} N/um, {force}",
    )


# What the axis along the shaft can do at a glance, and what about it is implausible.


# [m/s] of a steel collar's rim, assumed: a turning disc carries (3 + nu)/8 rho v^2 at its centre
# and about twice that at a bore, here 0.8 and 1.6 GPa, the strength of quenched steel
_RIM = 500.0
# [T] at which usual electrical steel leaves the straight part of its B-H curve, assumed; a magnet
# whose file gives no flux_density is computed with straight iron
_FLUX = 1.5
# static capacity over the process thrust, assumed: the rest is for what changes fast
_SPARE = 1.5


def axial_facts(machine: Machine) -> dict[str, Any]:
    """What `ambrose check file#axial` tells, SI units: mass, coefficients, core, unstable pole,
    capacity against load, doubts.

    Coefficients and poles are those of the design point, capacities and loads over all points.
    """
    part, plant = machine.thrust, assemble(machine, machine.operation.design)
    design = at_point(machine, machine.operation.design)
    mass, margin = rotor_mass(machine), stiffness_margin(machine)
    least, pole, delay = unavoidable_sensitivity(plant)
    lags = [model for model in core_lags(part) if model is not None]

    # without eddy currents m s^2 = k_s - k_c (magnet less coupling), s = sqrt((k_s - k_c)/m)
    spring = design.stiffness - part.coupling_stiffness
    rows = [at_point(machine, point) for point in machine.operation.points]
    limit = demand("sensitivity of an axis", machine.requirements).limit
    reach = "" if limit is None else beyond_reach(least, pole, delay, limit)
    return {
        "machine": machine.name,
        "description": machine.description,
        "axis": machine.axes[0],
        "mass_kg": mass,
        "at": {"point": machine.operation.design.label, "load_N": design.load},
        "k_i": design.force_per_current,
        "k_s": design.stiffness,
        # -3 dB of 1/(1 + tau sqrt(j w)) lies at tau sqrt(w) = CORNER (model/axial.py)
        "core_corner_rad_s": [
            (CORNER / side.tau) ** 2 if side.core else None for side in sides(part)
        ],
        "core_states": sum(len(model.poles) for model in lags),
        "core_error_db": max((model.gain_error for model in lags), default=0.0),
        "core_error_deg": max((model.phase_error for model in lags), default=0.0),
        "unstable_poles_rad_s": [
            [float(p.real), float(p.imag)] for p in poles(plant.rotor) if p.real > 0
        ],
        "laminated_pole_rad_s": math.sqrt(max(spring, 0.0) / mass),
        "capacity_N": [min(row.capacity[k] for row in rows) for k in (0, 1)],
        "load_N": [min(row.load for row in rows), max(row.load for row in rows)],
        "place_m": [min(row.place for row in rows), max(row.place for row in rows)],
        "static_current_A": max(abs(row.current) for row in rows),
        "tilt_stiffness_N_m_rad": -tilt_stiffness(part),
        "stiffness_margin": margin,
        "least_sensitivity": least,
        "plant_states": plant.system.n_states,
        "operating_points": [point.label for point in machine.operation.points],
        "tolerances": [item.parameter for item in machine.tolerances],
        "assumed": len(machine.assumed),
        "doubts": [
            *(line for line in implausible(machine) if line.startswith("[[thrust_bearing]]")),
            *_doubts(machine, margin),
            *([reach] if reach else []),
        ],
        "remarks": [],
    }


def along_doubts(machine: Machine) -> list[str]:
    """What is implausible along the shaft of a machine with a thrust bearing, for those who check
    the radial axes; nothing without one.
    """
    if not machine.parts(ThrustBearing):
        return []
    try:
        axial = machine.axial
        lines = [*_doubts(axial, stiffness_margin(axial))]
    except InvalidInput as error:
        lines = [str(error)]
    return [f"along the shaft: {line}" for line in lines]


def _doubts(machine: Machine, margin: float | None) -> Iterator[str]:
    """Gaps, flux, rim speed, capacity and static stiffness (``margin``, K_p k_i/k_s; None without a
    reference controller) that a machine along its shaft hardly has, a sentence each.
    """
    part = machine.thrust
    for name, side in zip(("left", "right"), sides(part), strict=True):
        # B = Phi/A at the smaller of the two poles, at the largest current of the coil
        largest_current = side.bias + (part.max_current or 0.0)
        flux = side.flux(largest_current, side.gap)
        density = flux / min(side.inner_area, side.outer_area)
        if math.isinf(side.flux_limit) and density > _FLUX:
            yield (
                f"the {name} magnet would reach {density:.3g} T at {largest_current:g} A, "
                "more than iron carries; add flux_density, or lower turns or currents"
            )
    rim = top_speed(machine) * part.collar_radius
    if rim > _RIM:
        yield (
            f"the collar's rim runs at {rim:.4g} m/s, where {_RIM:g} m/s are the end for steel; "
            "check collar_radius and speed"
        )
    for point in machine.operation.points:
        row = at_point(machine, point)
        largest = row.capacity[row.load < 0]
        if row.load and largest < _SPARE * abs(row.load):
            yield (
                f"{point.label}: {abs(row.load):,.4g} N of thrust leave little of {largest:,.4g} "
                f"N; {_SPARE:g} times the load and more is usual"
            )
    if margin is not None and margin < 1:
        yield machine.in_file(below_stiffness(margin))


def axial_rows(facts: dict[str, Any], quantity: Any) -> list[tuple[str, str]]:
    """Rows (what, value) of the table that `ambrose check` prints, from ``axial_facts``.

    quantity(value, unit): writes a number in the unit that people read, for example rad/s as Hz.
    """
    corners = [w for w in facts["core_corner_rad_s"] if w is not None]
    core = "laminated"
    if corners:
        core = f"-3 dB at {', '.join(dict.fromkeys(quantity(w, 'rad/s') for w in corners))}"
        core += f"; {facts['core_states']} states, {facts['core_error_db']:.2g} dB and "
        core += f"{facts['core_error_deg']:.2g} deg off"
    unstable = ", ".join(f"{re:.1f}" for re, _ in facts["unstable_poles_rad_s"]) or "none"
    left, right = facts["capacity_N"]
    low, high = facts["load_N"]
    margin, least = facts["stiffness_margin"], facts["least_sensitivity"]
    point, thrust = facts["at"]["point"], facts["at"]["load_N"]
    where = f"at {point or 'the design point'} under {thrust:.4g} N"
    return [
        ("rotor mass", quantity(facts["mass_kg"], "kg")),
        ("magnets", f"k_i {facts['k_i']:.4g} N/A, k_s {facts['k_s'] / 1e6:.4g} N/um, {where}"),
        ("core", core),
        (
            "unstable pole",
            f"{unstable} rad/s, laminated {facts['laminated_pole_rad_s']:.1f} rad/s",
        ),
        ("static capacity", f"{left:.4g} N to the left, {right:.4g} N to the right"),
        (
            "process thrust",
            f"{low:.4g} to {high:.4g} N, which takes {facts['static_current_A']:.3g} A",
        ),
        (
            "collar off centre by thermal growth",
            f"{1e6 * facts['place_m'][0]:.3g} to {1e6 * facts['place_m'][1]:.3g} um",
        ),
        (
            "stiffness of the collar's tilting, in the radial plant",
            f"{facts['tilt_stiffness_N_m_rad']:.4g} N m/rad",
        ),
        (
            "static stiffness margin, K_p k_i / k_s",
            "no reference controller" if margin is None else f"{margin:.3g}",
        ),
        ("lowest achievable sensitivity peak (delay)", f"{least:.3g}"),
        ("plant states", f"{facts['plant_states']}"),
        ("operating points", ", ".join(facts["operating_points"])),
        ("uncertain parameters", ", ".join(facts["tolerances"]) or "none"),
    ]


# Entries of a machine file that hardly any machine has: most often a number without its unit, or
# with another program's sign. Each a sentence with cause and remedy, for `ambrose check`.
#
# All limits below are assumed; each lies well outside of what is built, and well inside of what the
# mistake that it looks for makes of usual values.


_HERTZ = 2 * math.pi  # rad/s per Hz
_RPM = 30 / math.pi  # rpm per rad/s
# [Pa] across a seal: fans have 1 kPa and more; bar written as pascals are below up to 1000 bar
_PRESSURE = 1e3
# times the reference pressure to which coefficients are drawn in proportion
_BEYOND = 5.0
# [W] that an impeller of _IMPELLER [m] takes at least, others by the square of the diameter: a
# blower of that size in air takes kilowatts, and kilowatts written as watts are a thousandth
_POWER, _IMPELLER = 1e3, 0.1
# of its diameter, that a stage is wide at least: impellers for the smallest flow have 0.01, usual
# ones and blades 0.02 to 0.2; centimetres written as millimetres are a tenth
_NARROW = 0.006
# between the largest and the least singular value of T: axes and bearings differ by ten
_UNEVEN, _NOTHING = 1e4, 1e-12
# [rad/s] between which filters have their corners, as ranges.toml has it of their frequencies
_SLOW, _QUICK = 0.1 * _HERTZ, 1e6 * _HERTZ
# between a stage's rated speed and the machine's: about the root of 9.55 rpm per rad/s, half way to
# a mistaken unit
_SPEEDS = 3.0
# times the rotor's length and the shaft's radius, between which discs have their radius of
# gyration: flywheels have 0.44 of the one, and a disc that is solid has 0.7 of the other
_WHEEL, _CORE = 1.5, 0.2
# times its parameter that an absolute tolerance has at most: a preswirl that is hardly known makes
# a small k either way
_WIDTH = 10.0
# times what all bearings reach together: shocks may pass their static capacity, not by this
_LOAD = 10.0
# [rad/s] and times the slowest rigid mode, below both of which a stated corner is doubted:
# amplifiers and sensors are sold from 0.5 kHz on, and ten times keeps a first-order lag at the mode
# below 6 degrees. Kilohertz read as rad/s are a sixth.
_CORNER, _ABOVE = 500 * _HERTZ, 10.0


def entry_doubts(machine: Machine) -> Iterator[str]:
    """What is implausible in any number by itself, then of several together."""
    yield from implausible(machine)
    yield from _mass_diameter(machine)
    yield from _sensors(machine)
    yield from _uneven_blocks(machine)
    yield from _filter_corners(machine)
    yield from _pressures(machine)
    yield from _discs(machine)
    yield from _balanced_at(machine)
    for seal in machine.seals:
        if seal.geometry is not None and (cold := celsius_for_kelvin(seal.geometry)):
            yield f"[[seal]] {seal.name}, [seal.geometry]: {cold}"
        yield from _drives_backward(machine, seal)
    for stage in machine.parts(Stage):
        yield from _stage(machine, stage)


def _filter_corners(machine: Machine) -> Iterator[str]:
    """Sections of coefficients whose zeros or poles lie where no filter has its corner."""
    for channel in machine.controller.channels if machine.controller else ():
        for k, section in enumerate(channel.sections, 1):
            for key in ("numerator", "denominator"):
                # of a polynomial in s its roots [rad/s]; those at zero integrate or differentiate
                corners = np.abs(np.roots(getattr(section, key) or ()))
                far = corners[(corners > 0) & ((corners < _SLOW) | (corners > _QUICK))]
                if far.size:
                    yield (
                        f"[[controller.channel]] {', '.join(channel.names)}, section {k}: a root "
                        f"of its {key} lies at {far[0] / _HERTZ:.3g} Hz, where no filter has a "
                        "corner; check the order of its coefficients, of s^2, s and 1 with s in "
                        "rad/s"
                    )


def without_coefficients(machine: Machine) -> Iterator[str]:
    """Every seal and effect that has no coefficients at an operating point, with the reason."""
    for point in machine.operation.envelope:
        for seal in machine.seals:
            yield from _refusal(point, partial(constant_coefficients, machine, seal, point))
        for effect, part in attached(machine):
            if isinstance(effect, Effect):
                yield from _refusal(point, partial(effect.reaction, part, point))


def _refusal(point: OperatingPoint, read: Callable[[], object]) -> Iterator[str]:
    try:
        with named_point(point):
            read()
    except AmbroseError as error:
        yield str(error)


def load_doubts(machine: Machine, capacity: float) -> Iterator[str]:
    """Loads [N] far beyond what all bearings reach together, ``capacity`` [N]."""
    for part in machine.parts(Load):
        if part.force > _LOAD * capacity > 0:
            yield (
                f"load {part.name}, {part.force:,.6g} N, is {part.force / capacity:,.3g} times "
                f"what all bearings reach together, {capacity:,.4g} N; check its unit"
            )


def corner_doubts(machine: Machine, slowest: float) -> Iterator[str]:
    """Corners of amplifier and sensors too low for the slowest mode [rad/s] of the held rotor, in
    which it moves as a rigid body. Those of ``natural_frequency`` come from an identification
    and are left alone.
    """
    corners = {"the amplifier": machine.amplifier.bandwidth}
    corners |= {f"the sensor of bearing {item.bearing}": item.bandwidth for item in machine.sensors}
    for name, corner in corners.items():
        if corner is not None and corner < min(_CORNER, _ABOVE * slowest):
            yield (
                f"bandwidth of {name} means {corner / _HERTZ:.4g} Hz, less than {_ABOVE:g} times "
                f"the {slowest / _HERTZ:.3g} Hz at which the rotor moves as a rigid body; a bare "
                f'number is in rad/s: write "{corner:g} Hz" if that is meant'
            )


def block_doubts(machine: Machine) -> Iterator[str]:
    """Synchronous blocks that drive away what they are to bring to zero, under the reference
    controller at both ends and the middle of their bands: a T with the wrong sign or angle.
    """
    settings = machine.reference
    if settings is not None and settings.synchronous:
        yield from extension("doubts")(machine, settings)


def _uneven_blocks(machine: Machine) -> Iterator[str]:
    """T of a synchronous block that is far larger in one direction than in another."""
    settings = machine.reference
    for i, block in enumerate(() if settings is None else settings.synchronous or (), 1):
        if block.real is None or block.speeds is None:
            continue
        imaginary = 0.0 if block.imaginary is None else np.asarray(block.imaginary)
        T = np.asarray(block.real) + 1j * imaginary
        sizes = np.linalg.svd(T, compute_uv=False)  # a direction without a block has 0
        most, least = sizes.max(axis=-1), sizes.min(axis=-1)
        uneven = np.flatnonzero((most > _UNEVEN * least) & (least > _NOTHING * most)).tolist()
        if uneven:
            at = f"{block.speeds[uneven[0]] * _RPM:,.5g} rpm"
            yield (
                f"[[controller.synchronous]] {i}: T at {at} is more than {_UNEVEN:g} times larger "
                "in one direction than in another; check the exponents of real and imaginary"
            )


def _mass_diameter(machine: Machine) -> Iterator[str]:
    for number, section in enumerate(machine.shaft, 1):
        mass, outer = (min(section.diameters(0.0)[k], section.diameters(1.0)[k]) for k in (2, 0))
        if mass < outer * (1 - 1e-9):
            label = f' "{section.label}"' if section.label else ""
            yield (
                f"mass_diameter of [[shaft]] {number}{label}, {1e3 * mass:,.4g} mm, is below its "
                f"outer_diameter, {1e3 * outer:,.4g} mm: laminations add mass and take none away; "
                "check its unit"
            )


def _discs(machine: Machine) -> Iterator[str]:
    """Radii of gyration sqrt(I/m) of discs that no rotor of this length carries, or below those of
    the shaft on which they sit: mass or inertia in grams is 31.6 times off.
    """
    for disc in machine.discs:
        shaft, _ = least_radius(machine, disc.position)
        radius = math.sqrt(disc.polar_inertia / disc.mass)
        if radius > _WHEEL * machine.length or 0 < radius < _CORE * shaft:
            yield (
                f"polar_inertia and mass of disc {disc.name} give a radius of gyration of "
                f"{1e3 * radius:,.4g} mm, on a rotor {1e3 * machine.length:,.4g} mm long with "
                f"{1e3 * shaft:,.4g} mm of shaft radius there; check the units of both"
            )


def _balanced_at(machine: Machine) -> Iterator[str]:
    """Speeds of the requirements on unbalance far off the machine's: residual unbalance of a grade
    is grade over speed, so that a wrong unit makes the requirement lax or hard.
    """
    top = top_speed(machine)
    for key in ("balance_speed", "unbalance_to"):
        speed = getattr(machine.requirements, key)
        if top and speed and not top / _SPEEDS <= speed <= _SPEEDS * top:
            yield (
                f"[requirements]: {key} is {speed * _RPM:,.6g} rpm, where the machine turns at up "
                f"to {top * _RPM:,.6g} rpm; a bare number is in rad/s: check its unit"
            )


def seal_doubts(machine: Machine, mass: float) -> Iterator[str]:
    """Seal coefficients far beyond what the magnets and the rotor's mass [kg] have: a wrong
    exponent.
    """
    k_s = float(magnet_coefficients(machine, machine.operation.design)[1].sum()) / 2  # of a plane
    critical = 2 * math.sqrt(k_s * mass)  # [N s/m]: zeta = C / (2 sqrt(k m))
    sizes = {"K": k_s, "k": k_s, "C": critical, "c": critical, "M": mass}
    words = {
        "K": "the negative stiffness of all magnets",
        "C": "the rotor's critical damping on as much stiffness as the magnets' negative one",
        "M": "the rotor's mass",
    }
    for seal in machine.seals:
        for key, most in rows("relation").items():
            quantity = key.rpartition(".")[2]
            times, label = _largest(machine, seal, quantity, sizes[quantity])
            if times > most:
                yield (
                    f"{quantity} of seal {seal.name} is {times:,.3g} times "
                    f"{words.get(quantity) or words[quantity.swapcase()]} at operating point "
                    f'"{label}"; check its unit and its exponent'
                )


def _largest(machine: Machine, seal: Seal, quantity: str, size: float) -> tuple[float, str]:
    """The largest size of a coefficient over ``size``, and where; 0 where there is none."""
    found = [(0.0, "")]
    for point in machine.operation.envelope if size > 0 else ():
        with suppress(AmbroseError):  # outside its table, which is said elsewhere
            value = getattr(seal_coefficients(seal, point), quantity)
            found.append((abs(value) / size, point.label))
    return max(found)


def width_doubts(plant: Plant) -> Iterator[str]:
    """Absolute tolerances that are many times their parameter at the plant's point."""
    for tolerance in plant.machine.tolerances:
        if tolerance.absolute is None:
            continue
        # a parameter that is zero here may be anything elsewhere
        nominal = min((abs(c.nominal) for c in channels(plant, tolerance.parameter)), default=0.0)
        if 0 < _WIDTH * nominal < tolerance.absolute:
            yield (
                f"[[tolerance]] {tolerance.parameter}: absolute is "
                f"{tolerance.absolute / nominal:,.4g} times its value at {plant.point.label!r}, "
                f"{nominal:g} in SI; check its unit and its exponent"
            )


def _sensors(machine: Machine) -> Iterator[str]:
    """Sensors beside another bearing; of a bearing with several, where together they measure."""
    places = {bearing.name: bearing.position for bearing in machine.bearings}
    for name, own in places.items():
        pairs = [pair for pair in machine.sensor_pairs if pair.bearing == name]
        weight = sum(pair.weight for pair in pairs)
        if not weight:
            continue
        at = sum(pair.weight * pair.position for pair in pairs) / weight
        other = min(places, key=lambda item: abs(places[item] - at))
        if abs(places[other] - at) < abs(own - at):
            yield (
                f"the sensor of bearing {name}, at {1e3 * at:,.4g} mm, is nearer to bearing "
                f"{other}, at {1e3 * places[other]:,.4g} mm, than to its own, at {1e3 * own:,.4g} "
                "mm: that loop measures the wrong end; correct its position or its bearing"
            )


def _pressure(value: float) -> str:
    return f"{value / 1e5:,.4g} bar" if value >= _PRESSURE else f"{value:,.4g} Pa"


def _pressures(machine: Machine) -> Iterator[str]:
    """Pressures in the wrong unit, and beyond those at which coefficients hold."""
    bare = 'a bare number is in pascals: write "{:g} bar" if that is meant'
    for point in machine.operation.envelope:
        if 0 < point.seal_pressure < _PRESSURE:
            yield (
                f'operating point "{point.label}" has {_pressure(point.seal_pressure)} across its '
                f"seals; {bare.format(point.seal_pressure)}"
            )
    for seal in machine.seals:
        reference = seal.reference_pressure
        if reference is None:
            continue
        if reference < _PRESSURE:
            yield (
                f"reference_pressure of seal {seal.name} is {_pressure(reference)}; "
                f"{bare.format(reference)}"
            )
            continue
        point = max(machine.operation.envelope, key=lambda item: item.seal_pressure)
        if point.seal_pressure > _BEYOND * reference:
            yield (
                f'operating point "{point.label}" has {_pressure(point.seal_pressure)} across seal '
                f"{seal.name}, {point.seal_pressure / reference:.3g} times its reference_pressure, "
                f"{_pressure(reference)}: its coefficients are not valid so far from it; correct "
                "one of the two"
            )


def _drives_backward(machine: Machine, seal: Seal) -> Iterator[str]:
    """A stated k that brakes forward whirl; a geometry's follows from its preswirl."""
    key = f"seal.{seal.name}.k"
    if seal.geometry is not None or key in dict(machine.assumed):
        return
    found = [(k, label) for k, label in _cross_stiffness(machine, seal) if k < 0]
    if found:
        k, label = found[0]
        yield (
            f'k of seal {seal.name} is {k / 1e6:,.4g} N/um at operating point "{label}", which '
            "brakes forward whirl, as swirl against the rotation alone does; correct its sign "
            f'(k > 0 drives forward whirl), or say in [machine.assumed] under "{key}" why it is so'
        )


def _cross_stiffness(machine: Machine, seal: Seal) -> Iterator[tuple[float, str]]:
    for point in machine.operation.envelope:
        if point.seal_pressure > 0:
            try:
                yield seal_coefficients(seal, point).k, point.label
            except InvalidInput:  # outside its table, which is said elsewhere
                continue


def _stage(machine: Machine, stage: Stage) -> Iterator[str]:
    shaft, section = least_radius(machine, stage.position)
    if stage.diameter < 2 * shaft:
        yield (
            f"stage {stage.name} is {1e3 * stage.diameter:,.4g} mm in diameter, less than the "
            f"shaft there, {2e3 * shaft:,.4g} mm ({section}); correct its diameter or position"
        )
    speeds: Sequence[float] = sorted(
        speed
        for speed in (
            machine.operation.speed_range[1],
            *(point.speed for point in machine.operation.envelope),
        )
        if speed > 0
    )
    if not speeds:
        return
    least = _POWER * min(1.0, (stage.diameter / _IMPELLER) ** 2)
    if stage.power < least:
        yield (
            f"stage {stage.name} of {1e3 * stage.diameter:,.4g} mm in diameter takes "
            f"{stage.power:,.4g} W, where {least:,.0f} W and more are usual; a bare number is "
            f'in watts: write "{stage.power:g} kW" if that is meant'
        )
    if stage.width < _NARROW * stage.diameter:
        yield (
            f"stage {stage.name} is {1e3 * stage.width:,.3g} mm wide and "
            f"{1e3 * stage.diameter:,.4g} mm in diameter, where a hundredth of that and more is "
            "usual; check the unit of its width"
        )
    if not speeds[0] / _SPEEDS <= stage.speed <= _SPEEDS * speeds[-1]:
        span = " to ".join(dict.fromkeys(f"{x * _RPM:,.6g}" for x in (speeds[0], speeds[-1])))
        yield (
            f"stage {stage.name} is rated at {stage.speed * _RPM:,.6g} rpm, where the machine "
            f"turns at {span} rpm; a bare number is in rad/s: write "
            f'"{stage.speed:g} rpm" if that is meant'
        )


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
                *_mesh_of_check(bending, errors),
            ],
            "remarks": ["no magnetic bearings: ambrose lateral analyses the rotor without control"],
        }
    bearings = capacities(machine, properties)
    margin = stiffness_margin(machine)
    least, pole, delay = unavoidable_sensitivity(plant)
    try:
        critical = critical_speeds(machine)
    except AmbroseError:
        critical = []
    threshold = _threshold(machine)
    return {
        **threshold,
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
            *_mesh_of_check(bending, errors),
            *seal_doubts(machine, properties.mass),
            *width_doubts(plant),
            *_forces(machine, bearings),
            *load_doubts(machine, sum(item.force for item in bearings)),
            *_stiffness(machine, margin),
            *_places(machine, rotor),
            *_operation(machine, critical),
            *_driven(machine, **threshold),
            *_timing(machine, rotor, least, pole, delay),
            *corner_doubts(machine, critical[0] if critical else pole),
            *block_doubts(machine),
        ],
        "remarks": [
            *_remarks(machine),
            *_higher_modes(machine, rotor),
            *_not_held(machine),
        ],
    }


def _judged_modes(machine: Machine, rotor: Rotor) -> int:
    """How many bending modes lie where the sensitivity is judged; the first three in any case."""
    return min(max(len(judged_bending(machine)), _SHOWN), bending_modes_of(rotor))


def _mesh_of_check(bending: np.ndarray, errors: np.ndarray) -> Iterator[str]:
    """The mode that the mesh has furthest off, of a rotor that has one."""
    worst = int(errors.argmax()) if errors.size else 0
    if errors.size and errors[worst] >= _COARSE:
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
    parts = machine.parts(Clearance)
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
            f"K_p k_i is only {margin:.3g} times k_s: almost no stiffness is left; twice k_s/k_i "
            "is a good gain"
        )


def _places(machine: Machine, rotor: Rotor) -> Iterator[str]:
    places = [bearing.position for bearing in machine.bearings]
    thick = max(section.outer_diameter for section in machine.shaft)
    if len(places) == 1 and machine.length > _SHORT * thick:
        yield (
            f"one bearing cannot carry the tilting of a rotor {machine.length:.3g} m long; add a "
            "second with its sensor"
        )
    elif len(places) > 1 and np.ptp(places) < 0.05 * machine.length:
        yield (
            f"the bearings stand {1e3 * np.ptp(places):.3g} mm apart: nothing carries the "
            "rotor's tilting; check position"
        )
    for bearing, _, frequency, _, measured in seen_modes(machine, 1):
        if abs(measured) < _NODE:
            yield (
                f"the sensor of bearing {bearing} is at a node of {_first(frequency)} and barely "
                "measures it; move it along the shaft"
            )
    yield from sensors_across(machine)


def _first(frequency: float) -> str:
    return f"the first bending mode ({frequency / HERTZ:.4g} Hz)"


def sensors_across(machine: Machine) -> Iterator[str]:
    """The doubts of sensors' places that a controller which passes `verify` answers."""
    for bearing, _, frequency, at, measured in seen_modes(machine, 1):
        if at * measured < 0 and abs(at) > _NODE and abs(measured) >= _NODE:
            yield (
                f"the sensor of bearing {bearing} is across a node of {_first(frequency)}: what "
                "damps other modes drives this one; move it to the bearing's side, or verify a "
                "controller that was designed with this mode"
            )


def _higher_modes(machine: Machine, rotor: Rotor) -> Iterator[str]:
    """The bending modes above the first, as far as the loop reaches, that a magnet hardly moves, or
    that it and its sensor see with opposite signs: a design needs them in its model.
    """
    corner = machine.amplifier.bandwidth or machine.amplifier.natural_frequency or np.inf
    count = int((judged_bending(machine) <= corner).sum())
    modes: dict[str, list[str]] = {}
    for bearing, mode, frequency, at, measured in seen_modes(machine, count):
        if mode > 1 and (what := _seen_at(bearing, at, measured)):
            modes.setdefault(what, []).append(f"{mode} ({frequency / HERTZ:.4g} Hz)")
    if modes:
        words = [f"{what} in mode {_some(names)}" for what, names in modes.items()]
        yield f"bending: {'; '.join(words)}: a design needs these modes in its model"


def _seen_at(bearing: str, at: float, measured: float) -> str:
    """What bars a mode at a bearing, "" for nothing; deflections as ``seen_modes`` has them."""
    if abs(at) < _NODE or abs(measured) < _NODE:
        return f"a node at {'magnet' if abs(at) < _NODE else 'sensor'} {bearing}"
    return f"magnet and sensor {bearing} move oppositely" if at * measured < 0 else ""


def free_mode_rows(machine: Machine, count: int) -> list[tuple[str, str, str]]:
    """The lowest ``count`` bending modes of the free rotor at rest: number, frequency, and what
    bars them at a bearing.
    """
    rows = dict[int, tuple[float, list[str]]]()
    for bearing, mode, frequency, at, measured in seen_modes(machine, count):
        told = rows.setdefault(mode, (frequency, []))[1]
        told += [what] if (what := _seen_at(bearing, at, measured)) else []
    return [
        (str(mode), quantity(frequency, "rad/s"), "; ".join(told))
        for mode, (frequency, told) in rows.items()
    ]


def _some(names: list[str]) -> str:
    """The first of them, and how many more."""
    rest = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {rest} more" if rest > 0 else "")


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
            f"the shaft's surface runs at {tip:,.4g} m/s, which no steel withstands; check the "
            "unit of the speed"
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
            f"{unavoidable_words(least, pole, delay)}: the limit of {limit:g} leaves little "
            "margin; sample faster"
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
            f"the [controller] is unstable at {', '.join(lost)}: use method tuned, which may start "
            "from it, not method pid"
        )


def _threshold(machine: Machine) -> dict[str, float | None]:
    """The threshold speed [rad/s] of the loop under the reference controller, None for none, and
    how far it was looked for; nothing where no damping turns with the rotor.
    """
    if not machine.rotating_share or machine.reference is None:
        return {}
    law, timing = pid_controller(machine.reference, machine), machine_timing(machine)
    design = assemble(machine, machine.operation.design)
    top = machine.operation.running[1] or top_speed(machine)
    # what whirls slower than the spin is driven
    driven = int((judged_bending(machine) <= 2 * BEYOND_TOP * top).sum())
    modes = min(bending_modes_of(design.rotor_model), driven + _MODES)

    def loop_at(speed: float) -> StateSpace:
        # of a plant the reduction takes machine and point
        at = replace(design, point=replace(design.point, speed=speed))
        plant = free_mode_reduction(at, modes)
        return closed_loop(plant, running_law(law, plant, timing))

    found, end = threshold_speed(loop_at, 0.0, BEYOND_TOP * top)
    return {"threshold_speed_rad_s": found, "threshold_searched_rad_s": end}


def _driven(
    machine: Machine,
    threshold_speed_rad_s: float | None = None,
    threshold_searched_rad_s: float | None = 0.0,
) -> Iterator[str]:
    """Rotating damping whose threshold speed lies where the machine runs."""
    found, top = threshold_speed_rad_s, machine.operation.running[1] or top_speed(machine)
    if found is not None and 0 < found <= top:
        yield (
            f"under the [controller] the threshold speed of the rotating damping, "
            f"{found * _RPM:,.4g} rpm, is below the top speed, {top * _RPM:,.4g} rpm: above it "
            "forward whirl grows; damp that mode in the loop, or correct rotating_share"
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
            "no sample_time in [controller]: the loop is checked as continuous unless a rate is "
            "given"
        )
    if machine.gravity_direction is None:
        yield "no gravity_direction: the rotor has no weight on the rig"
    low, high = machine.operation.running
    if machine.operation.speed_range[1] == 0 and top_speed(machine) > 0:
        yield (
            f"no speed_range: it is taken to run from {low * _RPM:,.6g} to {high * _RPM:,.6g} rpm, "
            "as its points turn"
            if high
            else "no speed_range: nothing is checked between the operating points"
        )
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
        yield "no [[tolerance]]: a verification covers these values alone"


def facts(machine: Machine, file: str | None = None, axes: str | None = None) -> dict[str, Any]:
    """What `ambrose check` tells about a machine, SI units: mass properties, bending frequencies,
    open-loop poles, sizes.

    file: what a failure is named after; default: the machine. axes: the one group of axes (None:
    all, those of the thrust axis under "thrust"). Raises InvalidInput where a point has
    no model, NumericalFailure where numbers are too far apart, with every part without coefficients
    at an operating point, and every entry that is implausible, its probable cause.
    """
    try:
        # what overflows on the way is no figure
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            known = _facts(machine)
            for along in [*machine.groups.values()][1:] if axes is None else ():
                with suppress(InvalidInput):  # which is among the doubts
                    of_axis = _facts(along)
                    known["thrust"] = {k: v for k, v in of_axis.items() if k not in _TOLD}
            return known
    except AmbroseError as error:
        raise type(error)(listed(file or machine.name, _reasons(machine, str(error)))) from error


_TOLD = ("doubts", "remarks")  # of the thrust axis, among those of the machine


def _reasons(machine: Machine, failure: str) -> list[str]:
    """The failure, or all that are like it, and what may be its cause."""
    if not machine.lateral:
        return [failure]
    found = [*without_coefficients(machine)]
    found = found if failure in found else [failure, *found]
    return [*found, *(line for line in entry_doubts(machine) if line not in "".join(found))]


@named_failure("the model of the machine")
def _facts(machine: Machine) -> dict[str, Any]:
    if not machine.lateral:
        return axial_facts(machine)
    rotor = finite_element_rotor(machine)
    properties = mass_properties(rotor)
    plant = assemble(machine)
    reduced = reduce_from(plant, 0)
    values = poles(plant.rotor)
    known = {
        "machine": machine.name,
        "description": machine.description,
        "mass_kg": properties.mass,
        "centre_m": properties.centre,
        "diametral_inertia_kg_m2": properties.diametral_inertia,
        "polar_inertia_kg_m2": properties.polar_inertia,
        "unstable_poles_rad_s": [[float(p.real), float(p.imag)] for p in values if p.real > 0],
        "rotor_states": plant.rotor.n_states,
        "plant_states": plant.system.n_states,
        "reduced_rotor_states": reduced.rotor.n_states,
        "reduced_plant_states": reduced.system.n_states,
        "operating_points": [point.label for point in machine.operation.envelope],
        "tolerances": [tolerance.parameter for tolerance in machine.tolerances],
        "assumed": len(machine.assumed),
        **insight(
            plant
            if machine.operation.design is plant.point
            else assemble(machine, machine.operation.design)
        ),
    }
    known["doubts"] = [*known["doubts"], *along_doubts(machine)]
    return known
