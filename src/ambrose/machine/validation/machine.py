"""What a machine must fulfil: checked whenever one is made.

Every check yields complaints, so that all problems of a machine are reported together. Places are
named as in the file.
"""

import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from itertools import combinations, pairwise

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import attached, attachments, by_table
from ambrose.machine.description import (
    BEAM_THEORIES,
    BEARING_TERMS,
    DAMPINGS,
    MODAL_DAMPING,
    MachineDescription,
)
from ambrose.machine.ordinary_file import SEAL_POLES, excess
from ambrose.machine.parameters import Parameter, find_uncertain
from ambrose.machine.part import (
    FREQUENCY_DEPENDENCE,
    SEAL_AXES,
    SEAL_COEFFICIENTS,
    GasSealGeometry,
    Part,
    Seal,
    SealTable,
    constant_under_pressure,
)
from ambrose.machine.thrust import CORES, ThrustBearing, ThrustStator
from ambrose.machine.units import complaint, listed, number, number as measure, shown, suggestion
from ambrose.machine.validation import parts
from ambrose.machine.validation.controller import (
    chain,
    controller,
    controller as of_controller,
    synchronous,
)
from ambrose.machine.validation.parts import (
    JOINT,
    amplifier as of_amplifier,
    coast_down,
    measured_rotor,
    not_positive,
    shaft_place,
)
from ambrose.machine.validation.ranges import impossible

# What stands around the rotor must leave it room: magnets, collar, seals and touchdown bearings
# beside the shaft.
#
# Only what is certain is refused. A disc is a mass and two inertias here; a bell may hang over a
# stator, so that no size follows from them.


_ROUNDING = 1 - 1e-6  # of a radius that the file repeats, from a diameter or in another unit


def fits(machine: MachineDescription) -> Iterator[str]:
    """What cuts into the shaft, a line each; a shaft that is itself wrong is named elsewhere."""
    wrong = any(section.length <= 0 or section.outer_diameter <= 0 for section in machine.shaft)
    if wrong or not machine.shaft:
        return
    for bearing in machine.bearings:
        where = f"[[bearing]] {bearing.name}"
        magnet, contact = bearing.magnet, bearing.touchdown
        if magnet is not None and magnet.journal_radius is not None:
            inside = f"{where}, [bearing.magnet]"
            yield from _around(
                machine, inside, "journal_radius", magnet.journal_radius, bearing.position
            )
        if contact is not None and contact.radius is not None:
            inside = f"{where}, [bearing.touchdown]"
            yield from _around(machine, inside, "radius", contact.radius, bearing.position)
    for seal in machine.seals:
        if seal.geometry is not None:
            inside, radius = f"[[seal]] {seal.name}, [seal.geometry]", seal.geometry.diameter / 2
            yield from _around(machine, inside, "diameter", radius, seal.position, factor=2)
    for part in machine.parts(ThrustBearing):
        yield from _thrust(machine, part)


def _around(
    machine: MachineDescription, where: str, key: str, radius: float, place: float, factor: int = 1
) -> Iterator[str]:
    """A surface of the rotor, that lies on the shaft or on a sleeve over it."""
    shaft, section = least_radius(machine, place)
    if 0 < radius < _ROUNDING * shaft:
        least = f"at least the shaft's there, {factor * shaft:g} m ({section})"
        yield complaint(
            where, key, number(factor * radius, "m"), least, "correct the one or the other"
        )


def _thrust(machine: MachineDescription, part: ThrustBearing) -> Iterator[str]:
    where = f"[[thrust_bearing]] {part.name}"
    shaft, section = least_radius(machine, part.position)
    if 0 < part.collar_radius <= shaft:
        above = f"above the shaft's radius there, {shaft:g} m ({section})"
        value = number(part.collar_radius, "m")
        yield complaint(where, "collar_radius", value, above, "correct the one or the other")
    if len(part.stators) not in {1, 2} or min(part.gap) <= 0:
        return
    spans = _spans(part)
    tightest: dict[int, tuple[float, str]] = {}  # of a stator for both sides, the larger radius
    for side, span in enumerate(spans):
        k = min(side, len(part.stators) - 1)
        tightest[k] = max(tightest.get(k, (0.0, "")), _largest_radius(machine, *span))
    for k, (radius, section) in tightest.items():
        bore = part.stators[k].inner_pole[0]
        if 0 < bore <= radius:
            inside = f"{where}, [[thrust_bearing.stator]] {k + 1}"
            above = f"above the rotor's radius inside it, {radius:g} m ({section})"
            remedy = "the shaft turns in the pole's bore: widen it, or correct the shaft"
            yield complaint(inside, "inner_pole (inner)", number(bore, "m"), above, remedy)
    first, last = spans[0][0], spans[1][1]
    for bearing in machine.bearings:
        if first < bearing.position < last:
            yield (
                f"[[bearing]] {bearing.name}: position is {bearing.position:g} m, inside "
                f"[[thrust_bearing]] {part.name}, whose stators stand from {first:g} to {last:g} m;"
                " move one of the two"
            )


