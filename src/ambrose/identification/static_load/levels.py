"""The steady levels of a record under static loads: where the loads stand still, and what the loop
has settled at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.identification.excitation import signal_rows
from ambrose.identification.output_error.problem import as_records, check_records
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

_BLOCK = 0.01  # [s] over which a load is averaged before its steps are looked for
_STEP = 0.02  # of the loads' range: less is no step but the noise of the force transducer
_BATCHES = 10  # of the averaging window; their scatter gives the mean's standard error
_CHANCE = 1e-3  # probability that noise alone makes any level of a signal drift


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """m steady levels: loads (m, p) [N] at ``ports``, displacement (m, a) [m] at the sensors and
    control current (m, a) [A], each the mean over the end of its level, the current with its
    standard error; record (m,) its number from 1, start (m,) [s].
    """

    ports: tuple[str, ...]
    loads: np.ndarray
    displacement: np.ndarray
    current: np.ndarray
    current_deviation: np.ndarray
    record: np.ndarray
    start: np.ndarray


def steady_levels(
    machine: Machine,
    records: Record | Sequence[Record],
    *,
    average: float = 0.5,
    drift: float = 0.01,
) -> Levels:
    """Every stretch of the records in which no load f_<port> changes, averaged over its last
    ``average`` [s].

    Stretches too short for that are left out. drift: the largest change of a signal's mean between
    both halves of the averaged part, over the range of its means. Raises InvalidInput where nothing
    is loaded, no level is long enough, or a level is not steady (its time and drift are named), and
    for records of another machine or operating point.
    """
    average = check_positive(
        average, "average", "give the seconds to average at the end of every level"
    )
    records = as_records(records)
    check_records(machine, records, one_rate=False)
    _check_free(records)
    ports = tuple(
        dict.fromkeys(
            name[2:] for r in records for name in r.signals if _is_load(name) and r[name].any()
        )
    )
    if not ports:
        raise InvalidInput(
            "the records hold no load: no signal f_<port> differs from zero; record the force "
            "transducer as one"
        )
    size = max(
        float(np.ptp(record[f"f_{port}"]))
        for record in records
        for port in ports
        if f"f_{port}" in record.signals
    )
    rows = []
    for number, record in enumerate(records, 1):
        loads = np.stack(signal_rows(record, [f"f_{port}" for port in ports]))
        y = np.stack([_signal(record, number, ("y",), axis) for axis in machine.axes])
        i = np.stack([_signal(record, number, ("i", "u"), axis) for axis in machine.axes])
        count = max(round(average * record.sample_rate_hz), 2 * _BATCHES)
        for stop in _ends(
            loads, max(round(_BLOCK * record.sample_rate_hz), 1), _STEP * size, count
        ):
            part = slice(stop - count, stop)
            rows.append(
                (
                    loads[:, part].mean(axis=1),
                    _batches(y[:, part]),
                    _batches(i[:, part]),
                    number,
                    record.time[part][0],
                )
            )
    if len(rows) < 2:
        requirement = f"at least 2, each held for more than {average:g} s"
        raise invalid(
            "the number of levels", len(rows), requirement, "hold the loads longer, or average less"
        )
    loads, y, i = (np.array([row[k] for row in rows]) for k in range(3))
    numbers, start = np.array([row[3] for row in rows]), np.array([row[4] for row in rows])
    for kind, batches in (("y", y), ("i", i)):
        _check_steady(machine, kind, batches, numbers, start, drift)
    return Levels(ports, loads, y.mean(axis=2), i.mean(axis=2), _error(i), numbers, start)


def _is_load(name: str) -> bool:
    return name.startswith("f_") and not name.startswith("f_magnet_")


def _check_free(records: tuple[Record, ...]) -> None:
    for number, record in enumerate(records, 1):
        outcome = dict(record.notes).get("outcome", "")
        if outcome.startswith(("touchdown", "diverged", "not levitated")):
            raise InvalidInput(
                f"in record {number} the rotor did not stay free ({outcome}); lower the loads and "
                "measure again"
            )


def _signal(record: Record, number: int, kinds: tuple[str, ...], axis: str) -> np.ndarray:
    for kind in kinds:
        if f"{kind}_{axis}" in record.signals:
            return record[f"{kind}_{axis}"]
    wanted = " or ".join(f"{kind}_{axis}" for kind in kinds)
    raise InvalidInput(
        f"record {number} has no signal {wanted}; it has {', '.join(record.signals)}"
    )


def _ends(loads: np.ndarray, block: int, step: float, least: int) -> list[int]:
    """Ends (sample numbers) of the stretches of at least ``least`` samples, and one block more,
    without a step in any load.
    """
    k = loads.shape[1] // block
    if k == 0:
        return []
    means = loads[:, : k * block].reshape(len(loads), k, block).mean(axis=2)
    inside = np.ptp(loads[:, : k * block].reshape(len(loads), k, block), axis=2)
    noise = np.median(inside, axis=1, keepdims=True)
    moved = (np.abs(np.diff(means, axis=1)) > step).any(axis=0)
    jumps = (inside > 3 * noise + step).any(axis=0)  # a step within the block
    moving = jumps | np.concatenate([[False], moved]) | np.concatenate([moved, [False]])
    ends, begun = [], None
    for j in range(k + 1):
        still = j < k and not moving[j]
        if still and begun is None:
            begun = j
        elif not still and begun is not None:
            if (j - begun - 1) * block >= least:
                ends.append(j * block)
            begun = None
    return ends


def _batches(signals: np.ndarray) -> np.ndarray:
    """Means (a, _BATCHES) of successive parts of signals (a, k)."""
    length = signals.shape[1] // _BATCHES
    return np.asarray(
        signals[:, -length * _BATCHES :].reshape(len(signals), _BATCHES, length).mean(axis=2)
    )


def _error(batches: np.ndarray) -> np.ndarray:
    return np.asarray(batches.std(axis=2, ddof=1) / np.sqrt(_BATCHES))


def _check_steady(
    machine: Machine,
    kind: str,
    batches: np.ndarray,
    number: np.ndarray,
    start: np.ndarray,
    drift: float,
) -> None:
    """Refuse levels whose trend, over half of the averaged part, is more than chance and ``drift``
    of the range.
    """
    from scipy.special import stdtrit

    t = np.arange(_BATCHES) - (_BATCHES - 1) / 2
    slope = batches @ t / (t @ t)
    left = batches - batches.mean(axis=2, keepdims=True) - slope[:, :, None] * t
    chance = np.sqrt((left**2).sum(axis=2) / (_BATCHES - 2) / (t @ t)) * _BATCHES / 2
    change = np.abs(slope) * _BATCHES / 2
    sure = float(stdtrit(_BATCHES - 2, 1 - _CHANCE / 2 / change.size))
    scale = np.ptp(batches.mean(axis=2), axis=0).max()
    if kind == "y":  # a held position has no range of its own: what matters is its share of the gap
        gaps = [bearing.touchdown_gap or bearing.gap for bearing in machine.bearings]
        scale = max(scale, 0.1 * min((gap for gap in gaps if gap is not None), default=0.0))
    excess = change - np.maximum(drift * scale, sure * chance)
    if (excess > 0).any():
        level, axis = (int(place) for place in np.unravel_index(np.argmax(excess), excess.shape))
        unit = "m" if kind == "y" else "A"
        raise invalid(
            f"{kind}_{machine.axes[axis]} at the level from {start[level]:.3g} s in record "
            f"{number[level]}",
            f"still drifting by {change[level, axis]:.2g} {unit} within the averaged time",
            f"steady to {drift:.1%} of its range over the levels",
            "hold the loads longer, or raise the integral action",
        )
