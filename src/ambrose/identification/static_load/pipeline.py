"""K_i from static loads as the command gives it: repeats, the values in the machine as they were, plain data, provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np

from ambrose import __version__
from ambrose.core.checks import invalid
from ambrose.identification.static_load import identify as static_load
from ambrose.identification.static_load.identify import StaticLoad
from ambrose.identification.validation.repeatability import Repeats, of_estimates
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record
from ambrose.physics import magnet

_NORMAL = 1.96  # standard deviations of a 95 % interval


@dataclass(frozen=True, slots=True, eq=False)
class CheckedStaticLoad:
    """result: K_i from all records together; start (a,) [N/A]: the machine's own; repeats: what every record alone gives."""

    result: StaticLoad
    start: np.ndarray
    repeats: Repeats | None = None

    @property
    def good(self) -> bool:
        """Nothing doubtful."""
        return not self.result.warnings


def checked_static_load(
    machine: Machine,
    records: Sequence[Record],
    *,
    repeats: bool = False,
    average: float = 0.5,
    drift: float = 0.01,
    progress: Callable[[str], None] = lambda stage: None,
) -> CheckedStaticLoad:
    """``static_load.identify``; average [s], drift: as there. repeats: each record alone, too, and a standard deviation below
    what their scatter allows for is widened to it. Raises InvalidInput."""
    if repeats and len(records) < 2:
        raise invalid("the number of records", len(records), "at least 2 for repeats", "give every repeat as a record")
    progress("averaging the load levels")
    result = static_load.identify(machine, records, average=average, drift=drift)
    point = result.point
    own = np.concatenate([magnet.linearised(b, point.bias_current).force_per_current for b in machine.bearings])
    if not repeats:
        return CheckedStaticLoad(result, own)
    found = []
    for number, record in enumerate(records, 1):
        progress(f"record {number} of {len(records)} alone")
        found.append(static_load.identify(machine, record, average=average, drift=drift))
    scatter = of_estimates(found)
    wide = np.maximum(result.standard_deviations, scatter.half_width / _NORMAL)
    return CheckedStaticLoad(replace(result, standard_deviations=wide), own, scatter)


def as_dict(checked: CheckedStaticLoad) -> dict[str, Any]:
    """Everything that was found, SI, as plain values for JSON; parameters as those of the other methods."""
    result = checked.result
    rows = zip(
        result.paths, checked.start.tolist(), result.values.tolist(), result.standard_deviations.tolist(),
        result.at_rest.tolist(), result.at_rest_deviations.tolist(), result.stiffness_share.tolist(),
        result.linearity.tolist(), strict=True,
    )  # fmt: skip
    return {
        "machine": result.machine,
        "method": "static",
        "point": {"speed_rad_s": result.point.speed, "seal_pressure_pa": result.point.seal_pressure},
        "good": checked.good,
        "verdict": result.verdict,
        "parameters": [
            {
                "path": path, "unit": "N/A", "start": start, "value": value, "standard_deviation": deviation,
                "interval_95": [value - _NORMAL * deviation, value + _NORMAL * deviation], "at_rest": rest,
                "at_rest_standard_deviation": rest_deviation, "share_by_displacement": share, "linearity": straight,
            }
            for path, start, value, deviation, rest, rest_deviation, share, straight in rows
        ],
        "levels": len(result.levels.loads),
        "findings": [],
        "warnings": list(result.warnings),
        "repeats": None if checked.repeats is None else {
            "count": checked.repeats.count, "values": checked.repeats.values.tolist(), "mean": checked.repeats.mean.tolist(),
            "half_width_95": checked.repeats.half_width.tolist(), "rsd_percent": checked.repeats.rsd.tolist(),
        },
    }  # fmt: skip


def provenance(checked: CheckedStaticLoad, records: Sequence[str], when: str = "") -> tuple[str, str]:
    """One line for the machine's ``source``, and a comment to stand above its file. records: names of their files."""
    result, when = checked.result, when or date.today().isoformat()
    origin = f"{len(result.paths)} values of K_i identified {when} by static loads from {', '.join(records)}"
    lines = [
        f"Identified {when} by ambrose {__version__} from static loads in {', '.join(records)},",
        f"{len(result.levels.loads)} steady levels. Slope of the line over these loads, and at the unloaded working point.",
        f"Verdict: {result.verdict}",
        *[f"Warning: {text}" for text in result.warnings],
    ]
    for i, path in enumerate(result.paths):
        lines.append(
            f"  {path} = {result.values[i]:.6g} N/A, standard deviation {result.standard_deviations[i]:.2g}, at rest "
            f"{result.at_rest[i]:.6g}, in the file before {checked.start[i]:.6g}"
        )
    return origin, "".join(f"# {line}\n" for line in lines) + "\n"
