"""What the parts of a machine must fulfil: shaft, discs, bearings, sensors, amplifier, couplings,
each on its own.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, get_args

from ambrose.machine.attachment import attached
from ambrose.machine.description import (
    AMPLIFIER_PARAMETERS,
    BiasPoint,
    MachineDescription,
    MagneticBearing,
)
from ambrose.machine.kinds import PairOf
from ambrose.machine.ordinary_file import ELEMENTS
from ambrose.machine.parameters import bending_modes_of_mesh
from ambrose.machine.part import (
    POLES,
    SENSORS_ON,
    CasingMode,
    Magnet,
    Part,
    ShaftSection,
    Support,
    Touchdown,
    hints_of,
)
from ambrose.machine.units import DIMENSIONS, complaint, number, shown, suggestion

# Numbers of a part that must be positive: complaints with the unit that the part's field states.


def not_positive(
    where: str, part: Part, remedy: str, *keys: str, zero: bool = False
) -> Iterator[str]:
    """Complaints about the numbers under these keys that are not above zero (or not at it); None
    passes, and a pair of equal numbers is named once.
    """
    requirement = "zero or positive" if zero else "positive"
    for key in keys:
        unit, names = unit_and_names(type(part), key)  # type: ignore[arg-type]  # a class is hashable
        value = getattr(part, key)
        several = isinstance(value, (tuple, list))
        values = value if several else (value,)
        if names and several and len(set(values)) == 1:  # one number for both
            values, several = values[:1], False
        for i, entry in enumerate(values):
            if entry is not None and (entry < 0 or (entry == 0 and not zero)):
                name = f" ({names[i] if names else f'element {i + 1}'})" if several else ""
                yield complaint(where, f"{key}{name}", number(entry, unit), requirement, remedy)


@lru_cache(maxsize=256)
def unit_and_names(part: type, key: str) -> tuple[str, list[str]]:
    """The unit of a field ("" for a ratio or a count), and the names of a pair's two values."""
    kind = next(dimensional(hints_of(part)[key]), None)
    unit = "" if kind is None else DIMENSIONS[kind.dimension].unit
    return "" if unit == "-" else unit, kind.names.split(", ") if isinstance(kind, PairOf) else []


def dimensional(hint: Any) -> Iterator[Any]:
    """The kinds with a dimension that an annotation holds, at any depth."""
    yield from (kind for kind in getattr(hint, "__metadata__", ()) if hasattr(kind, "dimension"))
    for inner in get_args(hint):
        yield from dimensional(inner)


# What may be wrong with a [bearing.magnet].


def magnet_findings(where: str, magnet: Magnet) -> Iterator[str]:
    """What is wrong with a [bearing.magnet], a line each; ``where`` stands first in each."""
    yield from not_positive(
        where,
        magnet,
        "give its size",
        "turns",
        "pole_area",
        "gap",
        "iron_path",
        "iron_permeability",
        "iron_flux_density",
        "journal_radius",
        "back_iron_area",
        "bias_turns",
        "remanence",
        "magnet_permeability",
        "magnet_length",
        "magnet_area",
    )
    yield from not_positive(where, magnet, "0.1 is much", "leakage", zero=True)
    allowed = POLES[magnet.kind]
    if magnet.pole_count not in allowed:
        yield complaint(
            where,
            "poles",
            f"{magnet.pole_count}",
            f"one of {', '.join(map(str, allowed))} for a {magnet.kind} magnet",
            "count the poles of one plane",
        )
    if magnet.back_iron_area is not None and None in (magnet.journal_radius, magnet.iron_path):
        yield (
            f"{where}: back_iron_area needs journal_radius and iron_path; give the three, or "
            "leave the back iron out"
        )
    pm = ("remanence", "magnet_length", "magnet_area")
    if magnet.kind != "homopolar":
        for key in ("bias_turns", *pm):
            if getattr(magnet, key) is not None:
                yield f'{where}: {key} belongs to kind = "homopolar"; leave it out'
        if magnet.bias != "coil":
            yield f'{where}: bias = "permanent-magnet" belongs to kind = "homopolar"; leave it out'
    elif magnet.bias == "coil":
        if magnet.bias_turns is None:
            yield f"{where}: bias_turns is missing; give the turns of the bias coil"
        for key in pm:
            if getattr(magnet, key) is not None:
                yield f'{where}: {key} belongs to bias = "permanent-magnet"; leave it out'
    else:
        for key in pm:
            if getattr(magnet, key) is None:
                yield f"{where}: {key} is missing; give the permanent magnet's"
        if magnet.bias_turns is not None:
            yield f'{where}: bias_turns belongs to bias = "coil"; leave it out'


