"""A controller made ready to run at a sample rate, and whether it may: verified as it will run,
with its delay, everywhere.

Timing: the displacements are read at sample k, the code computes u[k] from e[k], and the currents
reach the amplifiers ``delay`` samples later, held until the next ones. The code holds the
controller without the delay; every verification (judge/sampled.py) holds it with the delay.

Of a scheduled controller every grid point is sampled by itself, in states common to all, and the
code takes the sampled matrices linearly between the points. That is not the sampled form of the
continuous interpolation: Tustin's map bends, which leaves the two apart by second order in the
grid's spacing. ``deviation`` says by how much, and the loop is verified at frozen points as the
code runs it.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any, ClassVar

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, check_positive
from ambrose.core.presentation import Presented, json_text, to_plain, with_unit
from ambrose.core.sampling import Method, delayed
from ambrose.core.scheduled import ScheduledSystem, grid_points, interval_points
from ambrose.core.statespace import StateSpace, poles, spectral_abscissa
from ambrose.judge.checks import Checks
from ambrose.judge.result import Status, synthesis_of
from ambrose.judge.sampled import check_over_box, check_sampled, verify_sampled
from ambrose.law.law import SCHEDULINGS, SPEED, LawLike, Scheduling, law_of, scheduling_named
from ambrose.law.loop import (
    common_states,
    interpolation_deviation,
    sample_controller,
    sample_schedule,
    whole_samples,
)
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import tolerances_around

# What changes in the code when one controller replaces another of the same structure: the entries
# of its tables, and the way back.
#
# difference = parameter_difference(before["controller.c"], after["controller.c"])
# difference.changes, difference.checksum
#
# Two files have the same structure where nothing but numbers in tables, and comments, differ: then
# the tables may be written into the running unit, and nothing else of it changes. A checksum over
# all tables says which of the two a unit holds.


# static const real from_error[NI][NX] = {{1.0, -2.5e-3}, ...};
_TABLE = re.compile(r"static const (\w+) (\w+)((?:\[\w+\])+) =[^{;]*(\{[^;]*\});")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_NUMBER = re.compile(r"[^\s{},]+")
_OWN = "parameters"
DIFFERENCE, BACK = f"{_OWN}.json", f"{_OWN}-back.json"
_HOW = (
    "CRC-32 (IEEE 802.3) over all tables in the order of the C file, each entry in the order of "
    "memory as a little-endian IEEE 754 double"
)


@dataclass(frozen=True, slots=True)
class Change:
    """One entry of a table: its place in memory, counted from 0, and its number before and after,
    as the C file spells them.
    """

    table: str
    index: int
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Difference:
    """changes: of the tables; sizes: entries of every table; checksum_before, checksum: CRC-32 of
    all tables.
    """

    changes: tuple[Change, ...]
    sizes: Mapping[str, int]
    checksum_before: str
    checksum: str

    def reversed(self) -> Difference:
        """The way back."""
        changes = tuple(Change(c.table, c.index, c.after, c.before) for c in self.changes)
        return Difference(changes, self.sizes, self.checksum, self.checksum_before)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, numbers as doubles."""
        rows = [
            {"table": c.table, "index": c.index, "before": before, "after": after}
            for c in self.changes
            for before, after in [(_value(c.before), _value(c.after))]
        ]
        return {
            "checksum_before": self.checksum_before,
            "checksum_after": self.checksum,
            "checksum_is": _HOW,
            "tables": dict(self.sizes),
            "changes": rows,
        }

    def files(self) -> dict[str, str]:
        """{name: text} of the difference and of the way back."""
        both = {DIFFERENCE: self, BACK: self.reversed()}
        return {name: json_text(item.to_dict(), indent=1) + "\n" for name, item in both.items()}

    def apply(self, source: str) -> str:
        """A C file with the changes in its tables. Raises InvalidInput where it does not hold the
        tables that the difference begins from, or would not end with those that it leads to.
        """
        if (found := checksum_of(source)) != self.checksum_before:
            raise InvalidInput(
                f"the tables have the checksum {found}, but the difference begins from "
                f"{self.checksum_before}; read out which controller runs"
            )
        wanted = {(change.table, change.index): change.after for change in self.changes}

        def edited(match: re.Match[str]) -> str:
            count = iter(range(match[4].count(",") + 1))
            entry = lambda own: wanted.get((match[2], next(count)), own[0])  # noqa: E731
            return match[0].replace(match[4], _NUMBER.sub(entry, match[4]))

        text = _TABLE.sub(edited, source)
        if (ended := checksum_of(text)) != self.checksum:
            raise InvalidInput(
                f"the changed tables have the checksum {ended}, not {self.checksum}; the "
                "difference is damaged: export it again"
            )
        return text


