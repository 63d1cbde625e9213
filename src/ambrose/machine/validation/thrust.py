"""What a [[thrust_bearing]] must fulfil, by itself and in its machine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import MachineDescription
from ambrose.machine.messages import complaint, suggestion
from ambrose.machine.messages import number as measure
from ambrose.machine.parameters import find_uncertain
from ambrose.machine.thrust import CORES, ThrustBearing, ThrustStator
from ambrose.machine.validation.controller import controller as of_controller
from ambrose.machine.validation.parts import amplifier as of_amplifier
from ambrose.machine.validation.signs import not_positive

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
    for number, stator in enumerate(part.stators):
        yield from _stator(f"{where}, [[thrust_bearing.stator]] {number + 1}", stator, part)
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
    for part in machine.effects:
        if not isinstance(part, ThrustBearing):
            continue
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
