"""Closed-loop identification: records of the running machine -> its parameters, with what they are worth.

Output error: the loop is simulated as it runs (sampled controller, computing delay, plant held between the samples) from the
recorded excitation, and the parameters are moved until its signals are the measured ones. No noise model enters, so the
estimate is unbiased whatever the colour of the noise; its covariance allows for that colour (sandwich).
Lauridsen's papers P2 and P4 identify in this way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import StateSpace, poles
from ambrose.identify import statistics
from ambrose.identify.excitation import check_persistent, excitation_order
from ambrose.identify.gauss_newton import Linearised, Minimum, minimise
from ambrose.identify.output_error import Task, distinct, normal_equations, projected_jacobian
from ambrose.identify.sensitivities import ParametricModel, loop_model
from ambrose.identify.unknowns import expand, nominal_values
from ambrose.machine.description import Machine, OperatingPoint
from ambrose.machine.record import Record
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import named_controller
from ambrose.plant.model import Plant
from ambrose.plant.reduce import free_mode_reduction

_EARLY = 8000  # samples on which a good start is found
_EXACT = 1e-24  # of the squared signals: a sum of squared residuals below it is rounding
_LAGS = 100  # samples over which the residual is compared with the excitation
_UNSURE, _ALIKE = 0.3, 0.98  # standard deviation over value, and correlation, that are worth a warning


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Parameters (q,) found at the operating point ``point``, SI, in the order of ``paths``; ``start`` is where they began.

    covariance (q, q): under the colour of the residuals (sandwich); standard_deviations (q,). correlation (q, q): of the
    parameters, from (J'J)^-1; column_cosine (q, q): between the columns of J, which is no correlation and mostly has the
    other sign. fit: (record number, signal, NRMSE percent). tests: does a residual still follow an excitation. condition [-]
    of J'J scaled to a unit diagonal. warnings: what makes the result doubtful, in words; verdict: one sentence.
    """

    machine: str
    point: OperatingPoint
    paths: tuple[str, ...]
    values: np.ndarray
    start: np.ndarray
    covariance: np.ndarray
    correlation: np.ndarray
    column_cosine: np.ndarray
    fit: tuple[tuple[int, str, float], ...]
    tests: tuple[statistics.ResidualTest, ...]
    condition: float
    converged: bool
    iterations: int
    warnings: tuple[str, ...]
    verdict: str

    @property
    def standard_deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def identify(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: Any,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    signals: Sequence[str] | None = None,
    weights: Mapping[str, float] | None = None,
    bending_modes: int = 1,
    computing_delay: int = 1,
    initial_state: bool = True,
    offset: bool = True,
    max_iterations: int = 50,
) -> Identification:
    """The parameters at the paths ``unknown`` (machine/parameters.py; "*" for every name or axis) from closed-loop records.

    records: with excitations e_<axis> [A] (or f_<port> [N]) and measured y_<axis> [m], all at one operating point and rate.
    controller: from errors [m] to currents [A], axes by place; continuous, it is sampled by Tustin's map; its output acts
    ``computing_delay`` samples later. start: path -> value to begin at (else the machine's). signals: those fitted (None:
    every y_<axis>); u_ and i_<axis> are possible. weights: signal -> size of its noise [m] or [A] (None: the signal's rms).
    bending_modes: per plane. initial_state, offset: estimated per record, else zero.
    Raises InvalidInput for records that do not belong to this machine, hold too little excitation or say nothing about a
    parameter, and for a start at which the loop is unstable.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    point, dt = check_records(machine, records)
    plant = free_mode_reduction(assemble(machine, point), bending_modes)
    paths = expand(machine, unknown)
    nominal = nominal_values(plant, paths)
    begin = start_values(paths, nominal, start)
    shown = _signals(plant, records, signals)
    excitations = driven_inputs(plant, records, -(-len(paths) // len(shown)))
    law = deployed_controller(plant, controller, dt, computing_delay)
    model = loop_model(plant, law, paths, nominal, excitations, shown)
    sizes = _sizes(records, shown, weights)
    tasks = [
        Task(*distinct(_stacked(record, excitations)), _stacked(record, shown) / sizes[:, None], initial_state, offset)
        for record in records
    ]
    check_start(model, begin)
    found = solve(paths, model, sizes, tasks, begin, np.where(nominal == 0, 1.0, np.abs(nominal)), max_iterations)
    return summary(machine, point, paths, begin, model, sizes, tasks, found)


def solve(
    paths: tuple[str, ...],
    model: ParametricModel,
    sizes: np.ndarray,
    tasks: list[Task],
    begin: np.ndarray,
    scale: np.ndarray,
    most: int,
) -> Minimum:
    """Least squares for theta on all tasks, from a start found on their first samples."""

    def linearise_on(chosen: list[Task]) -> Callable[[np.ndarray], Linearised]:
        def linearise(theta: np.ndarray) -> Linearised:
            loop, directions = _weighted(model, theta, sizes)
            parts = [normal_equations(loop, directions, task) for task in chosen]
            H, g = np.sum([part.H for part in parts], axis=0), np.sum([part.g for part in parts], axis=0)
            statistics.check_visible(paths, H, scale)
            return Linearised(sum(part.cost for part in parts), H, g)

        return linearise

    def stable(theta: np.ndarray) -> bool:
        return _radius(model, theta) < 1

    early = [replace(task, e=task.e[:, :_EARLY], y=task.y[:, :_EARLY]) for task in tasks]
    begun, excited = 0, all(task.e.any(axis=1).all() for task in early)
    if excited and max(task.y.shape[1] for task in tasks) > 3 * _EARLY:
        near = minimise(linearise_on(early), begin, scale, stable, most, tolerance=1e-4)
        if near.converged:  # a good start from the first second; what is found is decided by all samples
            begin, begun = near.x, near.iterations
    found = minimise(linearise_on(tasks), begin, scale, stable, most, floor=_EXACT * sum(float(np.sum(t.y**2)) for t in tasks))
    return replace(found, iterations=found.iterations + begun)


def _weighted(model: ParametricModel, theta: np.ndarray, sizes: np.ndarray) -> tuple[StateSpace, list[Any]]:
    """The loop and its derivatives with the outputs over their weights; C does not depend on theta."""
    loop, directions = model.loop(theta)
    return StateSpace(loop.A, loop.B, loop.C / sizes[:, None], loop.D, loop.inputs, loop.outputs, loop.dt), directions


def _radius(model: ParametricModel, theta: np.ndarray) -> float:
    """The largest modulus of the sampled loop's poles."""
    loop, _ = model.loop(theta)
    return float(np.abs(poles(loop)).max())