# What a touchdown bearing must fulfil: contact, rings, mount and limits; and the coast-down.


def touchdown_findings(where: str, bearing: MagneticBearing) -> Iterator[str]:
    """Complaints about a bearing's [bearing.touchdown], if it has one."""
    contact = bearing.touchdown
    if contact is None:
        return
    inside = f"{where}, [bearing.touchdown]"
    yield from not_positive(
        inside,
        contact,
        "leave it out for its default",
        *("stiffness", "radius", "sliding_speed", "stribeck_speed"),
    )
    taken = ("damping", "friction", "static_friction")
    remedy = "contact takes energy and gives none"
    yield from not_positive(inside, contact, remedy, *taken, zero=True)
    static = contact.static_friction
    if static is not None and 0 <= static < contact.friction:
        yield complaint(
            inside,
            "static_friction",
            f"{static:g}",
            f"at least friction, {contact.friction:g}",
            "friction falls with the sliding speed; swap the two or leave static_friction out",
        )
    if bearing.touchdown_gap is None:
        yield f"{where}: touchdown_gap is missing; [bearing.touchdown] needs the clearance"
    yield from _rings(where, contact)


def _rings(where: str, contact: Touchdown) -> Iterator[str]:
    if contact.race is not None:
        inside = f"{where}, [bearing.touchdown.race]"
        sizes = ("mass", "inertia", "element_stiffness", "element_load")
        rest = ("pitch_diameter", "static_capacity", "specific_heat", "temperature")
        yield from not_positive(inside, contact.race, "give its size", *sizes, *rest)
        losses = ("preload", "element_damping", "friction_moment", "load_friction")
        yield from not_positive(
            inside, contact.race, "leave it out for its default", *losses, zero=True
        )
    if contact.mount is not None:
        inside = f"{where}, [bearing.touchdown.mount]"
        remedy = "leave the table out for a rigid mount"
        yield from not_positive(
            inside, contact.mount, remedy, "mass", "stiffness", "travel", "stop_stiffness"
        )
        yield from not_positive(inside, contact.mount, remedy, "damping", zero=True)
    limits = contact.limits
    if limits is None:
        return
    inside = f"{where}, [bearing.touchdown.limits]"
    keys = ("landings", "max_force", "temperature", "energy", "static_factor")
    yield from not_positive(inside, limits, "leave it out where it is not checked", *keys)
    capacity = None if contact.race is None else contact.race.static_capacity
    if limits.static_factor is not None and capacity is None:
        yield (
            f"{inside}: static_factor needs the load rating; give static_capacity in "
            "[bearing.touchdown.race], or leave static_factor out"
        )


def coast_down(machine: MachineDescription) -> Iterator[str]:
    """Complaints about [coast_down]."""
    if machine.coast_down is None:
        return
    remedy = "give its size; it slows the rotor"
    torques = ("brake_torque", "friction_torque", "windage_torque")
    yield from not_positive("[coast_down]", machine.coast_down, remedy, *torques, zero=True)
    yield from not_positive("[coast_down]", machine.coast_down, remedy, "windage_speed")