def _spans(part: ThrustBearing) -> tuple[tuple[float, float], tuple[float, float]]:
    """From where to where the stators (left, right) stand along the shaft [m]: behind the gap the
    slot's depth and the wall.
    """
    half = part.collar_thickness / 2

    def depth(stator: ThrustStator) -> float:
        return stator.slot_depth + stator.back_wall

    left, right = part.position - half - part.gap[0], part.position + half + part.gap[1]
    one, other = part.pair
    return (left - depth(one), left), (right, right + depth(other))


def _largest_radius(machine: MachineDescription, low: float, high: float) -> tuple[float, str]:
    """The rotor's largest radius [m] between two places, shrunk-on laminations included, and the
    section that has it.
    """
    best, slack = (0.0, ""), JOINT * machine.length
    for i, section in enumerate(machine.shaft):
        ends = max(low, section.start), min(high, section.start + section.length)
        if ends[1] - ends[0] <= slack:
            continue
        for end in ends:
            outer, _, mass = section.diameters((end - section.start) / section.length)
            best = max(best, (max(outer, mass) / 2, shaft_place(i, section)))
    return best


def least_radius(machine: MachineDescription, place: float) -> tuple[float, str]:
    """The shaft's radius [m] at a place, at a step the smaller one, and the section; laminations
    are left out: a sleeve may end before them.
    """
    slack = JOINT * machine.length
    radii = [
        (
            section.diameters((place - section.start) / section.length)[0] / 2,
            shaft_place(i, section),
        )
        for i, section in enumerate(machine.shaft)
        if section.start - slack <= place <= section.start + section.length + slack
    ]
    return min(radii, default=(0.0, ""))


# What the seals of a machine must fulfil: constants, tables and geometries, each on its own.


COMPUTED = ("K", "k", "C", "c")  # what a geometry yields
_MOST_POLES = 12  # of a rational seal
_WIDEST = 0.05  # clearance over diameter
_PRESWIRL = 2.0  # surface speeds; inlet swirl measured on test rigs stays below one


def seals(machine: MachineDescription) -> Iterator[str]:
    for seal in machine.seals:
        where = f"[[seal]] {seal.name}"
        yield from not_positive(where, seal, "give a pressure difference", "reference_pressure")
        scaled = seal.scales_with_pressure
        for coefficient in scaled:
            if coefficient not in SEAL_COEFFICIENTS:
                unknown = suggestion(coefficient, SEAL_COEFFICIENTS)
                yield (
                    f'{where}: scales_with_pressure names the unknown coefficient "{coefficient}"; '
                    f"{unknown}"
                )
        if len(set(scaled)) < len(scaled):
            yield (
                f"{where}: scales_with_pressure names a coefficient twice, {', '.join(scaled)}; "
                "name each once"
            )
        if scaled and seal.reference_pressure is None:
            yield (
                f"{where}: reference_pressure is missing; scales_with_pressure needs it, such as "
                '"2.04 bar"'
            )
        if seal.table is not None:
            yield from _seal_table(f"{where}, [seal.table]", seal, seal.table)
        if seal.geometry is not None:
            yield from _beside(where, seal)
            yield from _geometry(f"{where}, [seal.geometry]", seal.geometry)
        yield from _frequency(where, seal)
        reason = f"seal.{seal.name}.scales_with_pressure"
        if (constant := constant_under_pressure(seal)) and reason not in dict(machine.assumed):
            yield (
                f"{where}: {', '.join(constant)} would stay at zero pressure while other "
                "coefficients vanish; name all in "
                f'scales_with_pressure, or say in [machine.assumed] under "{reason}" why not'
            )


def _seal_table(where: str, seal: Seal, table: SealTable) -> Iterator[str]:
    axes, values = dict(table.axes), dict(table.values)
    if not axes or len(axes) < len(table.axes):
        yield (
            f"{where}: axes are missing or repeated; give one list for each of pressure, speed or "
            "frequency that matters"
        )
    if not values:
        yield (
            f"{where}: it lists no coefficient; give any of {', '.join(SEAL_COEFFICIENTS)} as "
            "lists over the axes"
        )
    for axis, grid in axes.items():
        if axis not in SEAL_AXES:
            yield f'{where}: axis "{axis}" is unknown; {suggestion(axis, SEAL_AXES)}'
        if len(grid) == 0 or any(b <= a for a, b in pairwise(grid)):
            yield complaint(
                where,
                axis,
                shown(list(grid)),
                "ascending, with at least one value",
                "sort the table along it",
            )
    size = tuple(len(grid) for grid in axes.values())
    for name, array in values.items():
        if name not in SEAL_COEFFICIENTS:
            yield f'{where}: coefficient "{name}" is unknown; {suggestion(name, SEAL_COEFFICIENTS)}'
            continue
        yield from _table_size(where, name, array, tuple(axes), size)
        if getattr(seal, name) != 0:
            yield (
                f"{where}: {name} is {getattr(seal, name):g} in [[seal]] {seal.name} as well; keep "
                "the constant or the table"
            )
        if "pressure" in axes and name in seal.scales_with_pressure:
            yield (
                f"{where}: {name} is given over pressure and named in scales_with_pressure; keep "
                "one of the two"
            )


