"""The magnets' own nonlinearity in a record, found beside the linear loop and taken out of it.

A magnet pair is odd in (i, x): without a load its first terms beyond k_i i + k_s x are cubic; a
static load i_0 adds quadratic ones, which grow with i_0. As forces they pass the linear loop,
driven by the currents and displacements that it has itself (the second order of a Volterra series;
Rugh 1981). So what they do to the outputs is known but for a few amplitudes: the static load of
every axis, and one for the cubic terms of all, which is 1 if the magnets are as in the machine
file. Those are found by one step of least squares beside the parameters; values fitted to what is
then left are those of small motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.special

from ambrose.core.checks import AmbroseError
from ambrose.core.frequency import frequency_response
from ambrose.core.response import simulate
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.excitation import signal_rows
from ambrose.identification.output_error.closed_loop import LeastSquares, ParameterEstimate, fit
from ambrose.identification.output_error.lagged_products import coloured_products
from ambrose.identification.output_error.normal_equations import (
    Task,
    jacobian_pieces,
    normal_equations,
    residual_pieces,
    synchronised,
)
from ambrose.identification.output_error.problem import (
    Experiment,
    build_experiment,
    deployed_controller,
)
from ambrose.identification.output_error.residual_analysis import residual_scores
from ambrose.identification.output_error.statistics import TurningWave
from ambrose.identification.parameters import plant_at
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, TIMING, parse_parameter
from ambrose.model.effects import magnet
from ambrose.model.plant import Plant
from ambrose.model.static_load import operating_magnets
from ambrose.record.record import Record

_LOAD = 0.25  # of the bias current: the load that amplitude 1 of a quadratic signal stands for
_PASSES = 2  # fits of the force, each on the records that the one before cleaned
# of the change that the correction makes: standard deviation for terms beyond the third; assumed
_TRUNCATED = 0.05
_PIECE = 65_536  # samples at a time
_GRID = 7  # points of current and of displacement, on which the terms are fitted
# of i and x
_POWERS = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)])
# standard deviations from which on the nonlinearity is believed, and within which it may differ
# from the file's
_CERTAIN = 4.0
# by so much more the cubic terms may differ from the file's, and so many bias currents a load may
# have
_OFF = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class MagneticForce:
    """loads {axis: static current [A]}, cubic terms (1: as in the machine file), amplitudes (a +
    1,) of the candidates, and the share of what the linear model left that they explain. widening
    (q,): variances that their own uncertainty adds to the fitted parameters'. responses: one (p, k)
    per record in the fitted signals, SI.
    """

    loads: Mapping[str, float]
    cubic: float
    amplitudes: np.ndarray
    explains: float
    widening: np.ndarray
    signals: tuple[str, ...]
    responses: tuple[np.ndarray, ...]

    def less(self, records: Sequence[Record]) -> tuple[Record, ...]:
        """The records without what the nonlinearity makes of the fitted signals; others that no fit
        needs are left out.
        """
        done = []
        for record, response in zip(records, self.responses, strict=True):
            needed = ("y_", "u_", "e_", "f_", "r_", "p_", "speed")
            rest = {
                name
                for name in record.signals
                if not name.startswith(needed) or name.startswith("f_magnet_")
            }
            kept = [
                j for j, name in enumerate(record.signals) if name not in rest - set(self.signals)
            ]
            names, values = tuple(record.signals[j] for j in kept), record.values[kept]
            for name, row in zip(self.signals, response, strict=True):
                values[names.index(name)] -= row
            values.flags.writeable = False  # or the record would copy it
            done.append(
                replace(
                    record, signals=names, units=tuple(record.units[j] for j in kept), values=values
                )
            )
        return tuple(done)

    @property
    def words(self) -> str:
        """One sentence without its stop."""
        loads = ", ".join(f"{value:.3g} A on {axis}" for axis, value in self.loads.items())
        return (
            f"the magnets' own nonlinearity makes {100 * self.explains:.3g} % of the linear "
            "model's residual and is taken out: "
            f"static loads of about {loads}, cubic terms {self.cubic:.2g} times the machine file's"
        )


def magnetic_force(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
    before: MagneticForce | None = None,
) -> MagneticForce | None:
    """What the magnets add to a fit of the linear loop; None where it is not certain, or not what
    magnets do.

    records: those of ``experiment``, of which ``result`` is the fit; ``before`` is out of them
    already, and in what is found.
    """
    if isinstance(machine, AxialMachine):
        return None  # the lag of its core is not in the magnets' force law
    by_path = dict(zip(result.paths, result.values.tolist(), strict=True))
    delay = (
        by_path.get(CONTROLLER_DELAY, experiment.options.computing_delay * experiment.dt)
        / experiment.dt
    )
    values = {path: value for path, value in by_path.items() if path not in TIMING}
    model = experiment.models[0]
    try:
        plants = [
            plant_at(machine, record.point, values, experiment.options.bending_modes)
            for record in records
        ]
        waves = []
        for number, (plant, record) in enumerate(zip(plants, records, strict=True), 1):
            law = deployed_controller(plant, controller, record.dt, round(delay))
            turning = _turning_motion(
                plant, law, record.dt, [wave for wave in result.turning if wave.record == number]
            )
            waves.append(
                nonlinear_responses(
                    plant, law, record, model.excitations, experiment.signals, turning
                )
            )
            waves[-1] /= experiment.sizes[:, None].astype(np.float32)
    # no magnet follows from these coefficients, or the loop with a whole delay is none that runs
    except AmbroseError:
        return None
    step, covariance, widening, gained = _step(
        *_normal(experiment, result.values, waves), len(result.values)
    )
    amplitudes = step if before is None else before.amplitudes + step
    if not _plausible(amplitudes, covariance):
        return None
    axes = plants[0].axes
    bias = [_bias(plants[0], j) for j in range(len(axes))]
    loads = {
        axis: float(_LOAD * i_0 * amplitude)
        for axis, i_0, amplitude in zip(axes, bias, amplitudes, strict=False)
    }
    responses = tuple(
        experiment.sizes[:, None] * np.tensordot(amplitudes.astype(np.float32), wave, 1)
        for wave in waves
    )
    explains = gained if before is None else before.explains
    return MagneticForce(
        loads, float(amplitudes[-1]), amplitudes, explains, widening, experiment.signals, responses
    )


def _step(
    H: np.ndarray, middle: np.ndarray, g: np.ndarray, cost: float, q: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """The best amplitudes (b,) beside q parameters, their covariance (b, b), the variances (q,)
    that this adds to the parameters', and the share of the cost that is gained; zero where a signal
    is.
    """
    size = np.sqrt(np.diag(H))
    parameters, extra = (
        np.arange(q),
        q + np.flatnonzero(size[q:] > 1e-9 * size[q:].max(initial=0.0)),
    )

    # Parameters eliminated: X = H_qq^-1 H_qb, slope g_b - X'g_q, H_bb - H_bq X left.
    X = np.linalg.solve(H[np.ix_(parameters, parameters)], H[np.ix_(parameters, extra)])
    slope = g[extra] - X.T @ g[parameters]
    W = np.vstack([-X, np.eye(len(extra))])
    both = np.concatenate([parameters, extra])
    unit = np.outer(size[extra], size[extra])

    # pseudo-inverse: the signals may depend on each other
    inverse = (
        np.linalg.pinv(
            (H[np.ix_(extra, extra)] - H[np.ix_(extra, parameters)] @ X) / unit,
            rcond=1e-8,
            hermitian=True,
        )
        / unit
    )

    # sandwich: the slope is W' J'r with W = [-X; I]
    step_covariance = inverse @ W.T @ middle[np.ix_(both, both)] @ W @ inverse
    step, covariance = np.zeros(len(H) - q), np.zeros((len(H) - q, len(H) - q))
    step[extra - q] = inverse @ slope
    covariance[np.ix_(extra - q, extra - q)] = step_covariance
    return (
        step,
        covariance,
        np.einsum("qb,bc,qc->q", X, step_covariance, X),
        float(slope @ inverse @ slope) / cost,
    )


def _plausible(amplitudes: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether noise cannot make it, and magnets can. Cubic terms resemble changed parameters: the
    quadratic ones must tell.
    """
    even, deviations = np.flatnonzero(np.diag(covariance)[:-1] > 0), np.sqrt(np.diag(covariance))
    if not len(even):
        return False

    # a' Cov^-1 a of the quadratic ones is chi^2 for noise; as rare as _CERTAIN deviations
    statistic = (
        amplitudes[even]
        @ np.linalg.pinv(covariance[np.ix_(even, even)], hermitian=True)
        @ amplitudes[even]
    )
    certain = scipy.special.chdtrc(len(even), statistic) < 2 * scipy.special.ndtr(-_CERTAIN)
    loads = np.abs(amplitudes[:-1]) <= _OFF / _LOAD + _CERTAIN * deviations[:-1]
    return bool(
        certain and loads.all() and abs(amplitudes[-1] - 1) <= _OFF + _CERTAIN * deviations[-1]
    )