def measured_rotor(machine: MachineDescription) -> Iterator[str]:
    """Complaints about [measured_rotor], and about shapes without it."""
    rotor, where = machine.measured_rotor, "[measured_rotor]"
    shaped = [mode for mode in machine.bending_modes if mode.shape or any(mode.gyroscopic)]
    if rotor is None:
        for mode in shaped:
            yield (
                f"[[bending_mode]] {mode.number}: shape and gyroscopic are a [measured_rotor]'s; "
                "add one, or leave them out"
            )
        return
    yield from not_positive(where, rotor, "weigh the rotor", "mass")
    yield from not_positive(where, rotor, "leave it out for a bar's", "diametral_inertia")
    yield from not_positive(where, rotor, "leave it out where unknown", "polar_inertia", zero=True)
    length = machine.length if machine.shaft else math.inf
    for place in (*rotor.places, *([] if rotor.centre is None else [rotor.centre])):
        if not 0 <= place <= length:
            on = f"on the shaft, from 0 to {length:g} m"
            yield complaint(where, "a place", number(place, "m"), on, "count from the left end")
    if list(rotor.places) != sorted(set(rotor.places)):
        yield f"{where}: places do not ascend; sort them, each once"
    if [mode.number for mode in machine.bending_modes] != list(
        range(1, len(machine.bending_modes) + 1)
    ):
        yield f"{where}: its [[bending_mode]]s are not numbered 1, 2, 3; state all that count"
    for mode in machine.bending_modes:
        if mode.frequency is None or len(mode.shape) != len(rotor.places) or not mode.shape:
            yield (
                f"[[bending_mode]] {mode.number}: a measured rotor's mode has a frequency and one "
                f"deflection in shape for each of its {len(rotor.places)} places"
            )
    operation = machine.operation
    speeds = {point.label: point.speed for point in operation.envelope}
    if operation.speed_range[1] > 0:
        ends = zip(("slow", "fast"), operation.speed_range, strict=True)
        speeds |= {f"the {end} end of speed_range": speed for end, speed in ends}
    for label, speed in speeds.items():
        if not rotor.holds_at(speed):
            yield (
                f"{where}: it was measured at {rotor.speed:g} rad/s, but {label} is at {speed:g} "
                "rad/s; measure there, or describe shaft and discs"
            )


# gap between shaft sections that counts as rounding, as a fraction of the rotor's length
JOINT = 1e-9


def shaft(machine: MachineDescription) -> Iterator[str]:
    if not machine.shaft:
        yield (
            "[[shaft]]: there is no section; describe the rotor by at least one, from its left end "
            "to its right end"
        )
        return
    rounding = JOINT * sum(abs(section.length) for section in machine.shaft)
    end = 0.0
    for i, section in enumerate(machine.shaft):
        where = shaft_place(i, section)
        yield from _section(where, section)
        if abs(section.start - end) > rounding:
            kind = "a gap after" if section.start > end else "an overlap with"
            what = (
                f"{kind} the previous section, which ends"
                if i
                else "away from the rotor's left end, which is"
            )
            yield (
                f"{where}: start is {section.start:g} m, {what} at {end:g} m; "
                "leave start out, or make every section start where the previous one ends"
            )
        end = section.start + section.length


def shaft_place(index: int, section: ShaftSection) -> str:
    """A shaft section as messages call it: by number and label."""
    return f"[[shaft]] {index + 1}" + (f' "{section.label}"' if section.label else "")