def _table_size(
    where: str, name: str, array: object, axes: tuple[str, ...], size: tuple[int, ...]
) -> Iterator[str]:
    try:
        actual = np.asarray(array, dtype=float).shape
    except (TypeError, ValueError):
        yield (
            f"{where}: {name} is ragged; make all its inner lists equally long, nested in the "
            f"order {', '.join(axes)}"
        )
        return
    if actual != size:
        wanted = f"{' x '.join(map(str, size))} ({' x '.join(axes)})"
        remedy = "nest the lists in the order of the axes, one number per point"
        yield complaint(where, f"the size of {name}", " x ".join(map(str, actual)), wanted, remedy)


def _frequency(where: str, seal: Seal) -> Iterator[str]:
    if seal.frequency_dependence not in FREQUENCY_DEPENDENCE:
        known = f"one of {', '.join(FREQUENCY_DEPENDENCE)}"
        yield complaint(
            where,
            "frequency_dependence",
            shown(seal.frequency_dependence),
            known,
            "choose one of them",
        )
    elif seal.frequency_dependence == "states":
        grid = () if seal.table is None else dict(seal.table.axes).get("frequency", ())
        if seal.geometry is None and len(grid) < 2:
            remedy = "give [seal.geometry] or a [seal.table] over frequency, or leave the key out"
            yield (
                f'{where}: frequency_dependence is "states", but no coefficient depends on the '
                f"frequency; {remedy}"
            )
        elif seal.geometry is not None and seal.reference_pressure is None:
            yield (
                f'{where}: reference_pressure is missing; frequency_dependence "states" fits its '
                "poles there"
            )
        elif seal.geometry is None and 2 * sum(w > 0 for w in grid) < 2 * seal.poles + 2:
            yield complaint(
                where,
                "poles",
                seal.poles,
                f"at most {sum(w > 0 for w in grid) - 1} for this table",
                "lower it",
            )
    if not 1 <= seal.poles <= _MOST_POLES:
        yield complaint(
            where,
            "poles",
            seal.poles,
            f"from 1 to {_MOST_POLES}",
            "3 suit most gas seals up to 1.5 kHz",
        )


def _beside(where: str, seal: Seal) -> Iterator[str]:
    """What may not stand beside a geometry."""
    for name in COMPUTED:
        if getattr(seal, name) != 0:
            yield (
                f"{where}: {name} is {getattr(seal, name):g}, but [seal.geometry] yields it; keep "
                "one of the two"
            )
        if name in seal.scales_with_pressure:
            yield (
                f"{where}: scales_with_pressure names {name}, which [seal.geometry] yields at "
                "every pressure; remove it there"
            )
    if seal.table is not None:
        yield f"{where}: both [seal.geometry] and [seal.table] are given; keep one of the two"


def _geometry(where: str, geometry: GasSealGeometry) -> Iterator[str]:
    g = geometry
    remedy = "give it in metres or with a unit; clearances are radial"
    yield from not_positive(
        where, g, remedy, "length", "diameter", "inlet_clearance", "exit_clearance"
    )
    yield from not_positive(where, g, "give an absolute temperature", "temperature")
    yield from not_positive(
        where, g, "leave it out for air", "gas_constant", "viscosity", "compressibility"
    )
    yield from not_positive(where, g, "leave it out for the default", "max_frequency")
    yield from not_positive(where, g, "leave it out for the point's", "speed", zero=True)
    sizes = ("hole_depth", "inlet_loss", "exit_recovery", "hole_area_ratio")
    yield from not_positive(where, g, "0 stands for none", *sizes, zero=True)
    for key in ("hole_area_ratio", "exit_recovery"):
        if getattr(g, key) > 1:
            yield complaint(where, key, f"{getattr(g, key):g}", "at most 1", "it is a share")
    for key in ("inlet_clearance", "exit_clearance"):
        if 0 < g.diameter * _WIDEST < getattr(g, key):
            below = f"below 5 % of the diameter, {_WIDEST * g.diameter:g} m"
            yield complaint(
                where, key, number(getattr(g, key), "m"), below, "check its unit; it is radial"
            )
    for key in ("stator_friction", "rotor_friction"):
        coefficient, exponent = getattr(g, key)
        if coefficient <= 0:
            yield complaint(
                where,
                f"{key} (coefficient)",
                f"{coefficient:g}",
                "positive",
                "Blasius' smooth wall has 0.079",
            )
        if not -1 <= exponent <= 1:
            yield complaint(
                where, f"{key} (exponent)", f"{exponent:g}", "from -1 to 1", "-0.25 is Blasius'"
            )
    if abs(g.preswirl) > _PRESWIRL:
        within = f"from {-_PRESWIRL:g} to {_PRESWIRL:g}"
        yield complaint(
            where,
            "preswirl",
            f"{g.preswirl:g}",
            within,
            "divide the inlet swirl by the surface speed",
        )
    yield from not_positive(
        where, g, "give an absolute pressure", "exit_pressure", "inlet_pressure"
    )
    if (g.exit_pressure is None) == (g.inlet_pressure is None):
        stated = (
            "both exit_pressure and inlet_pressure are"
            if g.exit_pressure
            else "neither exit_pressure nor inlet_pressure is"
        )
        yield (
            f"{where}: {stated} given; give one, the operating point's seal_pressure yields the "
            "other"
        )