def _normal(
    experiment: Experiment, theta: np.ndarray, waves: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """J'J (q + b, q + b), the covariance of J'r, J'r and r'r at theta (q,), with the signals (b, p,
    k) of every record over the weights, which are left without the nuisances.
    """
    loops = LeastSquares(experiment, normal_equations).loops(theta)
    parts = []
    for task, given in zip(experiment.tasks, waves, strict=True):
        loop, directions = loops[task.place]
        turning = synchronised(loop, task)
        solution = normal_equations(loop, directions, turning)

        # with an unknown delay of the excitation the first samples are not fitted
        start = getattr(experiment.models[task.place], "skipped", 0)
        D = given[:, :, start : start + task.samples]
        _clean(D, turning)
        covariance = residual_scores(
            loop, turning, solution, ["e"] * len(task.e), experiment.signals, 1
        ).covariance

        H, g = 0.0, 0.0

        def pieces(
            made: Any = (loop, directions, turning, solution), D: np.ndarray = D
        ) -> Iterator[np.ndarray]:
            return _stacked(jacobian_pieces(*made), D)

        for J, r in zip(pieces(), residual_pieces(loop, turning, solution), strict=True):
            rows, left = J.reshape(len(J), -1), r[: len(experiment.signals)].ravel()
            H, g = H + rows @ rows.T, g + rows @ left
        parts.append((H, coloured_products(pieces(), covariance), g, solution.equations.cost))
    return tuple(sum(items) for items in zip(*parts, strict=True))  # type: ignore[return-value]


def _stacked(pieces: Iterable[np.ndarray], D: np.ndarray) -> Iterator[np.ndarray]:
    """Pieces of J (q, p, length) with those of D (b, p, k) below."""
    begin = 0
    for J in pieces:
        yield np.concatenate([J, D[:, :, begin : begin + J.shape[2]]])
        begin += J.shape[2]


def _clean(D: np.ndarray, task: Task) -> None:
    """Take out of the signals (b, p, k) what constants and turning waves explain, which are
    nuisances anyway.
    """
    if not task.waves:
        return
    square, product = np.zeros((task.waves, task.waves)), np.zeros((*D.shape[:2], task.waves))
    for part in _stretches(task.samples):
        W = task.waves_at(part.start, part.stop)
        square, product = square + W @ W.T, product + D[:, :, part] @ W.T
    amplitudes = np.linalg.lstsq(square, product.reshape(-1, task.waves).T)[0].T.reshape(
        product.shape
    )
    for part in _stretches(task.samples):
        D[:, :, part] -= amplitudes @ task.waves_at(part.start, part.stop)


def _stretches(samples: int) -> Iterator[slice]:
    """A long record piece by piece, so that what is made on the way does not grow with it."""
    for start in range(0, samples, _PIECE):
        yield slice(start, min(start + _PIECE, samples))


def without_magnets(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
) -> tuple[MagneticForce | None, tuple[Record, ...], Experiment, ParameterEstimate]:
    """What the magnets add to ``result``, and the records, their experiment and its fit without it;
    as given where nothing.
    """
    force, kept = None, (tuple(records), experiment, result)
    for _ in range(_PASSES):
        further = magnetic_force(machine, kept[0], controller, kept[1], kept[2], force)
        if further is None:
            break
        cleaned = further.less(records)
        try:
            task = build_experiment(machine, cleaned, controller, result.paths, experiment.options)
            fitted = replace(
                fit(task, dict(zip(result.paths, kept[2].values.tolist(), strict=True))),
                start=result.start,
            )
        except AmbroseError:
            break
        if not fitted.converged:
            break
        force, kept = replace(further, responses=()), (cleaned, task, fitted)
    if force is None:
        return None, *kept

    # variances add: noise, the amplitudes' own, terms beyond the third
    sure = np.hypot(
        kept[2].standard_deviations,
        np.hypot(np.sqrt(force.widening), _further_terms(result, kept[2].values)),
    )
    return force, kept[0], kept[1], kept[2].widened(sure)


def _further_terms(result: ParameterEstimate, values: np.ndarray) -> np.ndarray:
    """Standard deviations (q,) for what is left of the nonlinearity: a part of the change, relative
    the largest of its kind.
    """
    change, size = np.abs(values - result.values), np.abs(values)
    kinds = np.array(
        [path if path in TIMING else parse_parameter(path).quantity for path in result.paths]
    )
    for kind in set(kinds):
        alike = (kinds == kind) & (size > 0)
        if alike.any():
            change[alike] = (change[alike] / size[alike]).max() * size[alike]
    return np.asarray(_TRUNCATED * change)


def _turning_motion(
    plant: Plant, law: StateSpace, dt: float, waves: Sequence[TurningWave]
) -> list[tuple[float, np.ndarray]]:
    """Frequency [rad/s] and phasors (2 a,) of coil currents, then displacements, of what turns with
    the rotor: y_ as it was fitted, and what the controller makes of it.
    """
    axes, found = plant.axes, []
    for frequency in dict.fromkeys(wave.frequency for wave in waves):
        phasors = {
            wave.signal: wave.amplitude * np.exp(1j * wave.phase)
            for wave in waves
            if wave.frequency == frequency
        }
        y = np.array([phasors.get(f"y_{axis}", 0.0) for axis in axes])
        omega = np.array([2 * np.pi * frequency])

        # the hold's response, e^(-j w dt/2) sinc(f dt);   i = -G_iu K y hold
        hold = np.exp(-0.5j * omega[0] * dt) * np.sinc(frequency * dt)
        coils = select(plant.system, plant.named("u"), [f"i_{axis}" for axis in axes])
        i = (
            -frequency_response(coils, omega).values[0]
            @ frequency_response(law, omega).values[0]
            @ y
            * hold
        )
        found.append((float(omega[0]), np.concatenate([i, y])))
    return found


def nonlinear_responses(
    plant: Plant,
    law: StateSpace,
    record: Record,
    excitations: Sequence[str],
    signals: Sequence[str],
    turning: Sequence[tuple[float, np.ndarray]] = (),
) -> np.ndarray:
    """The candidates (a + 1, p, k) in the signals (p,) of a record: quadratic terms of every axis,
    then all cubic ones.

    plant: reduced, with the parameters that were found; law: the controller as it runs; turning:
    frequency and phasors (2 a,) of currents, then displacements, that no excitation makes. Raises
    InvalidInput where no magnet follows from the coefficients.
    """
    loop, axes = closed_loop(plant, law), plant.axes
    driven = np.array(signal_rows(record, excitations))
    responses = np.empty((len(axes) + 1, len(signals), driven.shape[1]), np.float32)
    cubic = np.empty((len(axes), driven.shape[1]), np.float32)

    # current and displacement of each axis in the linear loop, what turns added
    for j, axis in enumerate(axes):
        moved = simulate(select(loop, excitations, [f"i_{axis}", f"q_{axis}"]), driven)
        for part in _stretches(moved.shape[1] if turning else 0):
            t = record.dt * np.arange(part.start, part.stop)
            for omega, phasors in turning:
                moved[:, part] += (phasors[j :: len(axes), None] * np.exp(1j * omega * t)).real
        _replaced(moved, plant, j)
        responses[j], cubic[j] = simulate(select(loop, [f"f_{axis}"], signals), moved[:1]), moved[1]

    # the cubic forces of all axes at once: one amplitude
    responses[-1] = simulate(select(loop, [f"f_{axis}" for axis in axes], signals), cubic)
    return responses


def _replaced(moved: np.ndarray, plant: Plant, j: int) -> np.ndarray:
    """Current and displacement (2, k) of axis number j, replaced by its quadratic and its cubic
    force.
    """
    largest = [float(np.abs(row).max()) for row in moved]
    if not all(largest):
        moved[:] = 0.0
        return moved
    bias = _bias(plant, j)
    i, x = moved
    records_without = []
    p = operating_magnets(plant.machine, plant.point.bias_current)[j // 2].of_force
    for load, power in ((_LOAD * bias, 2), (0.0, 3)):
        terms, chosen = _terms(p, plant.axes[j], load, *largest), _POWERS.sum(axis=1) == power
        records_without.append(
            sum(c * i**m * x**n for c, (m, n) in zip(terms[chosen], _POWERS[chosen], strict=True))
        )
    moved[:] = records_without
    return moved


def _bias(plant: Plant, j: int) -> float:
    """The bias current [A] of axis number j at the plant's operating point."""
    return plant.point.bias_current or plant.machine.bearings[j // 2].bias_current


def _terms(p: tuple[float, ...], axis: str, load: float, i: float, x: float) -> np.ndarray:
    """Coefficients (10,) of i^m x^n in an axis' force about a load [A], up to currents i [A] and
    displacements x [m]; p: what ``magnet.force`` needs.
    """
    second = axis.endswith("_eta")
    at = np.linspace(-1.0, 1.0, _GRID)
    force = np.zeros((_GRID, _GRID))
    for j, current in enumerate(load + i * at):
        for k, shift in enumerate(p[9 if second else 6] + x * at):
            zeta, eta = ((0.0, 0.0), (current, shift)) if second else ((current, shift), (0.0, 0.0))
            force[j, k] = magnet.force(zeta[0], eta[0], zeta[1], eta[1], p)[second]

    # in units of the largest i and x, so that the columns are of one size
    basis = np.stack([at[:, None] ** m * at[None] ** n for m, n in _POWERS], axis=-1).reshape(
        -1, len(_POWERS)
    )
    fitted = np.linalg.lstsq(basis, force.ravel())[0]
    return np.asarray(fitted / i ** _POWERS[:, 0] / x ** _POWERS[:, 1])
