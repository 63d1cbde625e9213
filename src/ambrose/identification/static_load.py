"""K_i from static loads: known forces on the levitated rotor, held by the controller's integrator;
slope of force over current.

The bearing forces follow from statics alone: with the displacement at the sensors known, the
balance of forces and moments of the (flexible) rotor on its couplings and seals leaves exactly one
force per control axis,

    K q = N_f' F + N_b' f_b,   S q = y,      K: rotor, couplings and seals without the magnets,

and k_i is the slope of f_b - k_s q_b over the control current; the second term is zero in paper P2
(section 5), whose A x = b this is. A chord over the loads: it parts from the tangent that small
motion shows where the iron saturates (``local``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, as_several, check_positive, check_shape, invalid
from ambrose.identification.findings import WARNING, Code, Finding, signal_rows
from ambrose.identification.output_error.problem import check_records
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import attached_rotor, bending_modes_of
from ambrose.model.effects import sensor
from ambrose.model.effects.rotor import finite_element_rotor
from ambrose.model.plant import sensor_ports
from ambrose.model.static_load import magnet_coefficients
from ambrose.record.record import Record

# The steady levels of a record under static loads: where the loads stand still, and what the loop
# has settled at.


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
    records = as_several(records)
    check_records(machine, records, one_rate=False)
    _check_free(records)
    ports = tuple(
        dict.fromkeys(
            name[2:] for r in records for name in r.signals if _is_load(name) and r[name].any()
        )
    )
    if not ports:
        raise InvalidInput(
            "the records have no load: no signal f_<port> differs from zero; record the force "
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


_BENDING = 20  # modes per plane that make the rotor's static flexibility; more change nothing
# share of the magnet's force that comes from displacement, above which K_s must be well known
_MOVED = 0.05
_LINEAR = 0.01  # probability below which the straight line is rejected
_SIDED = 0.1  # of the largest load: less on one side of the working point is none
_LIMIT, _NEAR = 0.98, 0.9  # of the current limit; of the touchdown gap


@dataclass(frozen=True, slots=True, eq=False)
class LocalSlopes:
    """Slope (n,) [N/A] between neighbouring levels of one axis: at current (n,) [A] and magnet
    force (n,) [N], both at the middle of the step and relative to the unloaded rotor; deviation
    (n,) [N/A].
    """

    current: np.ndarray
    force: np.ndarray
    slope: np.ndarray
    deviation: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class StaticLoad:
    """K_i by static loads at an operating point; one entry per control axis, in the order of
    ``axes``.

    start (a,) [N/A]: the machine's own. values (a,) [N/A]: slope of the straight line, with
    standard_deviations. at_rest (a,) [N/A]: slope of a cubic through the same levels at the
    unloaded working point - the tangent that small motion sees - with at_rest_deviations. linearity
    (a,): probability that the cubic's improvement is chance. stiffness_share (a,) [-]: part of the
    magnet's force that displacement makes; stiffness_effect (a,) [N/A per N/m]: dK_i/dK_s. forces
    (m, a) [N]: of the magnets, relative to the unloaded rotor. local: slopes between neighbouring
    levels. warnings: what makes the result doubtful; verdict: one sentence.
    """

    machine: str
    point: OperatingPoint
    axes: tuple[str, ...]
    start: np.ndarray
    values: np.ndarray
    standard_deviations: np.ndarray
    at_rest: np.ndarray
    at_rest_deviations: np.ndarray
    linearity: np.ndarray
    stiffness_share: np.ndarray
    stiffness_effect: np.ndarray
    levels: Levels
    forces: np.ndarray
    local: tuple[LocalSlopes, ...]
    warnings: tuple[Finding, ...]
    verdict: str

    @property
    def paths(self) -> tuple[str, ...]:
        """The parameters' paths in the machine: "bearing.A.force_per_current.zeta"."""
        return tuple(
            f"bearing.{bearing}.force_per_current.{way}"
            for bearing, way in (a.rsplit("_", 1) for a in self.axes)
        )

    def widened(self, least: np.ndarray) -> StaticLoad:
        """The same with standard deviations of at least ``least`` (a,)."""
        return replace(self, standard_deviations=np.maximum(self.standard_deviations, least))