def parameter_difference(before: str, after: str) -> Difference:
    """What leads from one C file to another of the same structure.

    Raises InvalidInput that names the first line that differs beside the tables.
    """
    rest = [_TABLE.sub(r"\1 \2\3", _COMMENT.sub("", text)) for text in (before, after)]
    for one, other in zip_longest(*(text.splitlines() for text in rest), fillvalue=""):
        if one.strip() != other.strip():
            line = f"{one.strip() or 'nothing'!s} and {other.strip() or 'nothing'!s}"
            raise InvalidInput(
                f"the two controllers have not the same structure ({line}), so the whole unit "
                "must be replaced; design the new one with the states, or the filters, of the old"
            )
    old, new = _tables(before), _tables(after)
    short = [name for name, entries in old.items() if len(entries) != len(new[name])]
    if short:
        raise InvalidInput(
            f"the table {short[0]} has not the same size in both controllers, so the whole unit "
            "must be replaced"
        )
    changes = tuple(
        Change(name, i, a, b)
        for name, entries in old.items()
        for i, (a, b) in enumerate(zip(entries, new[name], strict=True))
        if _value(a) != _value(b)
    )
    sizes = {name: len(entries) for name, entries in old.items()}
    return Difference(changes, sizes, checksum_of(before), checksum_of(after))


def checksum_of(source: str) -> str:
    """CRC-32 of all tables of a C file, eight hexadecimal digits."""
    numbers = [_value(entry) for entries in _tables(source).values() for entry in entries]
    return f"{zlib.crc32(struct.pack(f'<{len(numbers)}d', *numbers)):08x}"


def _tables(source: str) -> dict[str, list[str]]:
    found = _TABLE.finditer(_COMMENT.sub("", source))
    return {match[2]: _NUMBER.findall(match[4]) for match in found}


def _value(literal: str) -> float:
    return float(literal.rstrip("fFlL")) + 0.0  # no negative zero


