"""What a [controller] must fulfil: a PID for all axes, chains of filter sections for single
channels, or both.
"""

from __future__ import annotations

from collections.abc import Iterator

from ambrose.core.checks import same_clock
from ambrose.machine.chain import CHAIN_KINDS
from ambrose.machine.controller import (
    CONTROLLER_COORDINATES,
    MODES,
    SECTIONS,
    PidSettings,
    Section,
    modal_channels,
)
from ambrose.machine.description import MachineDescription
from ambrose.machine.limits import DELAY_SAMPLES, SAMPLE_TIME
from ambrose.machine.messages import complaint, number, shown, suggestion
from ambrose.machine.validation.signs import not_positive

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
            yield f"{where}: the name stands there twice; give every element one of its own"
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