# What a [[thrust_bearing]] must fulfil, by itself and in its machine.


_CLOSES = 1e-6  # [m] by which gaps and collar may miss the distance of the stators


def findings(where: str, part: ThrustBearing) -> Iterator[str]:
    """What is wrong with the table itself, a line each."""
    yield from not_positive(
        where, part, "give it as built", "collar_radius", "collar_thickness", "gap", "bias_current"
    )
    yield from not_positive(
        where, part, "leave it out where there is no limit", "max_current", "max_force"
    )
    yield from not_positive(
        where,
        part,
        "leave it out for the default",
        "conductivity",
        "permeability",
        "core_scale",
        "stop_stiffness",
    )
    yield from not_positive(
        where, part, "leave it out", "core_corner", "flux_density", "touchdown_gap", "distance"
    )
    yield from not_positive(
        where,
        part,
        "leave it out where there is none",
        "coupling_stiffness",
        "coupling_damping",
        "load_time",
        "stop_damping",
        zero=True,
    )
    if part.core not in CORES:
        yield complaint(where, "core", part.core, " or ".join(CORES), "choose one of them")
    yield from not_positive(where, part, "1 is as stated", "face_scale", "gap_scale")
    yield from not_positive(
        where, part, "leave it out", "amplifier_bandwidth", "max_voltage", "inductance"
    )
    if len(part.stators) not in {1, 2}:
        yield (
            f"{where}: there are {len(part.stators)} [[thrust_bearing.stator]], but must be one "
            "for both sides, or two, left and right; add or remove"
        )
    for i, stator in enumerate(part.stators):
        yield from _stator(f"{where}, [[thrust_bearing.stator]] {i + 1}", stator, part)
    yield from _gaps(where, part)
    yield from _sensor(f"{where}, [thrust_bearing.sensor]", part)
    for name, own in (("weights", part.weights), ("requirements", part.requirements)):
        if own is not None:
            keys = (item.name for item in fields(own))
            inside = f"{where}, [thrust_bearing.{name}]"
            yield from not_positive(inside, own, "leave it out where nothing is demanded", *keys)


def _stator(where: str, stator: ThrustStator, part: ThrustBearing) -> Iterator[str]:
    yield from not_positive(where, stator, "give it as built", "turns", "slot_depth", "back_wall")
    radii = (*stator.inner_pole, *stator.outer_pole)
    if not all(a < b for a, b in zip((0.0, *radii), radii, strict=False)):
        yield (
            f"{where}: the poles' radii are {', '.join(f'{r:g}' for r in radii)} m, but must "
            "ascend from the inner pole's inner edge to the outer pole's outer edge; swap or "
            "correct them"
        )
    elif part.collar_radius > stator.outer_pole[1]:
        yield (
            f"{where}: the collar ({part.collar_radius:g} m) is larger than its stator "
            f"({stator.outer_pole[1]:g} m); correct collar_radius or outer_pole"
        )
    elif part.collar_radius <= stator.outer_pole[0]:
        yield (
            f"{where}: the collar ({part.collar_radius:g} m) ends before the outer pole begins "
            f"({stator.outer_pole[0]:g} m), so that no flux closes; correct one of the two"
        )


def _gaps(where: str, part: ThrustBearing) -> Iterator[str]:
    total = sum(part.gap) + part.collar_thickness
    if part.distance is not None and abs(total - part.distance) > _CLOSES:
        yield (
            f"{where}: the gaps do not close: {part.gap[0]:g} + {part.collar_thickness:g} + "
            f"{part.gap[1]:g} m of gap, collar and gap are {total:g} m, not the distance of "
            f"{part.distance:g} m between the stators; correct one of the four"
        )
    if part.touchdown_gap is None:
        return
    least, most = part.growth
    alike = len({*zip(part.touchdown_gap, part.gap, strict=True)}) == 1
    for side, stop, gap, out in zip(
        ("left", "right"), part.touchdown_gap, part.gap, (most, -least), strict=True
    ):
        if stop >= gap > 0:
            if alike and side == "right":
                continue
            yield complaint(
                where,
                "touchdown_gap" if alike else f"touchdown_gap ({side})",
                f"{stop:g} m",
                f"below the air gap of {gap:g} m",
                "the collar would strike the magnet",
            )
        elif out >= stop:
            yield (
                f"{where}: thermal growth takes the collar {out:g} m to the {side}, onto its stop "
                f"at {stop:g} m; move the sensor nearer, or widen touchdown_gap"
            )


