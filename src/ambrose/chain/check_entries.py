"""Entries of a machine file that hardly any machine has: most often a number without its unit, or
with another program's sign. Each a sentence with cause and remedy, for `ambrose check`.

All limits below are assumed; each lies well outside of what is built, and well inside of what the
mistake that it looks for makes of usual values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.law.pid import pid_controller
from ambrose.machine.attachment import attached
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.seals import Seal
from ambrose.machine.validation.fits import least_radius
from ambrose.machine.validation.ranges import implausible
from ambrose.model.assemble import constant_coefficients, named_point, seal_coefficients
from ambrose.model.effect import Effect
from ambrose.model.effects.gas_seal import celsius_for_kelvin
from ambrose.model.effects.load import Load
from ambrose.model.effects.stage import Stage

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
# between a stage's rated speed and the machine's: about the root of 9.55 rpm per rad/s, half way to
# a mistaken unit
_SPEEDS = 3.0
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
    yield from _pressures(machine)
    for seal in machine.seals:
        if seal.geometry is not None and (cold := celsius_for_kelvin(seal.geometry)):
            yield f"[[seal]] {seal.name}, [seal.geometry]: {cold}"
        yield from _drives_backward(machine, seal)
    for _, part in attached(machine):
        if isinstance(part, Stage):
            yield from _stage(machine, part)


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
    for _, part in attached(machine):
        if isinstance(part, Load) and part.force > _LOAD * capacity > 0:
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
    if settings is None or not settings.synchronous:
        return
    from ambrose.core.synchronous import convergence
    from ambrose.judge.synchronous import block_loops

    law = pid_controller(settings, machine)
    for i, item in enumerate(block_loops(machine, law, settings.synchronous), 1):
        speeds = item.speeds(3).tolist()
        try:
            seen = [item.loop.signals(item.mode, w, item.conditions[0]) for w in speeds]
            # da/dt = -eps T R a converges where every eigenvalue of T R has a positive real part
            real = [
                float(convergence(item.running.at(w), response))
                for w, response in zip(speeds, seen, strict=True)
            ]
        except AmbroseError:  # no model at one of them, which verify says
            continue
        if max(real) < 0:
            yield (
                f"[[controller.synchronous]] {i}: {item.mode} with this T drives away what it is "
                f"to bring to zero at all of {', '.join(f'{w * _RPM:,.5g}' for w in speeds)} rpm; "
                "check the sign and the angle of T, 180 degrees are a wrong sign"
            )


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
                f"{_pressure(reference)}: its coefficients hardly hold so far away; correct one of "
                "the two"
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