def identify(
    machine: Machine,
    records: Record | Sequence[Record],
    *,
    negative_stiffness: ArrayLike | None = None,
    average: float = 0.5,
    drift: float = 0.01,
) -> StaticLoad:
    """K_i of every axis from records of static loads f_<port> [N] with y_<axis> [m] and i_<axis>
    (or u_<axis>) [A].

    negative_stiffness (a,) [N/m]: K_s, which weights what is left of the displacement (None: the
    machine's at the records' operating point). average [s]: the end of every level that is
    averaged; drift: how much of the levels' range a signal may still change in that time. Each axis
    must be loaded; loads on both sides of the working point are wanted (P2: four directions).
    Raises InvalidInput for levels that are not steady, an axis without load, a rotor that touches,
    currents at their limit, and records that do not belong to this machine.
    """
    levels = steady_levels(machine, records, average=average, drift=drift)
    records = as_several(records)
    point, axes = records[0].point, machine.axes
    k_s = _stiffness(machine, point, negative_stiffness)
    forces, places = bearing_forces(machine, point, levels)
    relative = forces - _unloaded(levels, forces)
    _check_range(machine, levels, places)
    _check_loaded(axes, relative)
    force = forces - k_s * places
    rows = [_regressed(axis, levels.current[:, i], force[:, i]) for i, axis in enumerate(axes)]
    effect = np.array([_slope(levels.current[:, i], -places[:, i]) for i in range(len(axes))])
    share = np.ptp(k_s * places, axis=0) / np.ptp(force, axis=0)
    local = tuple(
        _local(levels, i, force[:, i] - _unloaded(levels, force[:, i])) for i in range(len(axes))
    )
    values, deviations, at_rest, rest_deviations, linearity = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    warnings = tuple(_warnings(axes, relative, share, linearity, values, at_rest))
    coefficients = magnet_coefficients(machine, point)[0]
    return StaticLoad(
        machine.name,
        point,
        axes,
        coefficients,
        values,
        deviations,
        at_rest,
        rest_deviations,
        linearity,
        share,
        effect,
        levels,
        relative,
        local,
        warnings,
        _verdict(axes, linearity, values, at_rest),
    )


def bearing_forces(
    machine: Machine, point: OperatingPoint, levels: Levels
) -> tuple[np.ndarray, np.ndarray]:
    """Force of the magnets on the rotor (m, a) [N] and displacement at the magnets (m, a) [m] at
    every level.

    From the balance of forces and moments of the flexible rotor; weight is left out, a constant.
    Raises InvalidInput for a load at a port that the machine has not.
    """
    rotor = finite_element_rotor(machine)
    system = attached_rotor(machine, point, rotor, min(_BENDING, bending_modes_of(rotor)))
    axes, n = machine.axes, system.n
    at = [system.inputs.index(f"f_{axis}") for axis in axes]
    for port in levels.ports:
        if f"f_{port}" not in system.inputs:
            known = ", ".join(name.removeprefix("f_") for name in system.inputs)
            raise invalid(
                "a load's port",
                repr(port),
                f"one of {known}",
                "name the signal f_<port>, or add a disc there",
            )
    # on the rotor alone
    outside = [
        f"o_{port}" if f"o_{port}" in system.inputs else f"f_{port}" for port in levels.ports
    ]
    N_b, N_f = system.B[:, at], system.B[:, [system.inputs.index(name) for name in outside]]
    sensor_rows = [system.outputs.index(f"s_{port.name}") for port in sensor_ports(machine)]
    S = sensor.means(machine.sensor_pairs, axes) @ system.C[sensor_rows]
    # takes the magnets out again
    K = system.stiffness + N_b @ np.diag(_stiffness(machine, point, None)) @ N_b.T
    # of the rows: rigid modes have no stiffness
    size = np.sqrt(np.maximum(np.abs(np.diag(K)), np.abs(N_b).max() ** 2 * 1e6))
    matrix = np.block(
        [
            [K / size / size[:, None], -N_b / size[:, None]],
            [S / size, np.zeros((len(axes), len(axes)))],
        ]
    )
    right = np.vstack([N_f @ levels.loads.T / size[:, None], levels.displacement.T])
    columns = np.abs(matrix).max(axis=0)
    rows = np.abs(matrix / columns).max(axis=1)
    solution = (
        np.linalg.solve(matrix / columns / rows[:, None], right / rows[:, None]) / columns[:, None]
    )
    q, f = solution[:n] / size[:, None], solution[n:]
    return f.T, (N_b.T @ q).T