def _sensor(where: str, part: ThrustBearing) -> Iterator[str]:
    sensor = part.sensor
    yield from not_positive(where, sensor, "leave it out for a sensor without lag", "bandwidth")
    yield from not_positive(
        where, sensor, "0 for none", "noise", "resolution", "expansion", zero=True
    )
    if not sensor.gain:
        yield complaint(where, "gain", "0", "not zero", "leave it out for a calibrated sensor")
    if sensor.growth is not None and sensor.temperature_rise is not None:
        yield (f"{where}: growth and temperature_rise are both given; keep one, each says the same")
    for key in ("growth", "temperature_rise"):
        ends = getattr(sensor, key)
        if ends is not None and ends[0] > ends[1]:
            yield complaint(where, key, f"[{ends[0]:g}, {ends[1]:g}]", "[least, most]", "swap them")
    for side, gap, out in zip(
        ("left", "right"), part.gap, (part.growth[1], -part.growth[0]), strict=True
    ):
        if out >= gap > 0:
            yield (
                f"{where}: thermal growth of {measure(out, 'm')} closes the {side} gap of "
                f"{measure(gap, 'm')}; move the sensor nearer to the collar"
            )


def of_machine(machine: MachineDescription) -> Iterator[str]:
    """What is wrong with a thrust bearing in its machine: loads at points that there are not."""
    labels = [point.label for point in machine.operation.envelope]
    for part in machine.parts(ThrustBearing):
        seen: set[str] = set()
        for i, load in enumerate(part.loads):
            where = f"[[thrust_bearing]] {part.name}, [[thrust_bearing.load]] {i + 1}"
            if load.point not in labels:
                yield (
                    f'{where}: point "{load.point}" is no operating point\'s label; '
                    f"{suggestion(load.point, labels)}"
                )
            elif load.point in seen:
                yield f'{where}: point "{load.point}" has its load already; give one of the two'
            seen.add(load.point)
        # a rotor without sections is named elsewhere
        length = machine.length if machine.shaft else math.inf
        if not 0 <= part.sensor.position <= length:
            yield complaint(
                f"[[thrust_bearing]] {part.name}, [thrust_bearing.sensor]",
                "position",
                measure(part.sensor.position, "m"),
                f"on the shaft, from 0 to {length:g} m",
                "positions count from the rotor's left end",
            )


def axial_problems(machine: MachineDescription, part: ThrustBearing) -> Iterator[str]:
    """What is wrong with the axis: its controller, amplifier, tolerances."""
    for check in (of_controller, of_amplifier):
        for line in check(machine):
            inside = line.replace("[controller", "[thrust_bearing.controller")
            inside = inside.replace("[amplifier", "[thrust_bearing.amplifier")
            yield f"[[thrust_bearing]] {part.name}, {inside}"
    labels = [point.label for point in machine.operation.envelope]
    for i, item in enumerate(part.tolerances):
        where = f"[[thrust_bearing]] {part.name}, [[thrust_bearing.tolerance]] {i + 1}"
        try:
            find_uncertain(machine, item.parameter)
        except InvalidInput as error:
            yield f"{where}: {error}"
        if (item.relative is None) == (item.absolute is None):
            yield f"{where} {item.parameter}: give one of relative and absolute"
        for unknown in (label for label in item.around if label not in labels):
            yield f'{where}: around names "{unknown}"; {suggestion(unknown, labels)}'


_ONE_LINE = "one line of text without outer spaces or control characters"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


class InvalidMachine(InvalidInput):
    """A machine that cannot be: where it stands (its name or its file), and ``problems``, one line
    for each.
    """

    def __init__(self, where: str, problems: Sequence[str]) -> None:
        super().__init__(where, tuple(problems))
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return listed(self.args[0], self.problems)


def check_machine(machine: MachineDescription) -> None:
    """Raises InvalidMachine, an InvalidInput with one line per problem, if there is any."""
    lines = problems(machine)
    if lines:
        raise InvalidMachine(f'machine "{machine.name}"', lines)


def problems(machine: MachineDescription) -> tuple[str, ...]:
    """Everything that is wrong with a machine, one line each; numbers that are not finite, or that
    no machine can have, hide all else.
    """
    checks = (
        *(
            _whole,
            parts.shaft,
            _names,
            _places,
            parts.discs,
            parts.bearings,
            parts.sensors,
            parts.amplifier,
            _attached,
            of_machine,
            coast_down,
            measured_rotor,
            fits,
        ),
        *(parts.bending_modes, parts.supports),
        *(
            seals,
            controller,
            chain,
            synchronous,
            _operation,
            _tolerances,
            _requirements,
            _weights,
        ),
    )
    unseen = {
        item.name: value
        for item in fields(machine)
        if (value := getattr(machine, item.name)) is not _sound.get(id(value), _NONE)
    }
    first = (
        tuple(_sizes(machine))
        or tuple(line for name, value in unseen.items() for line in _not_finite(value, name))
        or tuple(impossible(machine, unseen))
    )
    if first:
        return first
    if len(_sound) > _MANY:
        _sound.clear()
    _sound.update(
        {id(value): value for value in unseen.values() if isinstance(value, tuple | Part)}
    )
    return tuple(line for check in checks for line in check(machine))