def summary(
    machine: Machine,
    point: OperatingPoint,
    paths: tuple[str, ...],
    begin: np.ndarray,
    model: ParametricModel,
    sizes: np.ndarray,
    tasks: list[Task],
    found: Minimum,
) -> Identification:
    """What was found, with covariance, residual tests, warnings and verdict."""
    loop, directions = _weighted(model, found.x, sizes)
    q = len(paths)
    H, middle = np.zeros((q, q)), np.zeros((q, q))
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    count = sum(len(model.signals) * len(task.e) for task in tasks)
    for number, task in enumerate(tasks):
        at, J = projected_jacobian(loop, directions, task)
        H += np.tensordot(J, J, ([1, 2], [1, 2]))
        middle += statistics.sandwich_middle(J, at.residual)
        for i, signal in enumerate(model.signals):
            fits.append((number + 1, signal, statistics.fit_percent(task.y[i], at.residual[i])))
            tests += [
                statistics.residual_input_test(at.residual[i], task.y[i], e, _LAGS, signal, _names(model, mix), count)
                for e, mix in zip(task.e, task.mix.T, strict=True)
            ]
    covariance = statistics.sandwich_covariance(H, middle)
    correlation, cosine = statistics.parameter_correlation(H), statistics.column_cosine(H)
    condition = float(np.linalg.cond(cosine))
    warnings = _warnings(paths, found, covariance, correlation)
    verdict = _verdict(tests)
    if not all(test.passed for test in tests):
        warnings.append(verdict)
    return Identification(
        machine.name, point, paths, found.x, begin, covariance, correlation, cosine, tuple(fits), tuple(tests), condition,
        found.converged, found.iterations, tuple(warnings), verdict,
    )  # fmt: skip


