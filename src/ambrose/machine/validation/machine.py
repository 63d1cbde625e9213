"""What a machine must fulfil: checked whenever one is made.

Every check yields complaints, so that all problems of a machine are reported together. Places are
named as in the file.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from itertools import combinations

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import attached, attachments, by_table
from ambrose.machine.description import BEAM_THEORIES, BEARING_TERMS, MachineDescription
from ambrose.machine.limits import SEAL_POLES, excess
from ambrose.machine.messages import complaint, listed, number, shown, suggestion
from ambrose.machine.parameters import Parameter, find_uncertain
from ambrose.machine.validation import parts, thrust
from ambrose.machine.validation import seals as validate_seals
from ambrose.machine.validation.controller import chain, controller
from ambrose.machine.validation.fits import fits
from ambrose.machine.validation.ranges import impossible
from ambrose.machine.validation.signs import not_positive
from ambrose.machine.validation.synchronous import synchronous
from ambrose.machine.validation.touchdown import coast_down

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
            thrust.of_machine,
            coast_down,
            fits,
        ),
        *(parts.bending_modes, parts.supports),
        *(
            validate_seals.seals,
            controller,
            chain,
            synchronous,
            _operation,
            _tolerances,
            _requirements,
            _weights,
        ),
    )
    first = tuple(_sizes(machine)) or tuple(_not_finite(machine, "")) or tuple(impossible(machine))
    return first or tuple(line for check in checks for line in check(machine))


def _sizes(machine: MachineDescription) -> Iterator[str]:
    """More than is allowed hides all else, and is looked at first (machine/limits.py)."""
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
    if machine.beam_theory not in BEAM_THEORIES:
        known = f"one of {', '.join(BEAM_THEORIES)}"
        yield complaint(
            "[machine]", "beam_theory", shown(machine.beam_theory), known, "choose one of them"
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
