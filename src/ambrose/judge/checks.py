"""What a verification returns: single verdicts, and the curves behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, cast

import numpy as np

from ambrose.core.checks import InvalidInput, check_types
from ambrose.core.presentation import Presented, data_frame, html_table, in_words, with_unit
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.loop import Timing
from ambrose.machine.criteria import Criterion, Demand
from ambrose.machine.machine import Machine
from ambrose.options import Verifying
from ambrose.registry import registered, resolve

_STABILITY = ("stability", "asymptotic stability")  # sources of a limit that only stability sets
_COLUMNS = ("value", "unit", "relation", "limit", "passed", "zone", "detail")


@dataclass(frozen=True, slots=True, repr=False)
class Check(Presented):
    """One criterion, evaluated.

    name: a stable identifier ("sensitivity.output.max"); title: for people; value in ``unit`` (SI);
    limit: None for information only; relation "<", "<=" or ">="; passed: None for information only;
    zone: "A".."D" where a standard has zones; source: standard, edition and clause; detail: where
    or why, in words.
    """

    name: str
    title: str
    value: float
    unit: str
    limit: float | None = None
    relation: str = "<="
    passed: bool | None = None
    zone: str | None = None
    source: str = ""
    detail: str = ""

    def facts(self) -> Mapping[str, Any]:
        """Value against limit, the verdict and where it was found."""
        limit = (
            {}
            if self.limit is None
            else {"limit": f"{self.relation} {self.limit:.4g}", "passed": self.passed}
        )
        zone = {} if self.zone is None else {"zone": self.zone}
        where = {} if not self.detail else {"detail": self.detail}
        return {
            "name": self.name,
            "value": with_unit(self.value, self.unit),
            **limit,
            **zone,
            **where,
        }

    @property
    def ratio(self) -> float | None:
        """The value over its limit, or the limit over the value where large is good: 1 at the
        limit, more beyond it.

        None without a limit; a limit of zero (a count, the real part of a pole) has no ratio: 0
        where it is met, else infinite.
        """
        if self.limit is None:
            return None
        if self.limit <= 0 or math.isnan(self.value):
            return 0.0 if self.passed else math.inf
        if self.relation.startswith(">"):
            return self.limit / self.value if self.value > 0 else math.inf
        return self.value / self.limit


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Curve(Presented):
    """One picture's worth of data: x (n,), y (k, n) with k labels; SI units; ``limits`` are
    labelled horizontal lines.

    kind: "frequency" (x in rad/s), "speed" (x in rad/s), "time" (x in s) or "poles" (x and y are
    real and imaginary parts).
    """

    name: str
    title: str
    kind: str
    x: np.ndarray
    y: np.ndarray
    labels: tuple[str, ...]
    x_unit: str
    y_unit: str
    limits: tuple[tuple[str, float], ...] = ()

    def facts(self) -> Mapping[str, Any]:
        """What is drawn over which range."""
        span = f"{self.x.min():.4g} to {self.x.max():.4g} {self.x_unit}" if self.x.size else "empty"
        return {
            "name": self.name,
            "title": self.title,
            self.kind: span,
            "lines": self.labels,
            "unit": self.y_unit,
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame: the values of x in SI units as its index, one column per line."""
        x = f"{self.kind} [{self.x_unit}]"
        return data_frame(
            {
                x: self.x,
                **{f"{n} [{self.y_unit}]": y for n, y in zip(self.labels, self.y, strict=True)},
            },
            x,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Checks(Presented):
    """The verdict on one closed loop at one operating point, or over a range around it.

    stable: of the loop at its centre, without any perturbation; False means that nothing else was
    evaluated. Of all that the checks cover, see ``holds``, which ``to_dict`` writes.

    notes: what was left out or approximated, and why, one sentence each. found: where in the
    tolerance box the searches found their worst, by parameter, as ``model.uncertainty.perturbed``
    takes it.
    """

    _DATA: ClassVar = ("label", "stable=holds", "passed", "checks")

    label: str
    stable: bool
    checks: tuple[Check, ...]
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()
    found: tuple[Mapping[str, float], ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and every check that has a limit is met."""
        return self.stable and all(check.passed is not False for check in self.checks)

    @property
    def lost(self) -> tuple[Check, ...]:
        """The failed checks that speak of stability: an unstable loop was found within the
        tolerances, or between points.
        """
        return tuple(
            check
            for check in self.failed
            if "stability" in check.name or check.source in _STABILITY
        )

    @property
    def holds(self) -> bool:
        """Whether the loop is stable and no unstable one was found within what these checks
        cover.
        """
        return self.stable and not self.lost

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks whose limit is not met."""
        return tuple(check for check in self.checks if check.passed is False)

    def __getitem__(self, name: str) -> Check:
        """The check of that name; raises KeyError."""
        return {check.name: check for check in self.checks}[name]

    def facts(self) -> Mapping[str, Any]:
        """The verdict, how many checks were made, and which failed."""
        return {
            "label": self.label,
            "stable": self.holds,
            "passed": self.passed,
            "checks": len(self.checks),
            "failed": [check.name for check in self.failed],
        }

    def _repr_html_(self) -> str:
        return checks_table(
            self.checks, f"{self.label}: {'passed' if self.passed else 'not passed'}"
        )

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each check, by name."""
        return data_frame(check_columns(self.checks), "check")

    def curve(self, name: str) -> Curve:
        """The curve of that name; raises KeyError."""
        return {curve.name: curve for curve in self.curves}[name]


def check_columns(checks: Sequence[Check]) -> dict[str, list[Any]]:
    """The checks as columns of a table: name, value, unit, relation, limit, passed, zone,
    detail.
    """
    return {
        "check": [c.name for c in checks],
        **{name: [getattr(c, name) for c in checks] for name in _COLUMNS},
    }


def checks_table(checks: Sequence[Check], caption: str) -> str:
    """The checks as an HTML table, those that failed first."""
    heading = ("check", "value", "limit", "passed", "zone", "where")
    rows = [
        (
            check.title,
            with_unit(check.value, check.unit),
            "" if check.limit is None else f"{check.relation} {check.limit:.4g}",
            "" if check.passed is None else in_words(check.passed),
            check.zone or "",
            check.detail,
        )
        for check in sorted(checks, key=lambda check: check.passed is not False)
    ]
    return html_table(rows, caption, heading)


# A value held against its limit: a Check with verdict and zone. The limits themselves are data
# (machine/criteria.py).


def zone(criterion: Criterion, value: float) -> str | None:
    """The zone of a value; None for a criterion without zones."""
    for limit in criterion.limits:
        if value < limit.value:
            return limit.zone or None
    return criterion.beyond


def holds(value: float, relation: str, limit: float) -> bool:
    """Whether ``value relation limit``; relation "<", "<=" or ">="."""
    return bool({"<": value < limit, "<=": value <= limit, ">=": value >= limit}[relation])


def judge(
    name: str, title: str, value: float, unit: str, wanted: Demand, detail: str = ""
) -> Check:
    """The Check of a value against a Demand, with verdict and zone where there are any."""
    check = Check(
        name,
        title,
        float(value),
        unit,
        wanted.limit,
        wanted.relation,
        source=wanted.source,
        detail=detail,
    )
    if wanted.zones is not None:
        check = replace(check, zone=zone(wanted.zones, value))
    if wanted.limit is not None:
        check = replace(check, passed=holds(value, wanted.relation, wanted.limit))
    return check


def information(
    name: str, title: str, value: float, unit: str, detail: str = "", relation: str = "<="
) -> Check:
    """A Check without a limit; relation "<=" where small is good, ">=" where large is."""
    return Check(name, title, float(value), unit, relation=relation, detail=detail)


def required_line(requirement: float | None) -> tuple[tuple[str, float], ...]:
    """The user's own limit as a labelled horizontal line for a Curve; nothing without one."""
    return () if requirement is None else (("required", float(requirement)),)


def zone_lines(
    criterion: Criterion, requirement: float | None = None, of: str = ""
) -> tuple[tuple[str, float], ...]:
    """Labelled horizontal lines for a Curve: the user's own limit, and the borders "zone A/B" ...
    of the criterion; of: the lines that these judge, where the curve has others.
    """
    above = [*(limit.zone for limit in criterion.limits[1:]), criterion.beyond]
    return required_line(requirement) + tuple(
        (f"zone {limit.zone}/{next_}{of and f' of {of}'}", limit.value)
        for limit, next_ in zip(criterion.limits, above, strict=True)
    )


# What moves while the machine runs, and who proves a loop along it: proofs are registered by the
# annexes that hold them (``ambrose.registry``, kind "moving_proof"), the judge knows none.


Progress = Callable[[str], None]


class MovingProof(Protocol):
    """A registered proof: a module or object with these three."""

    def refuse(self, machine: Machine, law: Law, motion: Verifying) -> None:
        """Raises InvalidInput where the motion that is asked for cannot be examined."""

    def prove(
        self,
        machine: Machine,
        law: Law,
        points: Sequence[Checks],
        timing: Timing | None,
        motion: Verifying,
        progress: Progress,
    ) -> tuple[Checks, ...]:
        """The checks along the motion; ``points``: those at the operating points."""

    def unproved(self, machine: Machine, motion: Verifying) -> str | None:
        """Of what could move and is not proved, a sentence for people; None where there is none."""


def moving_proofs() -> tuple[MovingProof, ...]:
    """The proofs of this installation."""
    return tuple(cast(MovingProof, resolve(place)) for place in registered("moving_proof").values())


def refuse_motion(machine: Machine, law: LawLike, motion: Verifying) -> None:
    """Raises InvalidInput, before anything is computed, where a motion cannot be examined."""
    proofs = moving_proofs()
    if not proofs and (motion.pressure_rate or motion.speed_rate or motion.pressure_error):
        raise InvalidInput(
            "this installation cannot prove stability for changing speed or pressure; leave the "
            "rates out, or install the annex scheduled"
        )
    for proof in proofs:
        proof.refuse(machine, law_of(law), motion)


# The verdict on one controller: its checks at every operating point and over the tolerances, and
# the worst of each.


OVER_TOLERANCES = "over all tolerances"
CONTINUOUS = "continuous: no sample rate is known"
# in the details of what was found on it
WITH_MEAN_DELAY = "of the continuous loop with the mean delay of the sampled one"


THRUST = "thrust: "  # a label of the thrust axis beside those of the radial axes


def box_label(point: str) -> str:
    """The label of the checks over the tolerances around an operating point."""
    return f"{OVER_TOLERANCES} around {point}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Verification(Presented):
    """points: the checks at each operating point. boxes: those over the tolerances around each,
    labelled by ``box_label``. ranges: those over each of the machine's ranges of speed and
    pressure, labelled as it is. moving: those of a seal pressure that changes, where its fastest
    rate is known. synchronous: those of each synchronous block, over its band of speed.

    A point without a box has no tolerance around it, or an unstable loop. left_out: the operating
    points that could not be verified, such as those outside a controller's schedule; a verification
    that leaves a point out is not passed. timing: what loop was judged, "continuous" or "sampled at
    10000 Hz, ...". not_varied: tolerances of the machine file that do not hold around a point, with
    the reason (the file's ``around``, or a nominal value of zero). over_speed: the points beyond
    the machine's own top speed, in words. between: what was checked between the points' speeds, in
    words. controller: which one, with its digest. not_judged: the axes that were asked for and have
    no controller; a verification that lacks one is not passed. axes: the groups of axes judged, of
    a machine that has several. rotor: where it is one as measured, at which speed alone it holds.
    """

    _DATA: ClassVar = (
        "passed",
        "stable",
        "points",
        "tolerances=boxes",
        "ranges",
        "moving",
        "left_out",
        "timing",
        "not_varied",
        "over_speed",
        "between",
        "controller",
        "not_judged",
        "axes",
        "rotor",
    )

    points: tuple[Checks, ...]
    boxes: tuple[Checks, ...] = ()
    left_out: tuple[str, ...] = ()
    timing: str = CONTINUOUS
    not_varied: tuple[str, ...] = ()
    ranges: tuple[Checks, ...] = ()
    moving: tuple[Checks, ...] = ()
    synchronous: tuple[Checks, ...] = ()
    over_speed: tuple[str, ...] = ()
    controller: str = ""
    between: str = ""
    not_judged: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    rotor: str = ""

    def __post_init__(self) -> None:
        check_types(type(self).__post_init__, (self,), {})

    @property
    def labelled(self) -> tuple[tuple[str, Checks], ...]:
        """Every point's label with its checks, then those over the tolerances, over the ranges and
        of what changes.
        """
        every = (*self.points, *self.boxes, *self.ranges, *self.moving, *self.synchronous)
        return tuple((checks.label, checks) for checks in every)

    @property
    def tolerances(self) -> Checks | None:
        """The checks over the tolerances around the first point that has any; None where none were
        made.
        """
        return self.boxes[0] if self.boxes else None

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every operating point that was verified, and no unstable
        one was found over the tolerances, ranges and changes around them.
        """
        return all(checks.holds for _, checks in self.labelled)

    @property
    def passed(self) -> bool:
        """Whether every loop is stable, every limit is met and no operating point or axis was left
        out.
        """
        return (
            bool(self.points)
            and not self.left_out
            and not self.not_judged
            and all(checks.passed for _, checks in self.labelled)
        )

    @property
    def worst(self) -> Mapping[str, Check]:
        """The worst Check of each name; its detail begins with the label of the point where it
        occurs.

        The largest value where small is good (relations "<", "<="), the smallest where large is
        good (">="); NaN is worst.
        """
        worst: dict[str, tuple[float, Check]] = {}
        for label, checks in self.labelled:
            for check in checks.checks:
                badness = -check.value if check.relation.startswith(">") else check.value
                badness = math.inf if math.isnan(badness) else badness
                if check.name not in worst or badness > worst[check.name][0]:
                    detail = f"{label}: {check.detail}" if check.detail else label
                    worst[check.name] = badness, replace(check, detail=detail)
        return {name: check for name, (_, check) in worst.items()}

    def with_thrust(self, thrust: Verification) -> Verification:
        """All five axes: of the axis along the shaft the labels begin with ``THRUST``."""

        def named(several: tuple[Checks, ...]) -> tuple[Checks, ...]:
            around = f"{OVER_TOLERANCES} around "
            starts = (around if checks.label.startswith(around) else "" for checks in several)
            return tuple(
                replace(checks, label=f"{start}{THRUST}{checks.label.removeprefix(start)}")
                for checks, start in zip(several, starts, strict=True)
            )

        timing = self.timing
        if thrust.timing != timing:
            timing = f"{timing}; thrust axis: {thrust.timing}"
        return replace(
            self,
            points=(*self.points, *named(thrust.points)),
            boxes=(*self.boxes, *named(thrust.boxes)),
            ranges=(*self.ranges, *named(thrust.ranges)),
            moving=(*self.moving, *named(thrust.moving)),
            synchronous=(*self.synchronous, *named(thrust.synchronous)),
            left_out=(*self.left_out, *(f"{THRUST}{label}" for label in thrust.left_out)),
            not_varied=(*self.not_varied, *(f"{THRUST}{words}" for words in thrust.not_varied)),
            timing=timing,
            controller=f"{self.controller}; thrust axis: {thrust.controller}",
        )

    def __getitem__(self, label: str) -> Checks:
        """The checks at the operating point of that label; raises KeyError that lists the
        labels.
        """
        table = dict(self.labelled)
        if label not in table:
            raise KeyError(f"{label!r} was not verified; there are {', '.join(map(repr, table))}")
        return table[label]

    def facts(self) -> Mapping[str, Any]:
        """The verdict, what failed, the worst sensitivity and where it was verified."""
        peak = self.worst.get("sensitivity.output.max")
        return {
            "passed": self.passed,
            "stable": self.stable,
            **({} if peak is None else {"worst_sensitivity": peak.value}),
            "failed": list(
                dict.fromkeys(check.name for _, checks in self.labelled for check in checks.failed)
            ),
            **({"left_out": self.left_out} if self.left_out else {}),
            "points": [label for label, _ in self.labelled],
            "loop": self.timing,
        }

    def _repr_html_(self) -> str:
        left_out = f"; left out: {'; '.join(self.left_out)}" if self.left_out else ""
        where = f"the worst of {', '.join(label for label, _ in self.labelled)}{left_out}"
        return checks_table(
            list(self.worst.values()), f"{'passed' if self.passed else 'not passed'}: {where}"
        )

    def to_dict(self) -> dict[str, Any]:
        """The verdict without its curves as JSON-ready data; synchronous blocks where there are."""
        blocks = [checks.to_dict() for checks in self.synchronous]
        return Presented.to_dict(self) | ({"synchronous": blocks} if blocks else {})

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each check at each point: point, check, value, unit,
        relation, limit, ...
        """
        rows = [(label, check) for label, checks in self.labelled for check in checks.checks]
        return data_frame(
            {"point": [label for label, _ in rows], **check_columns([check for _, check in rows])}
        )