def _section(where: str, section: ShaftSection) -> Iterator[str]:
    bore = section.inner_diameter
    outer = section.outer_diameter
    mass = section.mass_diameter
    yield from not_positive(where, section, "give its size", "length", "outer_diameter")
    yield from not_positive(where, section, "leave it out for a cylinder", "end_outer_diameter")
    yield from not_positive(
        where, section, "leave it out for a solid shaft", "inner_diameter", zero=True
    )
    yield from not_positive(
        where, section, "leave it out for the bore of the left end", "end_inner_diameter", zero=True
    )
    if 0 < outer <= bore:
        below = f"below the outer_diameter, {outer:g} m"
        yield complaint(
            where, "inner_diameter", number(bore, "m"), below, "swap or correct the diameters"
        )
    elif 0 < section.diameters(1.0)[0] <= section.diameters(1.0)[1]:
        end_outer, end_bore, _ = section.diameters(1.0)
        below = f"below the outer diameter at the right end, {end_outer:g} m"
        key = "inner_diameter" if section.end_inner_diameter is None else "end_inner_diameter"
        yield complaint(
            where,
            key,
            number(end_bore, "m"),
            below,
            "give end_inner_diameter, or correct the diameters",
        )
    bore = max(bore, section.diameters(1.0)[1])
    if mass is not None and mass <= max(bore, 0):
        remedy = (
            "it is the outer diameter that carries the mass; leave it out where it is the "
            "outer_diameter"
        )
        yield complaint(
            where,
            "mass_diameter",
            number(mass, "m"),
            f"above the inner_diameter, {bore:g} m",
            remedy,
        )
    if not 1 <= section.elements <= ELEMENTS:
        remedy = "one element per diameter of length is a good start"
        yield complaint(where, "elements", section.elements, f"from 1 to {ELEMENTS}", remedy)
    material = section.material
    inside = f"{where}, material {material.name}".rstrip()
    yield from not_positive(
        inside, material, "see the material's data sheet", "density", "youngs_modulus"
    )
    if not -1 < material.poisson_ratio < 0.5:
        yield complaint(
            inside,
            "poisson_ratio",
            f"{material.poisson_ratio:g}",
            "between -1 and 0.5",
            "steel has 0.3",
        )


def discs(machine: MachineDescription) -> Iterator[str]:
    for disc in machine.discs:
        where = f"[[disc]] {disc.name}"
        polar, diametral = disc.polar_inertia, disc.diametral_inertia
        yield from not_positive(where, disc, "give its mass", "mass")
        remedy = "leave it out where it is negligible"
        yield from not_positive(
            where, disc, remedy, "polar_inertia", "diametral_inertia", zero=True
        )
        if polar > 2 * diametral * (1 + 1e-6) and diametral > 0:
            most = f"at most twice the diametral_inertia, {diametral:g} kg m^2"
            remedy = "no body has more; a thin disc has exactly twice"
            yield complaint(where, "polar_inertia", number(polar, "kg m^2"), most, remedy)


def bending_modes(machine: MachineDescription) -> Iterator[str]:
    available = bending_modes_of_mesh(machine)
    seen: dict[int, float] = {}
    for mode in machine.bending_modes if machine.shaft else ():
        where = f"[[bending_mode]] {mode.number}"
        if not 1 <= mode.number <= available:
            yield complaint(
                where,
                "number",
                str(mode.number),
                f"from 1 to {available}, those of the mesh",
                "1 is the lowest",
            )
        if mode.number in seen:
            yield (
                f"{where}: number {mode.number} is taken by an earlier [[bending_mode]]; merge the "
                "two"
            )
        if mode.frequency is None and mode.damping is None:
            yield (
                f"{where}: neither frequency nor damping is given; give what was measured, or "
                "leave the mode out"
            )
        yield from not_positive(
            where, mode, "give the natural frequency of the free rotor", "frequency"
        )
        if mode.damping is not None and not 0 <= mode.damping < 1:
            remedy = "0.005 is usual for a steel shaft"
            yield complaint(
                where, "damping", f"{mode.damping:g}", "a ratio from 0 to below 1", remedy
            )
        rate = mode.frequency or 0.0
        if rate and any(
            other and (rate - other) * (mode.number - k) < 0 for k, other in seen.items()
        ):
            yield (
                f"{where}: frequency {rate:g} rad/s is out of order; number the modes by ascending "
                "frequency"
            )
        seen.setdefault(mode.number, rate)


def bearings(machine: MachineDescription) -> Iterator[str]:
    for bearing in machine.bearings:
        where = f"[[bearing]] {bearing.name}"
        yield from _bearing(where, bearing)
        yield from _coefficients(where, bearing)