# Parts, and tuples of them, whose numbers were looked at one by one and are finite and possible, by
# their identity, which nobody else has while they are held here: of a machine with one part
# replaced, as for every member of a box or step of an identification, that part alone is looked at.
_sound: dict[int, object] = {}
_MANY = 2000
_NONE = object()


def _sizes(machine: MachineDescription) -> Iterator[str]:
    """More than is allowed hides all else, and is looked at first (machine/ordinary_file.py)."""
    plural = {
        "disc",
        "bending_mode",
        "bearing",
        "sensor",
        "seal",
        "coupling",
        "support",
        "casing_mode",
    }
    several = {key: getattr(machine, f"{key}s") for key in plural}
    pid, operation = machine.controller, machine.operation
    chains = (
        {}
        if pid is None
        else {"notch": pid.notches, "channel": pid.channels, "synchronous": pid.synchronous}
    )
    several["chain"] = machine.chain
    yield from excess({"shaft": machine.shaft, "tolerance": machine.tolerances, **several})
    yield from excess(
        {"operation": {"point": operation.points, "range": operation.ranges}, "controller": chains}
    )
    for channel in () if pid is None else pid.channels:
        yield from excess(
            {"controller": {"channel": {"section": channel.sections, "name": channel.names}}}
        )
    for table, entries in by_table(machine.effects).items():
        most = attachments()[table].most
        if len(entries) > most:
            yield (
                f"there are {len(entries)} entries of [[{table}]], but at most {most} are allowed; "
                "leave some out or merge them"
            )
    for bearing in machine.bearings:
        yield from excess({"bearing": {"measured": bearing.measured}})
    for sensor in machine.sensors:
        yield from excess({"sensor": {"runout": sensor.runout}})
    poles = sum(
        max(seal.poles, 0) for seal in machine.seals if seal.frequency_dependence == "states"
    )
    if poles > SEAL_POLES:
        yield (
            f"[[seal]]: the seals have {poles} poles in all, but at most {SEAL_POLES} are allowed; "
            "lower poles, 3 suit most"
        )


def _not_finite(thing: object, place: str) -> Iterator[str]:
    if isinstance(thing, float) and not math.isfinite(thing):
        yield (
            f"{place} is {thing}, but must be finite; look for a missing value or a division by "
            "zero"
        )
    elif isinstance(thing, np.ndarray):
        if thing.dtype.kind == "f" and not np.isfinite(thing).all():
            yield (
                f"{place} has an element that is not finite; look for a missing value or a "
                "division by zero"
            )
    elif isinstance(thing, (tuple, list)):
        for i, element in enumerate(thing):
            yield from _not_finite(element, f"{place} {getattr(element, 'name', i + 1)}")
    elif is_dataclass(thing):
        for field in fields(thing):
            yield from _not_finite(
                getattr(thing, field.name), f"{place}: {field.name}" if place else field.name
            )


def _whole(machine: MachineDescription) -> Iterator[str]:
    if not machine.name.strip():
        yield complaint("[machine]", "name", "empty", "a name", 'write name = "..."')
    elif not _one_line(machine.name):
        yield complaint(
            "[machine]", "name", shown(machine.name), _ONE_LINE, "records call the machine by it"
        )
    if not 0 <= machine.modal_damping < 1:
        remedy = "0.005 is usual for a steel shaft"
        yield complaint(
            "[machine]",
            "modal_damping",
            f"{machine.modal_damping:g}",
            "a ratio from 0 to below 1",
            remedy,
        )
    stated = {key: getattr(machine, key) for key in DAMPINGS}
    for key, value in stated.items():
        if not value >= 0:
            yield complaint("[machine]", key, f"{value:g}", "0 or more", "it would be no damping")
    if any(stated.values()) and machine.modal_damping != MODAL_DAMPING:
        given = ", ".join(key for key, value in stated.items() if value)
        yield complaint(
            "[machine]",
            "modal_damping",
            f"{machine.modal_damping:g}",
            f"left out beside {given}",
            "state the damping in one way; [[bending_mode]] has that of single modes",
        )
    yield from _rotating(machine)
    if machine.beam_theory not in BEAM_THEORIES:
        known = f"one of {', '.join(BEAM_THEORIES)}"
        yield complaint(
            "[machine]", "beam_theory", shown(machine.beam_theory), known, "choose one of them"
        )


def _rotating(machine: MachineDescription) -> Iterator[str]:
    share = machine.rotating_share
    turning = any(
        [
            *(getattr(machine, key) for key in DAMPINGS[1:]),
            not machine.rayleigh_alpha and machine.modal_damping,
            *(mode.damping for mode in machine.bending_modes),
        ]
    )
    if not 0 <= share <= 1:
        remedy = "1 where all damping is inside the rotor"
        yield complaint("[machine]", "rotating_share", f"{share:g}", "from 0 to 1", remedy)
    elif share and not turning:
        yield complaint(
            "[machine]",
            "rotating_share",
            f"{share:g}",
            "0 where no damping can turn with the rotor",
            "state modal_damping, rayleigh_beta or loss_factor; rayleigh_alpha acts against the "
            "surroundings",
        )
    elif share and machine.loss_factor and by_table(machine.effects).get("journal_bearing"):
        yield complaint(
            "[machine]",
            "loss_factor",
            f"{machine.loss_factor:g}",
            "0 beside rotating_share and a [[journal_bearing]]",
            "state rayleigh_beta: a loss factor turns over at the free rotor's frequencies, which "
            "stiff bearings change",
        )