def _names(model: ParametricModel, mix: np.ndarray) -> str:
    """The excitations that a distinct signal drives: "e_A_zeta", or "e_A_zeta, -e_B_zeta"."""
    return ", ".join(("-" if sign < 0 else "") + name for name, sign in zip(model.excitations, mix, strict=True) if sign)


def _warnings(paths: tuple[str, ...], found: Minimum, covariance: np.ndarray, correlation: np.ndarray) -> list[str]:
    texts = []
    if not found.converged:
        texts.append(f"not converged after {found.iterations} steps; begin elsewhere, or leave a parameter out")
    for path, value, deviation in zip(paths, found.x, np.sqrt(np.diag(covariance)), strict=True):
        if value != 0 and deviation > _UNSURE * abs(value):
            texts.append(
                f"{path} = {value:.4g} has the standard deviation {deviation:.2g}: hardly visible in these records; "
                "excite its axis more, record longer, or take it as known"
            )
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1)), strict=True):
        texts.append(
            f"{paths[i]} and {paths[j]} are correlated by {correlation[i, j]:.3f}: hardly told apart; excite where they "
            "differ (other frequencies, other axes), or take one as known"
        )
    return texts


def _verdict(tests: Sequence[statistics.ResidualTest]) -> str:
    failed = [test for test in tests if not test.passed]
    if not failed:
        return "the residuals hold no trace of the excitation: the model explains all that the records tell (99 %)"
    worst = max(failed, key=lambda test: abs(test.correlation) / test.limit)
    return (
        f"the residual of {worst.signal} still follows {worst.excitation} (correlation {worst.correlation:.3f}, "
        f"{abs(worst.correlation) / worst.limit:.1f} times the 99 % limit, {worst.lag} samples later), and so do "
        f"{len(failed) - 1} of {len(tests) - 1} other pairs: the model lacks something - look for a delay, "
        "a different controller, a missing bending mode, magnets beyond their linear range, or a parameter that is not as known"
    )


def check_records(machine: Machine, records: tuple[Record, ...]) -> tuple[OperatingPoint, float]:
    """The operating point and the sample time [s] that all records share, which are of this machine; else InvalidInput."""
    if not records:
        raise InvalidInput("no record was given; identification needs at least one")
    first = records[0]
    for number, record in enumerate(records, 1):
        if record.machine != machine.name:
            remedy = "take that machine's file, or correct the record's attribute machine"
            raise invalid(f"the machine of record {number}", repr(record.machine), repr(machine.name), remedy)
        if abs(record.sample_rate_hz - first.sample_rate_hz) > 1e-9 * first.sample_rate_hz:
            raise invalid(
                f"the sample rate of record {number}", f"{record.sample_rate_hz:g} Hz",
                f"{first.sample_rate_hz:g} Hz, that of the first", "identify them one by one",
            )  # fmt: skip
        if replace(record.point, label="") != replace(first.point, label=""):
            raise invalid(
                f"the operating point of record {number}", record.point, f"{first.point}, that of the first",
                "identify each point on its own",
            )  # fmt: skip
    return first.point, first.dt


def start_values(paths: tuple[str, ...], nominal: np.ndarray, start: Mapping[str, float] | None) -> np.ndarray:
    """The values (q,) to begin at: the machine's, but for those given by path."""
    values = nominal.copy()
    for path, value in (start or {}).items():
        if path not in paths:
            raise invalid("a start value's path", repr(path), f"one of {', '.join(paths)}", "write it as in unknown, without *")
        values[paths.index(path)] = float(check_finite(value, f"the start value of {path}"))
    return values