def _bearing(where: str, bearing: MagneticBearing) -> Iterator[str]:
    limits = ("gap", "touchdown_gap", "max_current", "max_force")
    yield from not_positive(where, bearing, "give the premagnetisation current", "bias_current")
    yield from not_positive(where, bearing, "leave it out where it is unknown", *limits)
    if bearing.gap and bearing.touchdown_gap and bearing.touchdown_gap > bearing.gap:
        below = f"at most the magnet's gap, {bearing.gap:g} m"
        yield complaint(
            where,
            "touchdown_gap",
            number(bearing.touchdown_gap, "m"),
            below,
            "the rotor must land before it meets the magnet",
        )
    yield from _iron_and_touchdown(where, bearing)
    if bearing.magnet is not None:
        yield from magnet_findings(f"{where}, [bearing.magnet]", bearing.magnet)
        if bearing.geometry is not None:
            yield f"{where}: [bearing.geometry] and [bearing.magnet] are given; keep one of the two"
        if bearing.touchdown_gap and bearing.touchdown_gap > bearing.magnet.gap > 0:
            yield complaint(
                where,
                "touchdown_gap",
                number(bearing.touchdown_gap, "m"),
                f"at most the gap of [bearing.magnet], {bearing.magnet.gap:g} m",
                "the rotor must land before it meets the magnet",
            )
    if bearing.geometry is None:
        return
    inside, geometry = f"{where}, [bearing.geometry]", bearing.geometry
    yield from not_positive(inside, geometry, "give its size", "turns", "pole_area", "gap")
    if not 0 <= geometry.pole_half_angle < math.pi / 2:
        degrees = f"{math.degrees(geometry.pole_half_angle):g} deg"
        yield complaint(
            inside,
            "pole_half_angle",
            degrees,
            "from 0 to below 90 deg",
            "eight poles have 22.5 deg",
        )


def _iron_and_touchdown(where: str, bearing: MagneticBearing) -> Iterator[str]:
    if not -1 < bearing.cross_coupling < 1:
        remedy = "it is the small part of the other axis' current that acts on an axis"
        yield complaint(
            where, "cross_coupling", f"{bearing.cross_coupling:g}", "between -1 and 1", remedy
        )
    room = bearing.gap or bearing.touchdown_gap
    for axis, offset in zip(("zeta", "eta"), bearing.magnetic_offset, strict=True):
        if room and abs(offset) >= room:
            within = f"smaller than the gap, {room:g} m"
            yield complaint(
                where,
                f"magnetic_offset ({axis})",
                number(offset, "m"),
                within,
                "give it in metres or with a unit",
            )
    if bearing.iron is not None:
        iron = bearing.iron
        inside, remedy = (
            f"{where}, [bearing.iron]",
            "leave the table out for magnets without saturation",
        )
        yield from not_positive(inside, iron, remedy, "turns", "flux_density")
        yield from not_positive(inside, iron, "0.05 mm is usual", "equivalent_gap", zero=True)
    if (
        bearing.geometry is not None
        and bearing.iron is not None
        and bearing.geometry.turns != bearing.iron.turns
    ):
        yield (
            f"{where}: turns differ in [bearing.geometry] and [bearing.iron]; give the turns of "
            "one horseshoe in both"
        )
    yield from touchdown_findings(where, bearing)


def _coefficients(where: str, bearing: MagneticBearing) -> Iterator[str]:
    coefficients = {
        key: getattr(bearing, key) for key in ("force_per_current", "negative_stiffness")
    }
    missing = [key for key, pair in coefficients.items() if pair is None]
    if len(missing) == 1:
        yield (
            f"{where}: {missing[0]} is missing; give both force_per_current and "
            "negative_stiffness, or neither"
        )
    elif missing and not (bearing.geometry or bearing.magnet or bearing.measured):
        yield (
            f"{where}: there are no coefficients; give force_per_current and negative_stiffness, "
            "or [bearing.geometry] or [bearing.magnet]"
        )
    yield from _signs(where, bearing)
    currents = [row.bias_current for row in bearing.measured]
    for i, row in enumerate(bearing.measured):
        inside = f"{where}, [[bearing.measured]] {i + 1}"
        yield from not_positive(inside, row, "give the premagnetisation current", "bias_current")
        yield from _signs(inside, row)
        if row.bias_current in currents[:i]:
            yield (
                f"{inside}: bias_current {row.bias_current:g} A is listed twice; keep one row "
                "per bias current"
            )