def _attachments(machine: MachineDescription) -> Iterator[tuple[str, str, float]]:
    """(table, name, position) of everything with a name of its own; the plant's signals are named
    after it.
    """
    for table, entries in (
        ("disc", machine.discs),
        ("bearing", machine.bearings),
        ("seal", machine.seals),
    ):
        for entry in entries:
            yield table, entry.name, entry.position
    for effect, part in attached(machine):
        for station in effect.stations(part):
            yield effect.table, station.name, station.position


def _attached(machine: MachineDescription) -> Iterator[str]:
    """What the registered effects find in their parts."""
    for effect, part in attached(machine):
        yield from effect.findings(f"[[{effect.table}]] {part.name}", part)


def _named(name: str, table: str) -> str:
    """A name as near to ``name`` as the rule allows."""
    kept = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:60]
    return kept if _NAME.fullmatch(kept) else f"{table.replace('_', '-')}-{kept}".rstrip("-")


def _names(machine: MachineDescription) -> Iterator[str]:
    tables: dict[str, str] = {}
    for table, name, _ in _attachments(machine):
        if not _NAME.fullmatch(name):
            requirement = "a letter, then letters, digits, _ or -"
            yield complaint(
                f"[[{table}]]",
                "name",
                shown(name),
                requirement,
                f'signals and files are named after it; write "{_named(name, table)}"',
            )
        elif name in BEARING_TERMS:
            remedy = "scenarios mean a bearing by its place with it; choose another"
            yield complaint(
                f"[[{table}]]", "name", shown(name), f"none of {', '.join(BEARING_TERMS)}", remedy
            )
        elif name in tables:
            remedy = "give every attachment its own name"
            yield (
                f'[[{table}]] {name}: name "{name}" is taken by a [[{tables[name]}]] already; '
                f"{remedy}"
            )
        tables.setdefault(name, table)


def _places(machine: MachineDescription) -> Iterator[str]:
    if not machine.shaft or any(section.length <= 0 for section in machine.shaft):
        return
    sensors = (("sensor", sensor.bearing, sensor.position) for sensor in machine.sensors)
    slack = parts.JOINT * machine.length
    for table, name, position in (*_attachments(machine), *sensors):
        if not -slack <= position <= machine.length + slack:
            on_shaft = f"on the shaft, from 0 to {machine.length:g} m"
            yield complaint(
                f"[[{table}]] {name}",
                "position",
                number(position, "m"),
                on_shaft,
                "positions count from the rotor's left end",
            )


def _one_line(text: str) -> bool:
    return text == text.strip() and {"Cc", "Zl", "Zp"}.isdisjoint(map(unicodedata.category, text))


def _operation(machine: MachineDescription) -> Iterator[str]:
    operation = machine.operation
    low, high = operation.speed_range
    if not 0 <= low <= high:
        wanted = "[lowest, highest], neither negative"
        yield complaint(
            "[operation]",
            "speed_range",
            f"[{low:g}, {high:g}] rad/s",
            wanted,
            "swap or correct the two",
        )
    yield from not_positive(
        "[operation]", operation, "leave it out where it is not known", "pressure_rate"
    )
    if not operation.points:
        yield (
            "[operation]: there is no point; add at least one [[operation.point]], the nominal one "
            "first"
        )
    labels: set[str] = set()
    for i, point in enumerate(operation.points):
        where = f"[[operation.point]] {i + 1}" + (f' "{point.label}"' if point.label else "")
        remedy = "spin is positive from x to y, pressure is a difference"
        yield from not_positive(where, point, remedy, "speed", "seal_pressure", zero=True)
        yield from not_positive(where, point, "leave it out for the bearings' own", "bias_current")
        yield from not_positive(
            where, point, "leave it out for the speed", "whirl_frequency", zero=True
        )
        if not _one_line(point.label):
            yield complaint(
                where,
                "label",
                shown(point.label),
                _ONE_LINE,
                "records and reports call the point by it",
            )
        if point.label and point.label in labels:
            yield (
                f'{where}: label "{point.label}" is taken by an earlier point; give every point '
                "its own label"
            )
        labels.add(point.label)
    for i, area in enumerate(operation.ranges):
        where = f"[[operation.range]] {i + 1}" + (f' "{area.label}"' if area.label else "")
        yield from not_positive(
            where,
            area,
            "spin is positive, pressure is a difference",
            "speed",
            "seal_pressure",
            zero=True,
        )
        yield from not_positive(where, area, "leave it out for the bearings' own", "bias_current")
        for key in ("speed", "seal_pressure"):
            low, high = getattr(area, key)
            if low > high:
                yield complaint(
                    where, key, f"[{low:g}, {high:g}]", "[lowest, highest]", "swap the two"
                )
        if not _one_line(area.label) or not area.label:
            yield complaint(
                where,
                "label",
                shown(area.label),
                _ONE_LINE,
                "records and reports call its corners by it",
            )
        if area.label in labels:
            yield (
                f'{where}: label "{area.label}" is taken by a point or an earlier range; give '
                "every one its own label"
            )
        if len(area.corners) == 1:
            yield (
                f"{where}: has no width in speed nor in seal_pressure; make it an "
                "[[operation.point]]"
            )
        labels.add(area.label)
    labels |= {point.label for point in operation.envelope}
    wanted = operation.design_point
    if wanted and wanted not in labels:
        known = suggestion(wanted, sorted(labels - {""}))
        yield f'[operation]: design_point is "{wanted}", which is no point\'s label; {known}'