def _signals(plant: Plant, records: Sequence[Record], signals: Sequence[str] | None) -> tuple[str, ...]:
    possible = [f"{kind}_{axis}" for kind in "yui" for axis in plant.axes]
    wanted = tuple(f"y_{axis}" for axis in plant.axes) if signals is None else tuple(signals)
    for name in wanted:
        if name not in possible or wanted.count(name) > 1:
            raise invalid("a fitted signal", repr(name), f"one of {', '.join(possible)}, once", "correct signals")
        for number, record in enumerate(records, 1):
            if name not in record.signals:
                known = ", ".join(record.signals)
                raise InvalidInput(f"record {number} has no signal {name}; it has {known}; pass signals= with those to fit")
    if not wanted:
        raise InvalidInput("no signal is fitted; name at least one in signals")
    return wanted


def driven_inputs(plant: Plant, records: Sequence[Record], order: int) -> tuple[str, ...]:
    """The inputs driven in any record, after checking that each record excites enough."""
    possible = [f"e_{axis}" for axis in plant.axes] + [f"f_{port}" for port in plant.ports]
    driven = [name for name in possible if any(name in r.signals and r[name].any() for r in records)]
    for number, record in enumerate(records, 1):
        active = [name for name in driven if name in record.signals and np.ptp(record[name]) > 0]
        if not active:
            raise InvalidInput(
                f"record {number} holds no excitation: none of e_<axis>, f_<port> changes in it, and noise alone tells nothing "
                "about the machine; add a PRBS or chirp to the controller's output and record it as e_<axis>"
            )
        best = max(active, key=lambda name: excitation_order(record[name][None], order))
        check_persistent(record[best][None], [best], order)
    return tuple(driven)


def deployed_controller(plant: Plant, controller: Any, dt: float, delay: int) -> StateSpace:
    """The controller as it runs at dt [s], from err_<axis> to u_<axis>, ``delay`` samples late."""
    if isinstance(delay, bool) or not isinstance(delay, int | np.integer) or not 0 <= delay <= 20:
        raise invalid("computing_delay", repr(delay), "a whole number of samples, 0 to 20", "0 or 1 is usual")
    law = named_controller(plant, controller)
    if law.dt is None:
        law = c2d(law, dt, method="tustin")
    elif abs(law.dt - dt) > 1e-6 * dt:
        raise invalid(
            "the records' sample rate", f"{1 / dt:g} Hz", f"the controller's {1 / law.dt:g} Hz",
            "record at the controller's rate, or pass the continuous controller",
        )  # fmt: skip
    return delayed(StateSpace(law.A, law.B, law.C, law.D, law.inputs, law.outputs, dt), int(delay))


def _sizes(records: Sequence[Record], signals: tuple[str, ...], weights: Mapping[str, float] | None) -> np.ndarray:
    sizes = np.array([max(float(np.std(record[name])) for record in records) for name in signals])
    for name, value in (weights or {}).items():
        if name not in signals or not value > 0:
            raise invalid(f"the weight {name!r}", value, f"positive, for one of {', '.join(signals)}", "correct weights")
        sizes[signals.index(name)] = value
    for name, size in zip(signals, sizes, strict=True):
        if size == 0:
            raise InvalidInput(f"signal {name} never changes: a dead sensor or channel; leave it out of signals")
    return sizes


def _stacked(record: Record, names: Sequence[str]) -> np.ndarray:
    k = record.values.shape[1]
    return np.stack([record[name] if name in record.signals else np.zeros(k) for name in names])


def check_start(model: ParametricModel, begin: np.ndarray) -> None:
    """Refuse a start at which the model's loop is unstable."""
    radius = _radius(model, begin)
    if not radius < 1:
        raise invalid(
            "the loop at the start values", f"unstable (pole of modulus {radius:.6g})", "stable, as the recorded loop was",
            "begin with a smaller negative_stiffness or a larger force_per_current, and check controller and computing_delay",
        )  # fmt: skip