def _signs(where: str, coefficients: MagneticBearing | BiasPoint) -> Iterator[str]:
    yield from not_positive(
        where, coefficients, "a positive current pulls along the axis", "force_per_current"
    )
    remedy = "it is the size of a destabilising stiffness; a spring to ground is a [[coupling]]"
    yield from not_positive(where, coefficients, remedy, "negative_stiffness", zero=True)


def sensors(machine: MachineDescription) -> Iterator[str]:
    names = [bearing.name for bearing in machine.bearings]
    served = [sensor.bearing for sensor in machine.sensors]
    for i, sensor in enumerate(machine.sensors):
        where = f"[[sensor]] {sensor.bearing}"
        if sensor.bearing not in names:
            remedy = suggestion(sensor.bearing, names, "there is no [[bearing]]")
            yield f'{where}: bearing "{sensor.bearing}" is unknown; {remedy}'
        elif (
            sensor.bearing not in served[:i]
            and sum(s.weight for s in machine.sensors if s.bearing == sensor.bearing) == 0
        ):
            yield complaint(
                where,
                "weight",
                0,
                "positive for one pair of the bearing",
                "leave it out for equal shares",
            )
        yield from not_positive(where, sensor, "leave it out for a sensor without lag", "bandwidth")
        for axis, gain in zip(("zeta", "eta"), sensor.gain, strict=True):
            if gain == 0:
                yield complaint(
                    where, f"gain ({axis})", 0, "different from zero", "1 is a calibrated sensor"
                )
        yield from not_positive(
            where, sensor, "leave it out for a sensor without", "noise", "resolution", zero=True
        )
        yield from not_positive(
            where, sensor, "1 is an equal share in the mean", "weight", zero=True
        )
        for k, harmonic in enumerate(sensor.runout):
            inside = f"{where}, [[sensor.runout]] {k + 1}"
            yield from not_positive(
                inside, harmonic, "periods per revolution; an offset is the key offset", "order"
            )
            yield from not_positive(
                inside, harmonic, "turn the phase by 180 deg", "amplitude", zero=True
            )
    for name in names:
        if name not in served:
            yield (
                f'[[bearing]] {name}: no [[sensor]] serves it; add one with bearing = "{name}" and '
                "its position"
            )


def _current_loop(machine: MachineDescription) -> Iterator[str]:
    """A coil under a PI controller: its circuit, and whether the voltage holds the bias current."""
    coil = machine.amplifier
    for key, example in (("resistance", "1.2 ohm"), ("inductance", "20 mH")):
        if getattr(coil, key) is None:
            yield (
                f'[amplifier]: {key} is missing; order "current-loop" needs that of a coil, such '
                f'as "{example}"'
            )
    if coil.max_voltage is None or coil.resistance is None:
        return
    for bearing in machine.bearings:
        bias = coil.resistance * bearing.bias_current
        if not bias < coil.max_voltage:
            yield (
                f"[amplifier]: max_voltage is {coil.max_voltage:g} V, but the bias current of "
                f"bearing {bearing.name} alone takes {bias:.4g} V in the coil's resistance; give "
                "a higher voltage or a smaller resistance"
            )