def _tolerances(machine: MachineDescription) -> Iterator[str]:
    uncertain: list[Parameter] = []
    for i, tolerance in enumerate(machine.tolerances):
        where = f"[[tolerance]] {i + 1}"
        try:
            uncertain.append(find_uncertain(machine, tolerance.parameter))
        except InvalidInput as error:
            yield f"{where}: {error}"
        named = f"{where} {tolerance.parameter}"
        if (tolerance.relative is None) == (tolerance.absolute is None):
            both = (
                "both relative and absolute are"
                if tolerance.relative is not None
                else "neither relative nor absolute is"
            )
            yield f"{named}: {both} given; give one of the two"
        yield from not_positive(
            named, tolerance, "give the half-width, or remove the tolerance", "relative", "absolute"
        )
        labels = [point.label for point in machine.operation.envelope]
        for unknown in (label for label in tolerance.around if label not in labels):
            yield (
                f'{named}: around names "{unknown}", which is no point\'s label; '
                f"{suggestion(unknown, labels)}"
            )
    for one, other in combinations(uncertain, 2):
        if one.overlaps(other):
            yield (
                f'[[tolerance]]: parameters "{one.path}" and "{other.path}" are the same number; '
                "keep one of the two, or name single axes in both"
            )


def _requirements(machine: MachineDescription) -> Iterator[str]:
    where, demanded = "[requirements]", machine.requirements
    keys = (field.name for field in fields(demanded))
    yield from not_positive(where, demanded, "leave it out where nothing is demanded", *keys)
    for key, least in (
        ("sensitivity_peak", demanded.sensitivity_peak),
        ("gain_margin", demanded.gain_margin),
    ):
        if least is not None and 0 < least < 1:
            yield complaint(where, key, f"{least:g}", "at least 1", "it is a factor, not decibels")
    if demanded.phase_margin is not None and demanded.phase_margin >= math.pi:
        yield complaint(
            where,
            "phase_margin",
            f"{demanded.phase_margin:g} rad",
            "below pi",
            'write degrees as "30 deg"',
        )
    if demanded.roll_off is not None and demanded.control_gain is None:
        yield (
            f"{where}: roll_off needs control_gain, the gain that falls above it; give both, or "
            "neither"
        )
    if (running := demanded.running_speeds) is not None and min(running) > 0:
        if running[0] > running[1]:
            yield complaint(
                where,
                "running_speeds",
                f"[{running[0]:g}, {running[1]:g}]",
                "[lowest, highest]",
                "swap the two",
            )
        elif not any(
            running[0] <= p.speed * (1 + 1e-9) <= running[1] * (1 + 2e-9)
            for p in machine.operation.envelope
        ):
            speeds = " to ".join(f"{speed * 30 / math.pi:.4g}" for speed in running)
            yield (
                f"{where}: no operating point runs at running_speeds, {speeds} rpm; add a "
                "[[operation.point]] there"
            )


def _weights(machine: MachineDescription) -> Iterator[str]:
    where, weights = "[weights]", machine.weights
    if weights is None:
        return
    remedy = "it is a size: leave the key out for its default"
    yield from not_positive(where, weights, remedy, *(field.name for field in fields(weights)))
    if 0 < weights.peak <= 1:
        yield complaint(
            where,
            "peak",
            f"{weights.peak:g}",
            "above 1",
            "it is a factor, not decibels; 3 is usual",
        )
    if weights.low_frequency_error >= 1:
        yield complaint(
            where,
            "low_frequency_error",
            f"{weights.low_frequency_error:g}",
            "below 1",
            "0.001 is usual",
        )
    if weights.control_crossover is None:
        if weights.control_limit is not None:
            why = "control_limit needs control_crossover; without it the weight is constant"
            yield f"{where}: {why}"
        return
    if weights.control_order > 8:
        yield complaint(
            where, "control_order", weights.control_order, "from 1 to 8", "2 suits most machines"
        )
    if weights.control_level >= 1:
        remedy = "the weight passes 1 at control_crossover"
        yield complaint(
            where,
            "control_level",
            f"{weights.control_level:g}",
            "below 1 with a control_crossover",
            remedy,
        )
    if weights.control_limit is not None and 0 < weights.control_limit <= 1:
        yield complaint(
            where, "control_limit", f"{weights.control_limit:g}", "above 1", "leave it out for 30"
        )
