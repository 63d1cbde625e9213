"""The verdict on one controller: its checks at every operating point and over the tolerances, and
the worst of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from ambrose.core.arguments import check_types
from ambrose.core.presentation import Presented, data_frame
from ambrose.judge.checks import Check, Checks, check_columns, checks_table

OVER_TOLERANCES = "over all tolerances"
CONTINUOUS = "continuous: no sample rate is known"
# in the details of what was found on it
WITH_MEAN_DELAY = "of the continuous loop with the mean delay of the sampled one"


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
    the machine's own top speed, in words. controller: which one, with its digest.
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
        "controller",
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
        """Whether every loop is stable, every limit is met and no operating point was left out."""
        return (
            bool(self.points)
            and not self.left_out
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