def amplifier(machine: MachineDescription) -> Iterator[str]:
    amplifier = machine.amplifier
    if amplifier.order not in AMPLIFIER_PARAMETERS:
        known = f"one of {', '.join(AMPLIFIER_PARAMETERS)}"
        yield complaint("[amplifier]", "order", shown(amplifier.order), known, "choose one of them")
        return
    used = AMPLIFIER_PARAMETERS[amplifier.order]
    for key in ("bandwidth", "eddy_bandwidth", "natural_frequency", "damping"):
        value: float | None = getattr(amplifier, key)
        if key in used and value is None:
            yield (
                f'[amplifier]: {key} is missing; order "{amplifier.order}" needs it, in rad/s or '
                'such as "1.5 kHz"'
            )
        elif key not in used and value is not None:
            orders = [order for order, keys in AMPLIFIER_PARAMETERS.items() if key in keys]
            yield (
                f'[amplifier]: {key} is {value:g} rad/s, but order "{amplifier.order}" does not '
                "use it; "
                f"remove it, or set order to {' or '.join(orders)}"
            )
        yield from not_positive(
            "[amplifier]", amplifier, "give its corner frequency or damping term", key
        )
    yield from not_positive(
        "[amplifier]", amplifier, "leave both out for no limit", "max_voltage", "inductance"
    )
    yield from not_positive("[amplifier]", amplifier, "give the coil's resistance", "resistance")
    if amplifier.order == "current-loop":
        yield from _current_loop(machine)
        return
    if amplifier.resistance is not None:
        yield (
            f'[amplifier]: resistance is given, but order "{amplifier.order}" does not use it; '
            'remove it, or set order to "current-loop"'
        )
    if (amplifier.max_voltage is None) != (amplifier.inductance is None):
        there, missing = (
            ("max_voltage", "inductance")
            if amplifier.inductance is None
            else ("inductance", "max_voltage")
        )
        yield (
            f"[amplifier]: {missing} is missing; {there} limits the slope of the current only "
            "together with it"
        )
    elif amplifier.max_voltage is not None and amplifier.order == "none":
        yield (
            '[amplifier]: max_voltage limits the slope of the current, which order "none" does not '
            'have; choose "first"'
        )


def supports(machine: MachineDescription) -> Iterator[str]:
    bearings, seals = ([item.name for item in items] for items in (machine.bearings, machine.seals))
    seals += [
        station.name
        for effect, part in attached(machine)
        if effect.on_stator
        for station in effect.stations(part)
    ]
    seen: set[str] = set()
    for support in machine.supports:
        where = f"[[support]] {support.bearing}"
        yield from _named(where, "bearing", (support.bearing,), bearings)
        yield from _named(where, "seals", support.seals, seals)
        for name in (support.bearing, *support.seals):
            if name in seen:
                yield (
                    f'{where}: "{name}" stands on an earlier [[support]] already; merge the two, '
                    "or add a [[casing_mode]]"
                )
            seen.add(name)
        yield from not_positive(
            where, support, "leave the support out for a rigid one", "mass", "stiffness"
        )
        yield from not_positive(
            where, support, "a support takes energy and gives none", "damping", zero=True
        )
        yield from _sensor_on(where, support)
    for i, mode in enumerate(machine.casing_modes):
        where = f"[[casing_mode]] {i + 1}"
        yield from _named(where, "at", mode.at, [*bearings, *seals])
        yield from not_positive(
            where, mode, "a mode of a casing with a foundation", "frequency", "mass"
        )
        yield from not_positive(
            where, mode, "a casing takes energy and gives none", "damping", zero=True
        )
        for key in ("x", "y"):
            values = getattr(mode, key)
            if values and len(values) != len(mode.at):
                wanted = f"a list of {len(mode.at)}, one per name in at"
                yield complaint(
                    where, key, f"a list of {len(values)}", wanted, "0 where it does not move"
                )
        if not any((*mode.x, *mode.y)):
            yield (
                f"{where}: x and y are zero or missing, so that it moves nothing; give the "
                "deflections, or leave the mode out"
            )
        yield from _sensor_on(where, mode)


def _named(where: str, key: str, names: tuple[str, ...], known: list[str]) -> Iterator[str]:
    for i, name in enumerate(names):
        if name not in known:
            yield f'{where}: {key} "{name}" is unknown; {suggestion(name, known, "there is none")}'
        elif name in names[:i]:
            yield f'{where}: {key} names "{name}" twice; name it once'


def _sensor_on(where: str, part: Support | CasingMode) -> Iterator[str]:
    if part.sensor not in SENSORS_ON:
        yield complaint(
            where,
            "sensor",
            shown(part.sensor),
            f"one of {', '.join(SENSORS_ON)}",
            "choose one of them",
        )
