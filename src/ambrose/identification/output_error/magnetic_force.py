"""The magnets' own nonlinearity in a record, found beside the linear loop and taken out of it.

A magnet pair is odd in (i, x): without a load its first terms beyond k_i i + k_s x are cubic; a
static load i_0 adds quadratic ones, which grow with i_0. As forces they pass the linear loop,
driven by the currents and displacements that it has itself (the second order of a Volterra series;
Rugh 1981). So what they do to the outputs is known but for a few amplitudes: the static load of
every axis, and one for the odd terms of all (third and fifth order), which is 1 for magnets that
have the coefficients found. Those are found by one step of least squares beside the parameters;
values fitted to what is then left are those of small motion.

Where the excitation is weak the record says little about the amplitudes, and cubic terms resemble
changed parameters. So what magnets can do is known beforehand: the loads, as recorded mean currents
or the file's weight say, to within a tenth of the bias current (any load, where a record is certain
of another); cubic terms of one to within a half, from none at all to twice the file's in two
standard deviations (they go with the square of gap and bias; iron takes from them). Both are
joined, and what stays unknown widens the parameters' intervals.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.special

from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.findings import signal_rows
from ambrose.identification.output_error.closed_loop import LeastSquares, ParameterEstimate, fit
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
from ambrose.identification.output_error.statistics import (
    TurningWave,
    coloured_products,
    residual_scores,
)
from ambrose.identification.parameters import plant_at
from ambrose.identification.validation.places import recorded_means
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, TIMING, parse_parameter
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.axial import AtPoint, Side, closed_lags, core_lags, loaded, sides, with_found
from ambrose.model.effects import magnet
from ambrose.model.effects.magnet import slopes, with_coefficients
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients, operating_magnets
from ambrose.record.record import Record

# What a thrust bearing's magnets make of a record beyond their linear force, as the loop answers.
#
# Currents i and displacements x of the linear loop drive both magnets' circuits about the working
# point; what their force has beyond its linear part passes the loop, which moves i and x, and so on
# until nothing changes. With flux phi = phi_0 + d, coil current I_0 + i and G(phi, g) = rho g phi +
# R_f phi phi_s/(phi_s - phi), what the flux meets at once (``model.axial``):
#
#     (R + c sqrt(s)) d = N i - (G(phi, g - x) - G(phi_0, g) - R d),    R = dG/dphi at rest,
#
# solved by itself: the bracket is of second order and late by the core's lag at the working point.


_ROUNDS = 4  # of the flux, and of the loop: each is smaller by the share that is nonlinear
_FULL = 0.999  # of the flux limit: the linear loop knows none
_REACH = 0.9  # of a gap: what the linear loop may use for the circuit to have an answer


def thrust_responses(
    plant: Plant,
    law: StateSpace,
    record: Record,
    excitations: Sequence[str],
    signals: Sequence[str],
    coefficients: tuple[float, float],
    turning: Sequence[tuple[float, np.ndarray]] = (),
) -> np.ndarray:
    """(1, p, k): what the nonlinear magnets add to the signals (p,) of a record.

    plant: reduced, with the parameters that were found; law: the controller as it runs;
    coefficients: k_i [N/A] and k_s [N/m] that were found; turning: frequency [rad/s] and phasors
    (2,) of current and displacement that no excitation makes. Raises InvalidInput where no such
    magnets are found, or the linear loop leaves their gaps.
    """
    machine = plant.machine
    (axis,), at = machine.axes, machine.condition(plant.point)
    part = with_found(machine.thrust, at.load, at.place, *coefficients)
    loop = closed_loop(plant, law)
    own = [f"i_{axis}", f"q_{axis}"]
    moved = simulate(select(loop, excitations, own), np.array(signal_rows(record, excitations)))
    t = record.dt * np.arange(moved.shape[1])
    for omega, phasors in turning:
        moved += (phasors[:, None] * np.exp(1j * omega * t)).real
    answer = select(loop, [f"f_{axis}"], [*own, *signals])
    made = np.zeros((len(own) + len(signals), moved.shape[1]))
    for _ in range(_ROUNDS):
        beyond = _beyond(part, at.load, at.place, moved + made[: len(own)], record.dt)
        # the working point is the record's mean, which the force's own mean is part of
        made = simulate(answer, _between(beyond - beyond.mean())[None])
    return made[None, len(own) :].astype(np.float32)


def _between(v: np.ndarray) -> np.ndarray:
    """A smooth signal (k,) as what a system that holds its input from sample to sample needs: the
    mean of each sample and the next.
    """
    return np.asarray((v + np.append(v[1:], v[-1:])) / 2)


def _beyond(
    part: ThrustBearing, load: float, place: float, moved: np.ndarray, dt: float
) -> np.ndarray:
    """Force (k,) [N] beyond the linear one for currents and displacements (2, k) about a working
    point, held from sample to sample.
    """
    at = loaded(part, load, place)
    gaps = part.gap[0] + place, part.gap[1] - place
    if np.abs(moved[1]).max(initial=0.0) > _REACH * min(gaps):
        raise InvalidInput(
            f"the linear loop leaves the gap of {part.name}; record with a smaller excitation"
        )
    left, right = (
        _side_beyond(side, coil, gap, point, lag, way * moved, dt)
        for side, coil, gap, point, lag, way in zip(
            sides(part),
            (-at.current, at.current),
            (place, -place),
            (at.left, at.right),
            core_lags(part),
            (-1.0, 1.0),
            strict=True,
        )
    )
    return right - left


def _side_beyond(
    side: Side,
    control: float,
    opened: float,
    at: AtPoint,
    model: object,
    moved: np.ndarray,
    dt: float,
) -> np.ndarray:
    """Force (k,) towards one side beyond its linear part: control current [A] and gap [m] added at
    the working point, current and displacement (2, k) towards the side.
    """
    gap = side.gap + opened
    phi_0 = side.flux(side.bias + control, gap)
    met = side.met(phi_0, gap)
    lag = None if model is None else _sampled_lag(model, at.ratio, dt)
    i, x = moved
    drive = side.turns * i

    def late(v: np.ndarray) -> np.ndarray:
        return v if lag is None else np.asarray(simulate(lag, _between(v)[None])[0])

    # linear: d = h (N i + rho phi_0 x)/R
    linear = late((drive + side.slope * phi_0 * x) / met)
    d = linear
    for _ in range(_ROUNDS):
        bracket = _meets(side, phi_0 + d, gap - x) - _meets(side, phi_0, gap) - met * d
        d = late((drive - bracket) / met)

    # F = rho phi^2/2, less its linear part rho phi_0 d
    return np.asarray(side.slope * (d**2 / 2 + phi_0 * (d - linear)))


def _meets(side: Side, flux: np.ndarray | float, gap: np.ndarray | float) -> np.ndarray:
    """G(phi, g) [A]."""
    iron: np.ndarray | float = side.iron
    if not np.isinf(side.flux_limit):
        iron = (
            side.iron
            * side.flux_limit
            / (side.flux_limit - np.minimum(flux, 0.999 * side.flux_limit))
        )
    return np.asarray((side.slope * gap + iron) * flux)


def _sampled_lag(model: object, ratio: float, dt: float) -> StateSpace:
    A, B, C = closed_lags(model, ratio)  # type: ignore[arg-type]
    return c2d(StateSpace(A, B[:, None], C[None], np.zeros((1, 1)), ["v"], ["h"]), dt)


_LOAD = 0.25  # of the bias current: the load that amplitude 1 of a quadratic signal stands for
_PASSES = 2  # fits of the force, each on the records that the one before cleaned
# of the change that the correction makes: standard deviation for terms beyond the third; assumed
_TRUNCATED = 0.05
_PIECE = 65_536  # samples at a time
_GRID = 7  # points of current and of displacement, on which the terms are fitted
# of i and x
_POWERS = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)])
_ODD = np.array([(order - n, n) for order in (3, 5) for n in range(order + 1)])  # of i and x
# known beforehand of the amplitudes, assumed: standard deviations of a load about the file's, and
# of any load
_NEAR, _ANY = 0.1 / _LOAD, 0.5 / _LOAD
_CUBIC = (1.0, 0.5)  # mean and standard deviation of the cubic terms; assumed
_CERTAIN = 4.0  # standard deviations from which on a record says that there is, or is not
_RARE = 0.01  # as rare as this among magnets: something else made it
_ALIKE = 1e-8  # of the largest: what signals have of their own, below which it is rounding
_UNTOLD = 1e6  # variance of amplitudes that a record says nothing of
_SAID = 2.0  # standard deviations from which on a static load is told
# of a parameter's standard deviation: a change by the nonlinearity that is not worth another fit
_SMALL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MagneticForce:
    """loads {axis: static current [A]} that the records tell, cubic terms (1: of magnets with the
    coefficients found), amplitudes (a + 1,) of the candidates, and the share of what the linear
    model left that they explain. widening (q,): variances that their own uncertainty adds to the
    fitted parameters'; moved (q,): what the last step of the amplitudes makes of the parameters, to
    first order. believed: they are those of magnets; else they are what magnets would make.
    responses: one (p, k) per record in the fitted signals, SI.
    """

    loads: Mapping[str, float]
    cubic: float
    amplitudes: np.ndarray
    explains: float
    widening: np.ndarray
    moved: np.ndarray
    believed: bool
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
        loads = f"static loads of about {loads}" if loads else "no static load"
        sizes = f"{loads}, cubic terms {self.cubic:.2g} times those of such magnets"
        if len(self.amplitudes) == 1:  # of a thrust bearing at its place, in one
            sizes = f"it is {self.cubic:.2g} times that of the machine file's magnets"
        return (
            f"the magnets' own nonlinearity makes {100 * self.explains:.3g} % of the linear "
            f"model's residual and is taken out: {sizes}"
        )


def magnetic_force(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
    before: MagneticForce | None = None,
) -> MagneticForce | None:
    """What the magnets add to a fit of the linear loop; None where the record shows that they add
    nothing, or no magnet follows from the coefficients.

    records: those of ``experiment``, of which ``result`` is the fit; ``before`` is out of them
    already, and in what is found.
    """
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
            driven = (plant, law, record, model.excitations, experiment.signals)
            waves.append(
                thrust_responses(*driven, _thrust_coefficients(plant, values), turning)
                if not machine.lateral
                else nonlinear_responses(*driven, turning, magnets_found(plant, values))
            )
            waves[-1] /= experiment.sizes[:, None].astype(np.float32)
    # no magnet follows from these coefficients, or the loop with a whole delay is none that runs
    except AmbroseError:
        return None
    found = _step(*_normal(experiment, result.values, waves), len(result.values))
    taken = np.zeros(len(found.amplitudes)) if before is None else before.amplitudes
    told = taken + found.amplitudes
    if _linear(told, found.covariance):
        return None
    loads = _loads(machine, plants[0], records)
    amplitudes, covariance, believed = _joined(told, found.covariance, loads)
    sure = np.abs(amplitudes) > _SAID * np.sqrt(np.diag(covariance))
    carried = {
        plants[0].axes[j]: float(_LOAD * _bias(plants[0], j) * amplitudes[j])
        for j in range(len(amplitudes) - 1)
        if sure[j]
    }
    responses = tuple(
        experiment.sizes[:, None] * np.tensordot(amplitudes.astype(np.float32), wave, 1)
        for wave in waves
    )
    return MagneticForce(
        carried,
        float(amplitudes[-1]),
        amplitudes,
        found.gained if before is None else before.explains,
        np.einsum("qb,bc,qc->q", found.moved, covariance, found.moved),
        found.moved @ (amplitudes - taken),
        believed,
        experiment.signals,
        responses,
    )


def _loads(machine: Machine, plant: Plant, records: Sequence[Record]) -> np.ndarray:
    """Loads (a,) in amplitudes as known beforehand: recorded mean currents, else those that carry
    the file's weight; none along the shaft, whose point has its thrust.
    """
    if not machine.lateral:
        return np.zeros(0)
    recorded = recorded_means(records)
    by_file = (
        i for item in operating_magnets(machine, plant.point.bias_current) for i in item.currents
    )
    currents = [recorded.get(axis, i) for axis, i in zip(plant.axes, by_file, strict=True)]
    return np.array([i / (_LOAD * _bias(plant, j)) for j, i in enumerate(currents)])


def _thrust_coefficients(plant: Plant, values: Mapping[str, float]) -> tuple[float, float]:
    """k_i [N/A] and k_s [N/m] of the thrust magnets, as far as they were found."""
    found = {parse_parameter(path).quantity: value for path, value in values.items()}
    k_i, k_s = magnet_coefficients(plant.machine, plant.point)
    return (
        found.get("force_per_current", float(k_i[0])),
        found.get("negative_stiffness", float(k_s[0])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """The best step of the amplitudes (b,) beside q parameters, its covariance (b, b), what an
    amplitude makes of the parameters (q, b), and the share of the cost that is gained.
    """

    amplitudes: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    gained: float


def _step(H: np.ndarray, middle: np.ndarray, g: np.ndarray, cost: float, q: int) -> _Step:
    """By least squares, with the normal equations of ``_normal``; zero where a signal is, of an
    infinite variance.
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

    # of what depends on each other, in units of the signals' sizes, only what is there is told
    left, vectors = np.linalg.eigh(
        (H[np.ix_(extra, extra)] - H[np.ix_(extra, parameters)] @ X) / unit
    )
    there = left > _ALIKE * left.max(initial=0.0)
    inverse = (vectors[:, there] / left[there]) @ vectors[:, there].T / unit
    untold = _UNTOLD * vectors[:, ~there] @ vectors[:, ~there].T * size[extra].max(initial=0.0) ** 2

    # sandwich: the slope is W' J'r with W = [-X; I]
    step_covariance = inverse @ W.T @ middle[np.ix_(both, both)] @ W @ inverse + untold / unit
    b = len(H) - q
    step, covariance = np.zeros(b), np.diag(np.full(b, np.inf))
    step[extra - q] = inverse @ slope
    covariance[np.ix_(extra - q, extra - q)] = step_covariance

    # the parameters take -X a of a signal that is there and not fitted: taking it out moves them
    moved = np.zeros((q, b))
    moved[:, extra - q] = -X
    return _Step(step, covariance, moved, float(slope @ inverse @ slope) / cost)


