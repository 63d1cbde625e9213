"""What a [controller] must fulfil: a PID for all axes, chains of filter sections for single
channels, or both.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from ambrose.core.checks import same_clock
from ambrose.machine.description import MachineDescription
from ambrose.machine.ordinary_file import DELAY_SAMPLES, SAMPLE_TIME
from ambrose.machine.part import (
    CHAIN_KINDS,
    CONTROLLER_COORDINATES,
    MODES,
    SECTIONS,
    SYNCHRONOUS_COORDINATES,
    SYNCHRONOUS_MODES,
    SYNCHRONOUS_UPDATES,
    PidSettings,
    Section,
    Synchronous,
    modal_channels,
)
from ambrose.machine.units import complaint, number, shown, suggestion
from ambrose.machine.validation.parts import not_positive

# What a [[controller.synchronous]] must fulfil; what needs the plant is refused by verification.


_HARMONICS = 8  # of the turning; the speed's multiples that a block may follow


def synchronous(machine: MachineDescription) -> Iterator[str]:
    """Every block of [controller], and whether two blocks of one harmonic are on at once."""
    blocks = () if machine.controller is None else machine.controller.synchronous
    yield from synchronous_problems(
        blocks, len(machine.axes), len(machine.bearings), "[[controller.synchronous]]"
    )


def synchronous_problems(
    blocks: tuple[Synchronous, ...], axes: int, bearings: int, where: str
) -> Iterator[str]:
    """What is wrong with blocks for so many axes and bearings; ``where``: the name of their
    table.
    """
    for i, block in enumerate(blocks):
        inside = f"{where} {i + 1}"
        yield from not_positive(inside, block, "2/eps, in seconds", "time_constant")
        yield from not_positive(inside, block, "leave it out for the default", "limit", "release")
        yield from not_positive(
            inside, block, "zero switches it off", "hysteresis", "hold", "leak", zero=True
        )
        if block.mode not in SYNCHRONOUS_MODES:
            yield complaint(
                inside,
                "mode",
                shown(block.mode),
                f"one of {', '.join(SYNCHRONOUS_MODES)}",
                "choose one of them",
            )
        if block.update not in SYNCHRONOUS_UPDATES:
            known = f"one of {', '.join(SYNCHRONOUS_UPDATES)}"
            yield complaint(inside, "update", shown(block.update), known, "choose one of them")
        if block.coordinates not in SYNCHRONOUS_COORDINATES:
            known = f"one of {', '.join(SYNCHRONOUS_COORDINATES)}"
            yield complaint(
                inside, "coordinates", shown(block.coordinates), known, "choose one of them"
            )
        if block.coordinates == "tilt-translate" and bearings != 2:
            yield complaint(
                inside, "coordinates", '"tilt-translate"', '"axes"', "it needs two bearings"
            )
        if not 1 <= block.harmonic <= _HARMONICS:
            yield complaint(
                inside, "harmonic", block.harmonic, f"from 1 to {_HARMONICS}", "1 is the unbalance"
            )
        low, high = block.band
        if not 0 < low < high:
            yield complaint(
                inside,
                "band",
                f"[{low:g}, {high:g}] rad/s",
                "ascending, above 0",
                "swap or widen it",
            )
        elif not block.hysteresis < (high - low) / 2:
            yield complaint(
                inside,
                "hysteresis",
                f"{block.hysteresis:g} rad/s",
                "below half of the band's width",
                "narrow it",
            )
        if block.mode == "damping" and not block.leak:
            yield complaint(
                inside,
                "leak",
                "zero",
                'positive with mode "damping"',
                "it sets how fast it follows",
            )
        yield from _table_problems(inside, block, axes)
    for i, one in enumerate(blocks):
        for j in range(i):
            other = blocks[j]
            if (
                one.harmonic == other.harmonic
                and one.band[0] < other.band[1]
                and other.band[0] < one.band[1]
            ):
                yield (
                    f"{where} {i + 1}: its band overlaps that of entry {j + 1} at the same "
                    "harmonic; part them"
                )


def _table_problems(where: str, block: Synchronous, axes: int) -> Iterator[str]:
    speeds = block.speeds
    low, high = block.band
    if speeds is None:
        if (
            block.real is not None
            or block.imaginary is not None
            or (block.phase and len(block.phase) != 1)
        ):
            yield f"{where}: speeds are missing for its table; give the speed of every entry"
        return
    if any(b <= a for a, b in itertools.pairwise(speeds)):
        yield complaint(where, "speeds", "not ascending", "ascending", "sort them")
        return
    slack = 1e-9 * high
    if speeds[0] > low + slack or speeds[-1] < high - slack:
        covers = f"{speeds[0]:g} to {speeds[-1]:g} rad/s"
        remedy = "narrow the band, or extend the table"
        yield complaint(
            where,
            "speeds",
            covers,
            f"a range that covers the band of {low:g} to {high:g} rad/s",
            remedy,
        )
    if block.phase is not None:
        if block.real is not None or block.imaginary is not None:
            yield f"{where}: phase and matrices are both given; keep one of the two"
        if len(block.phase) != len(speeds):
            yield complaint(
                where,
                "phase",
                f"a list of {len(block.phase)}",
                f"one per speed, {len(speeds)}",
                "add or drop some",
            )
        return
    if block.real is None:
        yield f"{where}: real is missing for its speeds; give T's real part, or the phase alone"
        return
    for key in ("real", "imaginary"):
        value = getattr(block, key)
        if value is None:
            continue
        try:
            shape = np.array(value, float).shape
        except ValueError:
            shape = ()
        if shape != (len(speeds), axes, axes):
            size = " x ".join(map(str, shape)) if shape else "ragged"
            wanted = f"{len(speeds)} x {axes} x {axes} (speeds, rows, columns)"
            yield complaint(
                where, key, size, wanted, "one matrix per speed, a row and a column per axis"
            )


MOST_ORDER = 8  # of a filter of the signal chain
_COMMON = ("gain", "integral_time", "derivative_time", "notches", "lead", "low_pass")


def controller(machine: MachineDescription) -> Iterator[str]:
    pid = machine.controller
    if pid is None:
        return
    where = "[controller]"
    yield from not_positive(where, pid, "give K_p in A/m", "gain")
    times, filters = (
        ("integral_time", "derivative_time", "derivative_filter"),
        ("low_pass", "low_pass_damping", "lead"),
    )
    yield from not_positive(
        where, pid, "leave it out where there is none", *times, *filters, "tilt_gain", "sample_time"
    )
    yield from not_positive(where, pid, "a controller cannot see ahead", "delay", zero=True)
    sample = pid.sample_time
    yield from not_positive(where, pid, "give it in Hz", "sample_rate")
    if (
        pid.sample_rate is not None
        and pid.sample_rate > 0
        and sample is not None
        and sample >= SAMPLE_TIME
        and not same_clock(sample * pid.sample_rate, 1.0)
    ):
        yield complaint(
            where,
            "sample_time",
            f"{sample:g} s",
            f"1 / sample_rate, {1 / pid.sample_rate:g} s",
            "leave one out",
        )
    if sample is not None and 0 < sample < SAMPLE_TIME:
        yield complaint(
            where, "sample_time", f"{sample:g} s", f"at least {SAMPLE_TIME:g} s", "1e-4 s is usual"
        )
    elif sample is not None and pid.delay is not None and pid.delay > DELAY_SAMPLES * sample > 0:
        most = f"at most {DELAY_SAMPLES} sample times, {DELAY_SAMPLES * sample:g} s"
        yield complaint(where, "delay", f"{pid.delay:g} s", most, "one sample time is usual")
    for i, notch in enumerate(pid.notches):
        inside = f"[[controller.notch]] {i + 1}"
        yield from not_positive(
            inside, notch, "leave the notch out where there is none", "frequency", "pole_damping"
        )
        yield from not_positive(
            inside, notch, "zero is the deepest notch", "zero_damping", zero=True
        )
    if pid.coordinates not in CONTROLLER_COORDINATES:
        known = f"one of {', '.join(CONTROLLER_COORDINATES)}"
        yield complaint(where, "coordinates", shown(pid.coordinates), known, "choose one of them")
        return
    if pid.coordinates == "tilt-translate" and len(machine.bearings) == 1 and pid.tilt_gain != 1:
        yield complaint(
            where,
            "tilt_gain",
            f"{pid.tilt_gain:g}",
            "left out",
            "one bearing cannot tilt the rotor, add a second",
        )
    # what says when controllers run, and the blocks beside them, may stand alone
    if pid.to_dict().keys() - {"sample_time", "sample_rate", "delay", "synchronous"}:
        yield from channel_problems(pid, machine.axes)


def channel_problems(pid: PidSettings, axes: tuple[str, ...]) -> Iterator[str]:
    """Whether every channel has its chain, [controller]'s or one of its own, and what is wrong with
    the sections of these.
    """
    where, modes = "[controller]", pid.coordinates == "tilt-translate"
    known, seen = modal_channels(len(axes) // 2) if modes else axes, dict[str, int]()
    for i, channel in enumerate(pid.channels):
        inside = f"[[controller.channel]] {i + 1}"
        yield from not_positive(inside, channel, "give K_p in A/m", "gain")
        if not channel.names:
            yield complaint(
                inside, "names", "empty", "one channel at least", f"known: {', '.join(known)}"
            )
        for name in channel.names:
            if modes and name in MODES and name not in known:
                yield (
                    f'{inside}: names holds "{name}", but one bearing cannot tilt the rotor; leave '
                    "it out, or add a bearing"
                )
            elif name not in known:
                yield (
                    f'{inside}: names holds "{name}", which is no channel of {pid.coordinates}; '
                    f"{suggestion(name, known)}"
                )
            elif name in seen:
                yield (
                    f'{inside}: "{name}" has its chain in entry {seen[name]} already; name every '
                    "channel once"
                )
            seen.setdefault(name, i + 1)
        for j, section in enumerate(channel.sections):
            yield from section_problems(
                f"{inside}, [[controller.channel.section]] {j + 1}", section
            )
    left = [name for name in known if name not in seen and not (modes and name not in MODES)]
    if left and not pid.gain:
        remedy = "give one value or one per axis" + (
            f", or a chain for {', '.join(left)}" if pid.channels else ""
        )
        yield f"{where}: gain (K_p in A/m) is missing; {remedy}"
    if pid.gain and len(pid.gain) not in ({1} if modes and pid.channels else {1, len(axes)}):
        wanted = (
            "one value beside [[controller.channel]]"
            if modes and pid.channels
            else f"one value or {len(axes)}"
        )
        names = "" if modes and pid.channels else f", one per axis ({', '.join(axes)})"
        yield complaint(where, "gain", f"a list of {len(pid.gain)}", wanted + names, "K_p in A/m")
    idle = [
        key.removesuffix("es") if key == "notches" else key for key in _COMMON if getattr(pid, key)
    ]
    if idle and not left:
        keys = ", ".join(idle)
        yield (
            f"{where}: every channel has its own chain, so that {keys} serves none; move it into "
            "the chains, or leave it out"
        )


def section_problems(where: str, section: Section) -> Iterator[str]:
    """What is wrong with a section of a chain; its numbers are finite."""
    kind = section.kind
    if kind not in SECTIONS:
        yield complaint(
            where,
            "kind",
            shown(kind),
            f"one of {', '.join(SECTIONS)}",
            suggestion(str(kind), SECTIONS),
        )
        return
    keys, inside = SECTIONS[kind], f"{where} ({kind})"
    stated = [key for key in section.to_dict() if key != "kind"]
    for key in stated:
        if key not in keys:
            known = ", ".join(keys)
            yield f"{inside}: {key} is no key of this kind; leave it out, it takes {known}"
    if kind == "pid":
        if section.integral_time is None and section.derivative_time is None:
            yield (
                f"{inside}: neither integral_time nor derivative_time is given; give one, or leave "
                "the section out"
            )
        yield from not_positive(
            inside,
            section,
            "leave it out where there is no such part",
            "integral_time",
            "derivative_time",
        )
        yield from not_positive(
            inside,
            section,
            "0.1 is usual, a pure derivative cannot be realised",
            "derivative_filter",
        )
        return
    missing = [key for key in keys if key not in stated]
    if missing:
        yield f"{inside}: {', '.join(missing)} missing; it takes {', '.join(keys)}"
        return
    if kind == "sos":
        yield from _coefficients(inside, section.numerator or (), section.denominator or ())
        return
    zero = [key for key in keys if key == "zero_damping"]
    yield from not_positive(inside, section, "zero is the deepest notch", *zero, zero=True)
    sizes = [key for key in keys if key not in {"phase", *zero}]
    yield from not_positive(inside, section, "leave the section out where it does nothing", *sizes)
    if kind == "phase-bump" and section.phase is not None and abs(section.phase) > 3:
        yield complaint(
            inside,
            "phase",
            f"{section.phase:g} rad",
            "between -3 and 3 rad",
            'write degrees as "30 deg"',
        )


def _coefficients(
    where: str, numerator: tuple[float, ...], denominator: tuple[float, ...]
) -> Iterator[str]:
    for key, values in (("numerator", numerator), ("denominator", denominator)):
        if len(values) > 3:
            yield complaint(
                where,
                key,
                number(len(values), "coefficients"),
                "three at most",
                "split it into sections",
            )
    degree = [
        max((len(v) - 1 - i for i, x in enumerate(v) if x), default=-1)
        for v in (numerator, denominator)
    ]
    if degree[1] < 0:
        yield complaint(where, "denominator", "zero", "a polynomial", "give [a2, a1, a0]")
    elif degree[0] > degree[1]:
        yield (
            f"{where}: the numerator's degree is above the denominator's, which cannot be "
            "realised; add a pole"
        )


def chain(machine: MachineDescription) -> Iterator[str]:
    """The elements of the signal chain, and whether the loop's delay has room for them."""
    seen: set[str] = set()
    for element in machine.chain:
        where = f"[[chain]] {element.name}"
        if element.name in seen:
            yield f"{where}: the name is listed twice; give every element one of its own"
        seen.add(element.name)
        if element.kind not in CHAIN_KINDS:
            known = f"one of {', '.join(CHAIN_KINDS)}"
            yield complaint(where, "kind", shown(element.kind), known, "choose one of them")
        if (element.delay is None) == (element.corner is None):
            yield f"{where}: it needs a delay or a corner, one of the two; give the one you know"
        yield from not_positive(where, element, "a chain cannot see ahead", "delay", zero=True)
        yield from not_positive(where, element, "give its corner frequency", "corner")
        if not 1 <= element.order <= MOST_ORDER:
            yield complaint(
                where, "order", str(element.order), f"from 1 to {MOST_ORDER}", "2 is usual"
            )
    pid = machine.controller
    usable = all(
        1 <= e.order <= MOST_ORDER and (e.corner is None or e.corner > 0) for e in machine.chain
    )
    if not seen or not usable or pid is None or pid.delay is None:
        return
    total = sum(element.dead_time for element in machine.chain)
    if total > pid.delay * (1 + 1e-9):
        yield (
            f"[[chain]]: its elements take {1e6 * total:.4g} us, more than the delay of "
            f"[controller], {1e6 * pid.delay:.4g} us; leave that out, or correct the elements"
        )