def _stiffness(machine: Machine, point: OperatingPoint, stated: ArrayLike | None) -> np.ndarray:
    if stated is not None:
        return check_shape(stated, "negative_stiffness", "(a)", a=len(machine.axes))
    return magnet_coefficients(machine, point)[1]


def _check_range(machine: Machine, levels: Levels, places: np.ndarray) -> None:
    for j, bearing in enumerate(machine.bearings):
        both = slice(2 * j, 2 * j + 2)
        gap = bearing.touchdown_gap or bearing.gap
        reach = float(np.hypot(*places[:, both].T).max())
        if gap is not None and reach > _NEAR * gap:
            raise invalid(
                f"the rotor's displacement at bearing {bearing.name}",
                f"{reach * 1e6:.0f} um",
                f"below {_NEAR:.0%} of the touchdown gap of {gap * 1e6:.0f} um, as it must not "
                "touch",
                "lower the loads, or let the controller hold the position",
            )
        for axis, most in zip(
            machine.axes[both], np.abs(levels.current[:, both]).max(axis=0), strict=True
        ):
            if bearing.max_current is not None and most > _LIMIT * bearing.max_current:
                raise invalid(
                    f"the current of {axis}",
                    f"{most:.3g} A",
                    f"below its limit of {bearing.max_current:g} A",
                    "lower the loads: at the limit the current no longer answers them",
                )


def _check_loaded(axes: tuple[str, ...], forces: np.ndarray) -> None:
    most = np.abs(forces).max(axis=0)
    for axis, largest in zip(axes, most, strict=True):
        if largest < _SIDED * most.max():
            raise InvalidInput(
                f"axis {axis} carries no load ({largest:.3g} N of {most.max():.3g} N); "
                "its K_i cannot be found; load the rotor along every actuator axis, "
                "in both directions"
            )


def _regressed(
    axis: str, current: np.ndarray, force: np.ndarray
) -> tuple[float, float, float, float, float]:
    """Slope and its deviation, slope of a cubic at the middle level's current and its deviation,
    probability of the line.
    """
    from scipy.special import betainc

    spread = float(np.ptp(current))
    m = len(current)
    if m < 3:
        raise invalid(
            f"the number of load levels of {axis}",
            m,
            "at least 3",
            "apply more levels, the unloaded rotor included",
        )
    slope, deviation, line = _least_squares(current[:, None], force)
    if m < 6 or len(np.unique(np.round(current / spread, 3))) < 5:
        return slope[0], deviation[0], slope[0], deviation[0], 1.0
    t = current - current[np.argmin(np.abs(force - np.median(force)))]
    cubic, errors, curve = _least_squares(
        np.column_stack([t, t**2 / spread, t**3 / spread**2]), force
    )
    free = m - 4
    gained, left = max(line - curve, 0.0) / 2, curve / free
    probability = (
        0.0 if left == 0 else float(betainc(free / 2, 1.0, free / (free + 2 * gained / left)))
    )
    return slope[0], deviation[0], cubic[0], errors[0], probability