def _linear(amplitudes: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether the record holds nothing of it although it would show: a linear simulation's."""
    deviations = np.sqrt(np.diag(covariance))
    none = (np.abs(amplitudes) <= _CERTAIN * deviations).all()
    return bool(none and abs(amplitudes[-1] - 1) > _CERTAIN * deviations[-1])


def _joined(
    amplitudes: np.ndarray, covariance: np.ndarray, loads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Amplitudes (b,) and their covariance (b, b) with what is known of them beforehand, the loads
    (b - 1,) of ``_loads``, and whether both agree; where they do not, what is known beforehand
    alone.

    P^-1 = S^-1 + P_0^-1 and a = P (S^-1 a_found + P_0^-1 a_0), as gains, K = P_0 (P_0 + S)^-1:
    a = a_0 + K (a_found - a_0), P = (I - K) P_0. What has no signal keeps its zero.
    """
    told = np.isfinite(np.diag(covariance))
    S, found = covariance[np.ix_(told, told)], amplitudes[told]
    mean = np.append(loads, _CUBIC[0])[told]

    # another load than that, but for certain: any load is as likely
    P_0 = np.diag(np.append(np.full(len(loads), _NEAR), _CUBIC[1])[told] ** 2)
    believed = _rare(found - mean, P_0 + S) > _RARE
    even = slice(0, -1)
    if not believed and _rare(found[even], S[even, even]) < 2 * scipy.special.ndtr(-_CERTAIN):
        P_0 = np.diag(np.append(np.full(len(loads), _ANY), _CUBIC[1])[told] ** 2)
        mean = np.append(np.zeros(len(loads)), _CUBIC[0])[told]
        believed = _rare(found - mean, P_0 + S) > _RARE
    K = np.linalg.solve(P_0 + S, P_0).T if believed else np.zeros_like(P_0)

    a, P = np.zeros_like(amplitudes), np.zeros_like(covariance)
    a[told] = mean + K @ (found - mean)
    P[np.ix_(told, told)] = P_0 - K @ P_0
    return a, P, believed


def _rare(off: np.ndarray, covariance: np.ndarray) -> float:
    """Share of draws further off than this: chi^2 of off' covariance^-1 off."""
    if not len(off):
        return 1.0
    statistic = off @ np.linalg.pinv(covariance, hermitian=True) @ off
    return float(scipy.special.chdtrc(len(off), statistic))


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
        small = (np.abs(further.moved) < _SMALL * kept[2].standard_deviations).all()
        if small or not further.believed:
            # another fit would find the same, or cannot be trusted: its change is in the interval
            extra = np.sqrt(further.widening + further.moved**2)
            if force is None:
                return None, *kept[:2], result.widened(np.hypot(result.standard_deviations, extra))
            force = replace(force, widening=extra**2)
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


def with_magnets_unsure(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
) -> ParameterEstimate:
    """An estimate from which nothing is taken out (another method's, or over lines of a spectrum),
    with intervals that hold what the magnets' nonlinearity may make of it.
    """
    force = magnetic_force(machine, records, controller, experiment, result)
    if force is None:
        return result
    extra = np.sqrt(force.widening + force.moved**2)
    return result.widened(np.hypot(result.standard_deviations, extra))


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
    magnets: Sequence[tuple[float, ...]] = (),
) -> np.ndarray:
    """The candidates (a + 1, p, k) in the signals (p,) of a record: quadratic terms of every axis,
    then all cubic ones.

    plant: reduced, with the parameters that were found; law: the controller as it runs; turning:
    frequency and phasors (2 a,) of currents, then displacements, that no excitation makes; magnets:
    of every bearing what ``magnet.force`` needs (empty: the machine file's). Raises InvalidInput
    where no magnet follows from the coefficients.
    """
    magnets = magnets or magnets_found(plant, {})
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
        _replaced(moved, plant, j, magnets[j // 2])
        responses[j], cubic[j] = simulate(select(loop, [f"f_{axis}"], signals), moved[:1]), moved[1]

    # the cubic forces of all axes at once: one amplitude
    responses[-1] = simulate(select(loop, [f"f_{axis}" for axis in axes], signals), cubic)
    return responses


def magnets_found(plant: Plant, values: Mapping[str, float]) -> list[tuple[float, ...]]:
    """What ``magnet.force`` needs of every bearing's magnets with the coefficients of ``values``,
    by path; as the machine file has them where no magnet is like that. Raises InvalidInput where
    none is like the file's either.

    A K_s over K_i that differs from the file's by a share is a gap that does, and a cubic term by
    twice as much: with the file's own magnets one amplitude cannot be right for all axes.
    """
    machine, bias = plant.machine, plant.point.bias_current
    by_file = operating_magnets(machine, bias)
    bearings = list(machine.bearings)
    for k, (bearing, item) in enumerate(zip(machine.bearings, by_file, strict=True)):
        found = [
            _coefficients(values, f"bearing.{bearing.name}.{quantity}", stated)
            for quantity, stated in (
                ("force_per_current", item.coefficients.force_per_current),
                ("negative_stiffness", item.coefficients.negative_stiffness),
            )
        ]
        coefficients = magnet.MagnetCoefficients(*found)
        if coefficients != item.coefficients:
            bearings[k] = with_coefficients(bearing, bias or bearing.bias_current, coefficients)
    own = by_file
    # no magnet has such coefficients
    with suppress(InvalidInput):
        own = operating_magnets(replace(machine, bearings=tuple(bearings)), bias)
    return [
        item.of_force if moved.parameters is None else moved.parameters
        for item, moved in zip(by_file, own, strict=True)
    ]


def _coefficients(
    values: Mapping[str, float], path: str, stated: tuple[float, float]
) -> tuple[float, float]:
    """Of zeta and eta, each by its own path, or both by one; else as stated."""
    zeta, eta = (
        values.get(f"{path}.{way}", values.get(path, value))
        for way, value in zip(("zeta", "eta"), stated, strict=True)
    )
    return zeta, eta


def _replaced(moved: np.ndarray, plant: Plant, j: int, magnets: tuple[float, ...]) -> np.ndarray:
    """Current and displacement (2, k) of axis number j, replaced by its quadratic and its cubic
    force.
    """
    largest = [float(np.abs(row).max()) for row in moved]
    if not all(largest):
        moved[:] = 0.0
        return moved
    bias = _bias(plant, j)
    i, x = moved
    axis, even = plant.axes[j], _POWERS.sum(axis=1) == 2
    quadratic = _terms(magnets, axis, _LOAD * bias, *largest)[even]
    odd = _odd_terms(magnets, axis, *largest)
    records_without = [
        sum(c * i**m * x**n for c, (m, n) in zip(terms, powers, strict=True))
        for terms, powers in ((quadratic, _POWERS[even]), (odd, _ODD))
    ]
    moved[:] = records_without
    return moved


def _bias(plant: Plant, j: int) -> float:
    """The bias current [A] of axis number j at the plant's operating point."""
    return plant.point.bias_current or plant.machine.bearings[j // 2].bias_current


def _odd_terms(p: tuple[float, ...], axis: str, i: float, x: float) -> np.ndarray:
    """Coefficients (10,) of ``_ODD`` in what an axis' force without load has beyond its tangent, up
    to currents i [A] and displacements x [m]. The tangent is exact: fitted beside, it would take
    a part of the fifth order, and k_s with it.
    """
    way = int(axis.endswith("_eta"))
    at, centre = np.linspace(-1.0, 1.0, _GRID), (p[6], p[9])
    tangent = slopes(p, (0.0, 0.0), centre)
    beyond = np.zeros((_GRID, _GRID))
    for j, current in enumerate(i * at):
        for k, shift in enumerate(x * at):
            currents, place = [0.0, 0.0], list(centre)
            currents[way], place[way] = current, centre[way] + shift
            beyond[j, k] = magnet.force(currents[0], currents[1], place[0], place[1], p)[way] - (
                tangent.force_per_current[way] * current + tangent.negative_stiffness[way] * shift
            )
    basis = np.stack([at[:, None] ** m * at[None] ** n for m, n in _ODD], axis=-1)
    fitted = np.linalg.lstsq(basis.reshape(-1, len(_ODD)), beyond.ravel())[0]
    return np.asarray(fitted / i ** _ODD[:, 0] / x ** _ODD[:, 1])


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