BETWEEN = 1  # values in every interval of the grid at which a scheduled loop is verified
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class _Deployed(Presented):
    """What fixed and scheduled controllers share once sampled.

    sizes: of the blocks of the modal form; delay [samples]; checks: the verification at every
    point; box: over the tolerances (empty: none); problems: what speaks against deploying the
    controller, one sentence each. Of a schedule besides points, outside: the verification at the
    machine's own operating points in the range, and at the others, where the code clamps.
    """

    swept: ClassVar[bool] = False  # whether checks are over a range

    sizes: tuple[int, ...]
    delay: int
    method: str
    checks: tuple[Checks, ...] = ()
    box: tuple[Checks, ...] = ()
    problems: tuple[str, ...] = ()
    points: tuple[Checks, ...] = ()
    outside: tuple[Checks, ...] = ()

    def lines(self) -> list[str]:
        """How it was sampled, and what it was verified on, one line each."""
        raise NotImplementedError

    @property
    def verified(self) -> bool:
        """Whether the source was verified and the sampled loop is stable wherever it has to be."""
        return not self.problems

    def facts(self) -> Mapping[str, Any]:
        """Verified or not, states, delay and what speaks against it."""
        facts = {
            "verified": self.verified,
            "states": sum(self.sizes),
            "method": self.method,
            "delay_samples": self.delay,
        }
        return facts | ({"problems": list(self.problems)} if self.problems else {})

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data without the matrices."""
        verdicts = {
            name: [item.to_dict() for item in getattr(self, name)] for name in ("checks", "box")
        }
        return to_plain({**self.facts(), "problems": self.problems, **verdicts})


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Deployment(_Deployed):
    """A controller as it will run.

    controller: sampled, in modal form, without the computing delay; increment (n, n): A - I with
    all its digits; source: what it was made from; checks: at every operating point.
    """

    controller: StateSpace
    increment: np.ndarray
    source: StateSpace

    def lines(self) -> list[str]:
        return [
            f"Sampled    by {self.method}, {self.delay} samples of computing delay in the loop.",
            *(f"Verified   {c.label}: {verdict(c)}." for c in self.checks),
        ]

    @property
    def in_loop(self) -> StateSpace:
        """The controller with its computing delay."""
        return delayed(self.controller, self.delay)


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class ScheduledDeployment(_Deployed):
    """A scheduled controller as it will run.

    sampled: at the grid, in common states, without the computing delay, clamped at the ends;
    increments (k, n, n): A - I with all its digits; source: what it was made from; deviation [-]:
    largest distance, half-way between grid points, from the sampled continuous interpolation,
    relative to its gain at the same frequency, at deviation_at. values, checks: the verification
    over the range; box: over the tolerances at the lowest, a middle and the highest value;
    sizes: of the blocks of the states at the middle of the grid.
    """

    sampled: ScheduledSystem
    increments: np.ndarray
    source: ScheduledSystem
    deviation: float
    deviation_at: Any
    values: Sequence[Any]

    swept: ClassVar[bool] = True

    def lines(self) -> list[str]:
        (low, high), along = self.sampled.range, self.along
        lines = [
            f"Sampled    by {self.method} at every grid point, computing delay in the loop "
            f"[samples]: {self.delay}.",
            f"Between    grid points within {self.deviation:.2g} of the gain of the sampled "
            "continuous controller (worst at "
            f"{along.number(self.deviation_at)}).",
        ]
        if self.checks:
            stable = sum(c.stable for c in self.checks)
            peak, where = sensitivity_peak(self.checks)
            lowest = ", ".join(f"{value:.6g}" for value in (low if along.parts else (low,)))
            lines.append(
                f"Verified   stable at {stable} of {len(self.checks)} frozen {along.plural} "
                f"from {lowest} to "
                f"{along.number(high)}, sensitivity peak {peak:.3g} (at {where})."
            )
        return lines + [f"Verified   {c.label}: {verdict(c)}." for c in self.points]

    @property
    def along(self) -> Scheduling:
        """What it is scheduled over."""
        return SCHEDULINGS[self.sampled.parameter]

    def in_loop(self, value: Any) -> StateSpace:
        """The controller at a frozen speed [rad/s] or pressure [Pa] (or both), with its computing
        delay.
        """
        return delayed(self.sampled.at(value), self.delay)


def deploy(
    controller: LawLike,
    sample_time: float,
    delay: float = 0.0,
    *,
    method: Method = "tustin",
    prewarp: float | None = None,
    plants: Sequence[Plant] = (),
    force: bool = False,
    progress: Progress = lambda stage: None,
) -> Deployment:
    """``controller`` sampled at sample_time [s] and verified with the computing delay [s] in the
    loop.

    controller: a Synthesis or a system, continuous or sampled already. method, prewarp [rad/s]: as
    in ``core.sampling.c2d``. plants: the full plant at every operating point, the nominal one
    first; its machine's tolerances are the uncertainty. Refused unless ``force``: a controller that
    is unstable itself or was not verified, and one whose sampled loop is unstable at an operating
    point or in the tolerances, or was not examined (no plants). Raises InvalidInput (also for a
    delay that is no whole number of samples, and a sample rate too low for the fastest pole, force
    or not) and UnstableSystem.
    """
    check_positive(sample_time, "the sample time", "give it in seconds")
    source = law_of(controller).nominal
    if source is None:
        raise InvalidInput(
            "the controller is a schedule, a program or a function; deploy_scheduled() takes a "
            "schedule, deploy() a fixed one"
        )

    # the controller's own status first: its loop is not closed in vain
    count = whole_samples(delay, sample_time)
    problems = _status_problems(controller, examined=bool(plants)) + instability(source)
    _refuse(problems, force)

    # sampled, and every loop closed with the computing delay
    sampled, increment, sizes = sample_controller(source, sample_time, method, prewarp)
    checks, box = verify_sampled(plants, delayed(sampled, count), progress)
    if not plants:
        problems.append(
            "its sampled loop was not examined: no plant was given (--machine names its file)"
        )
    problems += [f"the sampled loop is unstable at {c.label}" for c in checks if not c.stable]
    problems += [
        f"the sampled loop is unstable at {many} points of the tolerances ({why})"
        for _, many, why in _unstable(box)
    ]
    _refuse(problems, force)
    return Deployment(
        controller=sampled,
        increment=increment,
        sizes=sizes,
        delay=count,
        method=method,
        source=source,
        checks=checks,
        box=box,
        problems=tuple(problems),
    )


def deploy_scheduled(
    controller: LawLike,
    sample_time: float,
    delay: float = 0.0,
    *,
    method: Method = "tustin",
    prewarp: float | None = None,
    machine: Machine | None = None,
    between: int = BETWEEN,
    force: bool = False,
    progress: Progress = lambda stage: None,
) -> ScheduledDeployment:
    """A scheduled ``controller`` sampled at sample_time [s] and verified with the computing delay
    [s] in the loop.

    controller: a Synthesis with a schedule, or a ScheduledSystem over speed [rad/s], pressure [Pa]
    or both. method, prewarp [rad/s]: as in ``deploy``. machine: its full plant is closed at every
    grid point and ``between`` values in every interval, all else as at its first operating point in
    the range (else its first), at its own operating points, and over its tolerances. Refused unless
    ``force``, as ``deploy`` does; operating points outside the range are examined with the clamped
    controller and do not refuse. Motion is not examined. Raises InvalidInput and UnstableSystem.
    """
    check_positive(sample_time, "the sample time", "give it in seconds")
    source = _schedule_of(controller)
    count = whole_samples(delay, sample_time)
    problems = _status_problems(controller, examined=machine is not None)

    # grid points and values between them, at which the law must be stable itself
    values = grid_points([interval_points(axis, between) for axis in source.axes])
    along = scheduling_named(source.parameter, source.unit)
    problems += next(
        filter(None, (instability(source.at(v), f" at {along.number(v)}") for v in values)), []
    )
    _refuse(problems, force)
    progress("sampling at every grid point")

    # common states first, for the code interpolates matrices; then each point is sampled
    common, sizes = common_states(source)
    sampled, increments = sample_schedule(common, sample_time, method, prewarp)
    deviation, where = interpolation_deviation(common, sampled, sample_time, method, prewarp)
    result = ScheduledDeployment(
        sampled=sampled,
        increments=increments,
        sizes=sizes,
        delay=count,
        method=method,
        source=source,
        deviation=deviation,
        deviation_at=where,
        values=values,
    )
    if machine is None:
        problems.append("its sampled loop was not examined: no machine was given")
    else:
        result = _verify_over_range(result, machine, progress)
        unstable = [c.label for c in (*result.checks, *result.points) if not c.stable]
        problems += [f"the sampled loop is unstable at {', '.join(unstable)}"] if unstable else []
        problems += [
            f"the sampled loop is unstable {box} at {many} points ({why})"
            for box, many, why in _unstable(result.box)
        ]
    _refuse(problems, force)
    return replace(result, problems=tuple(problems))


def _schedule_of(controller: LawLike) -> ScheduledSystem:
    """The schedule, clamped at its ends. Raises InvalidInput."""
    source = law_of(controller).schedule
    if source is None:
        raise InvalidInput("the controller has no schedule; deploy() takes a fixed one")
    scheduling_named(source.parameter, source.unit)  # refuses other parameters
    return replace(source, outside="clamp")


def _status_problems(controller: LawLike, *, examined: bool) -> list[str]:
    """What a controller's own status says against it; ``examined``: whether its loop is about to
    be.
    """
    status = synthesis_of(controller).status
    if status is Status.UNCERTIFIED:
        return (
            []
            if examined
            else ["the controller carries no certificate: it was never verified on a plant"]
        )
    return (
        []
        if status is Status.VERIFIED
        else [f"the controller's status is '{status}', not 'verified'"]
    )


def instability(source: StateSpace, where: str = "") -> list[str]:
    """One sentence if the controller itself is unstable; integrators are meant to be on the
    boundary.
    """
    # integrators lie within rounding of the boundary, in proportion to the largest pole
    size = max(float(np.abs(poles(source)).max(initial=0.0)), 1.0)
    abscissa = spectral_abscissa(source)
    if not source.n_states or abscissa <= 1e-9 * size:
        return []
    pole = f"a pole at {abscissa:+.4g} rad/s"
    return [
        f"the controller itself is unstable{where} ({pole}): it runs away whenever the loop is open"
    ]


def _refuse(problems: Sequence[str], force: bool) -> None:
    """Raises UnstableSystem with the problems, if there are any and nobody insists."""
    if problems and not force:
        raise UnstableSystem(
            f"this controller is not deployed: {'; '.join(problems)}; design or verify it "
            "again, or export it in spite of that (force)"
        )


def _unstable(boxes: Sequence[Checks]) -> list[tuple[str, str, str]]:
    """Of every box with unstable points: its label, their number, and which."""
    counts = [(box.label, box["sampled.stability.box"]) for box in boxes]
    return [
        (label, f"{count.value:.0f}", count.detail)
        for label, count in counts
        if count.passed is False
    ]


def _verify_over_range(
    deployment: ScheduledDeployment, machine: Machine, progress: Progress
) -> ScheduledDeployment:
    (low, high), along = deployment.sampled.range, deployment.along
    own = machine.operation.envelope
    inside = [point for point in own if _within(low, along.of(point), high)]

    # all but the parameter as at the first own point within the range, else the first of all
    start = (inside or list(own))[0]

    def check(point: OperatingPoint) -> Checks:
        progress(f"verifying the sampled loop at {point.label}")
        return check_sampled(assemble(machine, point), deployment.in_loop(along.of(point)))

    swept = [replace(along.moved(start, v), label=along.number(v)) for v in deployment.values]
    boxes = []
    if machine.tolerances:
        first = along.of(start)
        source = deployment.source

        # tolerances at both ends and one value between: the start's own, else the middle of
        # the grid
        inner = (
            first
            if _within(low, first, high, strictly=True)
            else source.values[len(source.values) // 2]
        )
        for value in sorted({*grid_points([axis[[0, -1]] for axis in source.axes]), inner}):
            progress(f"verifying the sampled loop over the tolerances at {along.number(value)}")
            plant = assemble(machine, _point_at(machine, start, along, value))

            # over speed every tolerance counts, also those given around other points
            every = (
                [replace(item, around=()) for item in machine.tolerances]
                if along is SPEED
                else None
            )
            if held := tolerances_around(plant, every):
                box = check_over_box(plant, deployment.in_loop(value), held)
                boxes.append(replace(box, label=f"over the tolerances at {along.number(value)}"))
    return replace(
        deployment,
        checks=tuple(check(point) for point in swept),
        points=tuple(check(point) for point in inside),
        outside=tuple(check(point) for point in own if point not in inside),
        box=tuple(boxes),
    )


def _within(low: Any, value: Any, high: Any, strictly: bool = False) -> bool:
    a, v, b = (np.atleast_1d(x) for x in (low, value, high))
    return bool(((a < v) & (v < b)).all() if strictly else ((a <= v) & (v <= b)).all())


def _point_at(
    machine: Machine, start: OperatingPoint, along: Scheduling, value: Any
) -> OperatingPoint:
    """The operating point at another value. At another pressure what is given around the first one
    does not hold: it has the label of the machine's own point there, or none.
    """
    moved = along.moved(start, value)
    if along is SPEED:
        return moved
    own = (
        point for point in machine.operation.envelope if replace(point, label=start.label) == moved
    )
    return next(own, replace(moved, label=""))


def unmet_limits(deployment: Deployment | ScheduledDeployment) -> tuple[str, ...]:
    """The limits that the stable sampled loop misses, in words; they warn and do not stop a
    deployment. Over a schedule each quantity once, where it is worst.
    """
    worst: dict[str, tuple[float, str, int]] = {}
    for checks in (*deployment.checks, *deployment.points, *deployment.box):
        for check in checks.checks:
            if check.passed is not False or check.limit is None:
                continue
            excess = (
                check.limit - check.value if check.relation == ">=" else check.value - check.limit
            )
            value = with_unit(check.value, check.unit)
            text = (
                f"{checks.label}: {check.title} {value} (limit {check.relation} {check.limit:.4g})"
            )
            key = check.name if deployment.swept else text
            most, worst_text, count = worst.get(key, (-np.inf, "", 0))
            worst[key] = (
                (excess, text, count + 1) if excess > most else (most, worst_text, count + 1)
            )
    return tuple(
        f"{text}, worst of {count}" if deployment.swept else text
        for _, text, count in worst.values()
    )


def verdict(checks: Checks) -> str:
    """Of one point, in words."""
    if not checks.stable:
        return "UNSTABLE"
    with suppress(KeyError):
        return f"stable, sensitivity peak {checks['sensitivity.output.max'].value:.3g}"
    return "stable"


def sensitivity_peak(checks: Sequence[Checks]) -> tuple[float, str]:
    """The largest output sensitivity [-] among stable verifications, and where."""
    peaks = [(c["sensitivity.output.max"].value, c.label) for c in checks if c.stable]
    return max(peaks, default=(np.inf, "no point"))