def _least_squares(columns: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (c,) of the columns (m, c) beside a constant, their standard deviations (c,),
    the sum of squares left.
    """
    A = np.column_stack([np.ones(len(y)), columns])
    size = np.linalg.norm(A, axis=0)
    coefficients, *_ = np.linalg.lstsq(A / size, y, rcond=None)
    left = float(np.sum((y - A / size @ coefficients) ** 2))
    free = len(y) - A.shape[1]
    covariance = np.linalg.inv((A / size).T @ (A / size)) * (left / free if free > 0 else 0.0)
    return coefficients[1:] / size[1:], np.sqrt(np.diag(covariance))[1:] / size[1:], left


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / (x @ x))


def _unloaded(levels: Levels, values: np.ndarray) -> np.ndarray:
    """The mean over the levels with the least load."""
    size = np.linalg.norm(levels.loads, axis=1)
    return np.asarray(values[size <= size.min() + 1e-3 * size.max()].mean(axis=0))


def _local(levels: Levels, i: int, force: np.ndarray) -> LocalSlopes:
    """Between neighbouring levels of an axis, sorted by force; levels of nearly the same force are
    one.
    """
    current = levels.current[:, i] - float(_unloaded(levels, levels.current[:, i]))
    order = np.argsort(force)
    breaks = np.flatnonzero(np.diff(force[order]) > 0.02 * np.ptp(force)) + 1
    groups = np.split(order, breaks)
    f, x = (np.array([values[group].mean() for group in groups]) for values in (force, current))
    error = np.array(
        [np.sqrt((levels.current_deviation[group, i] ** 2).sum()) / len(group) for group in groups]
    )
    slope = np.diff(f) / np.diff(x)
    deviation = np.abs(slope / np.diff(x)) * np.hypot(error[1:], error[:-1])
    return LocalSlopes((x[1:] + x[:-1]) / 2, (f[1:] + f[:-1]) / 2, slope, deviation)


def _warnings(
    axes: tuple[str, ...],
    forces: np.ndarray,
    share: np.ndarray,
    linearity: np.ndarray,
    values: np.ndarray,
    at_rest: np.ndarray,
) -> Iterator[Finding]:
    for i, axis in enumerate(axes):
        low, high = -forces[:, i].min(), forces[:, i].max()
        if min(low, high) < _SIDED * max(low, high):
            evidence = "friction, hysteresis and saturation then shift its slope unseen"
            what = f"{axis} was loaded to one side only"
            yield Finding(Code.ONE_SIDED, WARNING, what, evidence, "load it in both directions")
        if share[i] > _MOVED:
            what = f"at {axis} {share[i]:.0%} of the magnet's force comes from displacement"
            evidence = "the position is not held (a controller without integrator?)"
            yield Finding(
                Code.NOT_HELD,
                WARNING,
                what,
                evidence,
                "K_i is as uncertain as the K_s taken for it",
            )
        if linearity[i] < _LINEAR and abs(values[i] / at_rest[i] - 1) > 0.01:
            what = f"force over current of {axis} is curved"
            both = (
                f"{at_rest[i]:.4g} N/A at the working point, {values[i]:.4g} N/A as a line over "
                "these loads"
            )
            yield Finding(
                Code.CURVED,
                WARNING,
                what,
                f"{both} (the iron saturates)",
                "small motion finds the first",
            )


def _verdict(
    axes: tuple[str, ...], linearity: np.ndarray, values: np.ndarray, at_rest: np.ndarray
) -> str:
    bent = [i for i in range(len(axes)) if linearity[i] < _LINEAR]
    if not bent:
        return "force over current is a straight line on every axis (99 %)"
    worst = max(bent, key=lambda i: abs(values[i] / at_rest[i] - 1))
    return (
        f"force over current is curved on {', '.join(axes[i] for i in bent)}: at {axes[worst]} "
        "the line over these loads is "
        f"{100 * (values[worst] / at_rest[worst] - 1):+.1f} % from the slope at the working point"
    )
