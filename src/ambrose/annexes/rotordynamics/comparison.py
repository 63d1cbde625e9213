"""``ambrose.compare``: a lateral analysis beside another code's table, beside measured values, or
beside an earlier analysis of the same rotor.

Every critical speed and every mode of theirs gets the one of ours that is nearest in the logarithm
of the speed, so that all pairs together lie as near as they can (each of ours is taken once), and
none further away than ``NEAR``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ambrose.annexes.rotordynamics.json_schema import lateral_schema
from ambrose.annexes.rotordynamics.placement import BACKWARD
from ambrose.annexes.rotordynamics.result import SCHEMA, Lateral
from ambrose.annexes.rotordynamics.standard import MODES_TO, RPM, rpm
from ambrose.annexes.rotordynamics.their_table import TheirRow, read_table
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented, data_frame
from ambrose.machine.json_text import check_form, parse_json
from ambrose.machine.messages import shown
from ambrose.machine.ordinary_file import read_text

NEAR = 0.25  # of the speed: a partner further away is none
_SAME_PEAK = 0.03  # peaks of two placements nearer to each other than this are one
_FAR = 1e6  # cost of a pair that must not be: above any sum of costs of pairs that may
_BYTES = 20_000_000  # of a file, at most; assumed
_AGAIN = "run ambrose lateral --data again"
UM = 1e6  # um per m


@dataclass(frozen=True, slots=True)
class Pair:
    """One quantity of both sides, in ``unit``; ours None: nothing of ours is near.

    where: the row it belongs to, in words. note: what a reader needs to know beside it.
    """

    where: str
    quantity: str
    theirs: float
    ours: float | None
    unit: str
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Ours less theirs, in ``unit``."""
        return None if self.ours is None else self.ours - self.theirs

    @property
    def percent(self) -> float | None:
        """Ours less theirs, of theirs [%]; None without a partner and where theirs is 0."""
        if self.difference is None or not self.theirs:
            return None
        return 100 * self.difference / abs(self.theirs)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        row = {name: getattr(self, name) for name in self.__slots__}
        return row | {"difference": self.difference, "difference_percent": self.percent}


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(Presented):
    """Two sets of results side by side.

    machine: whose they are; theirs_name: what the other side is called. pairs: row by row.
    within [%]: the largest difference that is accepted (None: no verdict).
    """

    _FACTS: ClassVar = ("machine", "theirs=theirs_name", "pairs", "largest_percent", "passed")

    machine: str
    theirs_name: str
    pairs: tuple[Pair, ...]
    within: float | None = None

    @property
    def unpaired(self) -> tuple[Pair, ...]:
        """Rows of theirs to which nothing of ours is near."""
        return tuple(pair for pair in self.pairs if pair.ours is None)

    @property
    def compared(self) -> bool:
        """Whether any row has a partner."""
        return len(self.unpaired) < len(self.pairs)

    @property
    def largest_percent(self) -> float | None:
        """The largest difference [%] of all pairs; None where there is none in per cent."""
        shares = (abs(p.percent) for p in self.pairs if p.percent is not None)
        return max(shares, default=None)

    @property
    def passed(self) -> bool | None:
        """Whether every row has a partner within ``within``; None without a ``within``, but where
        nothing was compared that failed.
        """
        if not self.compared:
            return False
        if self.within is None:
            return None
        alike = all(pair.percent is not None or pair.difference == 0 for pair in self.pairs)
        return not self.unpaired and alike and (self.largest_percent or 0.0) <= self.within

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {
            "machine": self.machine,
            "theirs": self.theirs_name,
            "within_percent": self.within,
            "passed": self.passed,
            "largest_difference_percent": self.largest_percent,
            "rows": [pair.to_dict() for pair in self.pairs],
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row per pair."""
        rows = [pair.to_dict() for pair in self.pairs]
        return data_frame({key: [row[key] for row in rows] for key in rows[0]} if rows else {})


@dataclass(frozen=True, slots=True)
class Theirs:
    """The other side, read: its name, its rows, and the summary's rows of an analysis of ours."""

    name: str
    rows: tuple[TheirRow, ...]
    items: tuple[Mapping[str, Any], ...] = ()


def compare(
    mine: Lateral | Mapping[str, Any] | str | Path,
    theirs: Theirs | Lateral | Mapping[str, Any] | str | Path,
    *,
    within: float | None = None,
) -> Comparison:
    """Critical speeds, amplitudes and log decrements of both sides, with the differences.

    mine: a ``Lateral``, its data, or the path of a lateral.json. theirs: the same, or the path of
    a table (*.csv) of another code or of measurements, whose columns stand in
    ``ambrose.annexes.rotordynamics.their_table``. within [%]: the largest difference accepted.
    Amplitudes are comparable where both sides have the same unbalance. Raises InvalidInput for a
    file that is neither, for unknown columns and units.
    """
    if within is not None and not (math.isfinite(within) and within > 0):
        raise invalid("within", f"{within:g} %", "above 0 %", "leave it out for no verdict")
    ours = _data(mine, "mine")
    other = theirs if isinstance(theirs, Theirs) else read_theirs(theirs)
    pairs = (*_beside_table(ours, other.rows), *_items(ours, other.items))
    return Comparison(ours["machine"], other.name, pairs, within)


def read_theirs(source: Lateral | Mapping[str, Any] | str | Path) -> Theirs:
    """The other side of a comparison, as ``compare`` takes it. Raises InvalidInput."""
    if isinstance(source, str | Path) and Path(source).suffix.lower() != ".json":
        path = Path(source)
        return Theirs(path.name, read_table(read_text(path, "table of results", _BYTES), path.name))
    other = _data(source, "theirs")
    name = f"{other['machine']}, controller {other['controller']}"
    if isinstance(source, str | Path):
        name = Path(source).name
    return Theirs(
        name,
        tuple(_as_table(other)),
        tuple(other["items"]),
    )


def _data(source: Lateral | Mapping[str, Any] | str | Path, side: str) -> Mapping[str, Any]:
    """The data of an analysis whose loop was stable."""
    name = side
    data: Any = source
    if isinstance(source, Lateral):
        data = source.to_dict()
    elif isinstance(source, str | Path):
        name = Path(source).name
        text = read_text(Path(source), "lateral analysis", _BYTES)
        try:
            data = parse_json(text, _AGAIN)
        except InvalidInput as error:
            raise InvalidInput(f"{name} {error}") from None
    if not isinstance(data, Mapping) or not {"schema", "machine", "items", "modes"} <= set(data):
        raise InvalidInput(
            f"{name} is no lateral analysis; give the lateral.json that ambrose lateral --data "
            "writes"
        )
    if data["schema"] != SCHEMA:
        raise InvalidInput(
            f"{name} has schema {data['schema']}, but this version reads {SCHEMA}; run ambrose "
            "lateral again"
        )
    if "response" not in data:
        raise InvalidInput(
            f"{name} has no unbalance response, as its loop is unstable or as an earlier version "
            "wrote it; run ambrose lateral again, with a controller that holds the rotor"
        )
    if not isinstance(source, Lateral):
        try:
            check_form(data, lateral_schema(), _AGAIN)
            _check_curves(data["response"])
        except InvalidInput as error:
            raise InvalidInput(f"{name}: {error}") from None
    return data


def _check_curves(response: Mapping[str, Any]) -> None:
    """Raises InvalidInput where no spline goes through a curve: its speeds do not ascend, or it has
    more or fewer values than speeds.
    """
    speeds = response["speeds_rad_per_s"]
    if len(speeds) < 2 or any(a >= b for a, b in pairwise(speeds)):
        raise InvalidInput(f"response.speeds_rad_per_s must ascend; {_AGAIN}")
    for i, curve in enumerate(response["curves"]):
        for key in ("amplitude_m_pp", "phase_lag_deg"):
            if len(curve[key]) != len(speeds):
                raise InvalidInput(
                    f"response.curves[{i}].{key} has {len(curve[key])} values for {len(speeds)} "
                    f"speeds; {_AGAIN}"
                )


# ----------------------------------------------------------------------------- pairs


def _beside_table(ours: Mapping[str, Any], table: Sequence[TheirRow]) -> list[Pair]:
    """Row by row of the table: critical speeds, then modes, then amplitudes."""
    pairs: list[Pair] = []
    trip = float(ours["speeds_rad_per_s"]["trip"])
    counted = [row for row in table if row.kind == "critical"]
    groups: dict[tuple[str, str], list[TheirRow]] = {}
    for row in counted:
        groups.setdefault((row.probe, row.case), []).append(row)
    for (probe, case), rows in groups.items():
        peaks = _peaks(ours, probe, case)
        at = _at(peaks)
        for row, k in zip(rows, _assign(rows, at), strict=True):
            peak = None if k is None else peaks[k]
            said = "" if peak is not None else _nobody(row, "critical speed", at, trip)
            pairs += _critical_pairs(row, peak, said)
    rows = [row for row in table if row.kind == "mode"]
    modes = [(m["frequency_rad_per_s"], _whirl(m["whirl"])) for m in ours["modes"]]
    top = float(ours.get("modes_up_to_rad_per_s", MODES_TO * trip))
    for row, k in zip(rows, _assign(rows, modes), strict=True):
        mode = None if k is None else ours["modes"][k]
        pairs += _mode_pairs(
            row, mode, "" if mode is not None else _nobody(row, "mode", modes, top)
        )
    splines: dict[tuple[str, str], Any] = {}
    pairs += [_amplitude_pair(ours, row, splines) for row in table if row.kind == "response"]
    return pairs


def _at(peaks: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """(speed [rad/s], no whirl) of our critical speeds."""
    return [(float(peak["speed_rad_per_s"]), "") for peak in peaks]


def _whirl(value: float) -> str:
    if abs(value) <= BACKWARD:
        return "planar"
    return "forward" if value > 0 else "backward"


def _assign(rows: Sequence[TheirRow], ours: Sequence[tuple[float, str]]) -> list[int | None]:
    """For each row the index of its partner of ours (speed, whirl), or None.

    Least sum of |ln(theirs/ours)| over all pairs (Kuhn's assignment). A pair that is too far away,
    or that whirls the other way, costs more than any sum of near ones.
    """
    from scipy.optimize import linear_sum_assignment

    chosen: list[int | None] = [None] * len(rows)
    if not rows or not ours:
        return chosen
    speeds = np.array([speed for speed, _ in ours])
    whirls = np.array([{"forward": 1, "backward": -1}.get(whirl, 0) for _, whirl in ours])
    theirs = np.array([{"forward": 1, "backward": -1}.get(row.whirl, 0) for row in rows])
    with np.errstate(divide="ignore"):  # a mode of 0 rad/s is nobody's partner
        apart = np.abs(np.log(np.array([row.speed for row in rows]))[:, None] - np.log(speeds))
    other = theirs[:, None] * whirls < 0
    cost = np.where((apart <= math.log1p(NEAR)) & ~other, apart, _FAR)
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if cost[i, j] < _FAR:
            chosen[i] = int(j)
    return chosen


def _peaks(ours: Mapping[str, Any], probe: str, case: str) -> list[Mapping[str, Any]]:
    """Our critical speeds: of a probe where one is named (the largest of all placements, or those
    of one), else each where its margin is least.
    """
    if not probe and not case:
        return list(ours["critical_speeds"])
    found: list[Mapping[str, Any]] = []
    for curve in _curves(ours, probe, case):
        for peak in curve["peaks"]:
            same = next((k for k, other in enumerate(found) if _same(peak, other)), None)
            if same is None:
                found.append(peak)
            elif peak["amplitude_m_pp"] > found[same]["amplitude_m_pp"]:
                found[same] = peak
    return found


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    speeds = one["speed_rad_per_s"], other["speed_rad_per_s"]
    return bool(abs(speeds[0] - speeds[1]) <= _SAME_PEAK * max(speeds))


def _curves(ours: Mapping[str, Any], probe: str, case: str) -> list[Mapping[str, Any]]:
    """Our response curves of a probe and a placement, "" for all. Raises InvalidInput."""
    curves = ours["response"]["curves"]
    for key, word in (("reading", probe), ("case", case)):
        names = sorted({curve[key] for curve in curves})
        if word and word not in names:
            called = "probe" if key == "reading" else "case"
            raise InvalidInput(
                f'the {called} "{word}" of the table is not in the analysis; it has '
                f"{', '.join(shown(name) for name in names)}"
            )
        curves = [curve for curve in curves if not word or curve[key] == word]
    return list(curves)


def _critical_pairs(row: TheirRow, peak: Mapping[str, Any] | None, note: str) -> list[Pair]:
    where = row.label or _worded(row, "critical speed")
    found = [Pair(where, "speed", row.speed / RPM, _in_rpm(peak, "speed_rad_per_s"), "rpm", note)]
    if peak is None:
        return found
    if row.amplitude is not None:
        ours = UM * peak["amplitude_m_pp"]
        found.append(Pair(where, "amplitude", UM * row.amplitude, ours, "um p-p"))
    if row.amplification is not None:
        factor = peak["amplification_factor"]
        known = None if isinstance(factor, str) else float(factor)
        said = "" if known is not None else "ours has no half power inside the curve"
        found.append(Pair(where, "amplification factor", row.amplification, known, "-", said))
    return found


def _mode_pairs(row: TheirRow, mode: Mapping[str, Any] | None, note: str) -> list[Pair]:
    where = row.label or _worded(row, "mode")
    speed = Pair(
        where, "frequency", row.speed / RPM, _in_rpm(mode, "frequency_rad_per_s"), "rpm", note
    )
    if mode is None or row.log_decrement is None:
        return [speed]
    return [speed, Pair(where, "log decrement", row.log_decrement, mode["log_decrement"], "-")]


def _amplitude_pair(
    ours: Mapping[str, Any], row: TheirRow, splines: dict[tuple[str, str], Any]
) -> Pair:
    """The largest of our curves at that speed. splines: those of a probe and a case, kept."""
    from scipy.interpolate import CubicSpline

    where = row.label or _worded(row, "response")
    speeds = ours["response"]["speeds_rad_per_s"]
    theirs = UM * float(row.amplitude or 0.0)
    if not speeds[0] <= row.speed <= speeds[-1]:
        note = f"our curves run from {rpm(speeds[0])} to {rpm(speeds[-1])} rpm"
        return Pair(where, "amplitude", theirs, None, "um p-p", note)
    key = row.probe, row.case
    if key not in splines:
        curves = np.array([curve["amplitude_m_pp"] for curve in _curves(ours, *key)])
        splines[key] = CubicSpline(np.asarray(speeds), curves, axis=1)
    return Pair(where, "amplitude", theirs, UM * float(splines[key](row.speed).max()), "um p-p")


def _worded(row: TheirRow, what: str) -> str:
    more = [row.whirl] if row.whirl else []
    more += [
        f'{word} "{name}"' for word, name in (("probe", row.probe), ("case", row.case)) if name
    ]
    return ", ".join([f"{what} at {rpm(row.speed)} rpm", *more])


def _nobody(row: TheirRow, what: str, ours: Sequence[tuple[float, str]], top: float) -> str:
    """Why a row has no partner: the nearest of ours (speed [rad/s], whirl), and how far ours are
    listed, to the speed ``top`` [rad/s].
    """
    listed = f"; ours are listed up to {rpm(top)} rpm" if row.speed > top else ""
    if not ours:
        return f"ours has no {what}{listed}"

    def rank(entry: tuple[float, str]) -> tuple[bool, bool, float]:
        apart = abs(math.log(row.speed / entry[0])) if entry[0] > 0 else math.inf
        other = {row.whirl, entry[1]} == {"forward", "backward"}
        return apart > math.log1p(NEAR), other, apart

    best = min(ours, key=rank)
    far, other, _ = rank(best)
    nearest = f"{rpm(best[0])} rpm" + (f" ({best[1]})" if best[1] and row.whirl else "")
    if far:
        return f"no {what} of ours within {100 * NEAR:g} %, the nearest at {nearest}{listed}"
    reason = "whirls the other way" if other else "is another row's"
    return f"the nearest {what} of ours, at {nearest}, {reason}{listed}"


def _in_rpm(row: Mapping[str, Any] | None, key: str) -> float | None:
    return None if row is None else float(row[key]) / RPM


# ------------------------------------------------------- an earlier analysis as theirs


def _as_table(other: Mapping[str, Any]) -> list[TheirRow]:
    """Critical speeds and modes of an analysis as rows of a table."""
    rows = [
        TheirRow(
            "critical",
            peak["speed_rad_per_s"],
            peak["amplitude_m_pp"],
            None if isinstance(peak["amplification_factor"], str) else peak["amplification_factor"],
        )
        for peak in other["critical_speeds"]
    ]
    rows += [
        TheirRow(
            "mode",
            mode["frequency_rad_per_s"],
            log_decrement=mode["log_decrement"],
            whirl=_whirl(mode["whirl"]),
        )
        for mode in other["modes"]
    ]
    return rows


def _items(ours: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[Pair]:
    """Rows of the summary that both have with a value; critical speeds are paired by speed."""
    mine = {item["name"]: item for item in ours["items"]}
    pairs = []
    for item in items:
        partner = mine.get(item["name"])
        numbers = isinstance(item["value"], int | float)
        if partner is None or not numbers or item["name"].startswith("critical_speed."):
            continue
        value = partner["value"]
        if isinstance(value, int | float) and item["unit"] == partner["unit"]:
            pairs.append(Pair(item["title"], "value", item["value"], value, item["unit"]))
    return pairs
