"""The magnets' own nonlinearity in a record, estimated beside the linear loop and taken out of it.

A magnet pair is odd in (i, x): without a load its first terms beyond k_i i + k_s x are cubic; a
static load current adds quadratic ones in proportion. About the working point of an axis, with the
load a_j L, L a quarter of the bias current,

    F_j = k_i i + k_s x + a_j q(i, x) + a_odd c(i, x)                                       (1)

with q of second, c of third and fifth order, and a_odd = 1 for magnets that have these k_i and k_s.
Quadratic and odd terms pass the linear loop as forces, driven by its own currents and displacements
(second order of a Volterra series; Rugh 1981). With T the loop's responses from forces to signals,

    D_j = T_j q(i_j, x_j),   D_odd = sum T_j c(i_j, x_j)                                    (2)

is what amplitudes a of 1 add to the fitted signals. One step of least squares estimates a (b,)
beside the q parameters, r ~ J dtheta + D a. With H = [J D]'[J D], g = [J D]'r and X = H_qq^-1 H_qb

    (H_bb - H_bq X) a = g_b - X'g_q,   covariance S with the residuals' colour              (3)
    dtheta = -X da: what another amplitude makes of the parameters                          (4)

Where the excitation is weak the record says little about a, and odd terms resemble changed
parameters. So the estimate is joined with what is known beforehand, a_0 with covariance P_0,

    a = a_0 + K (a_ls - a_0),   K = P_0 (P_0 + S)^-1,   P = (I - K) P_0                     (5)

loads as recorded mean currents or the file's weight say, to within a tenth of the bias current (any
load, where a record is certain of another); a_odd = 1 to within a half, from none to twice the
file's in two standard deviations (it goes with the square of gap and bias; iron takes from it).
What stays unknown, X P X', widens the parameters' intervals. What turns with the rotor is no answer
to an excitation: with the hold of the controller's output its coil currents are

    i = -G_iu(jw) K(e^(jw dt)) hold(jw) y,   hold = e^(-jw dt/2) sinc(w dt/2)               (6)

The magnets of a thrust bearing are solved further. Currents i and displacements x of the linear
loop drive both circuits about the working point; what their force has beyond its linear part passes
the loop, which moves i and x, and so on until nothing changes. With flux phi = phi_0 + d, coil
current I_0 + i and G(phi, g) = rho g phi + R_f phi phi_s/(phi_s - phi), the ampere-turns that a
flux takes at once (``model.axial``):

    (R + c sqrt(s)) d = N i - (G(phi, g - x) - G(phi_0, g) - R d),    R = dG/dphi at rest,  (7)
    F - F_0 - F_linear = rho (d^2/2 + phi_0 (d - d_linear))                                 (8)

(7) is solved by substitution: the bracket is of second order; h = R/(R + c sqrt(s)) is the core's
lag at the working point.

Tests by these numbers: tests/identification/output_error/test_magnetic_force.py.
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

_ROUNDS = 4  # of the flux, and of the loop: each is smaller by the share that is nonlinear
_FULL = 0.999  # of the flux limit, at which the flux is held: the linear loop knows none
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
    """D (1, p, k): what the nonlinear magnets add to the signals (p,) of a record.

    plant: reduced, with the estimated parameters; law: the controller as it runs; coefficients: the
    estimated k_i [N/A] and k_s [N/m]; turning: frequency [rad/s] and phasors (2,) of current and
    displacement that no excitation makes. Raises InvalidInput where no magnets have such
    coefficients, or the linear loop leaves their gaps.
    """
    machine = plant.machine
    (axis,), at = machine.axes, machine.condition(plant.point)
    part = with_found(machine.thrust, at.load, at.place, *coefficients)
    loop = closed_loop(plant, law)
    motion = [f"i_{axis}", f"q_{axis}"]
    linear = simulate(select(loop, excitations, motion), np.array(signal_rows(record, excitations)))
    t = record.dt * np.arange(linear.shape[1])
    for omega, phasors in turning:
        linear += (phasors[:, None] * np.exp(1j * omega * t)).real

    # rows: what the force beyond the linear one adds to i and x, then to the signals
    answer = select(loop, [f"f_{axis}"], [*motion, *signals])
    added = np.zeros((len(motion) + len(signals), linear.shape[1]))
    for _ in range(_ROUNDS):
        force = _nonlinear_force(part, at.load, at.place, linear + added[: len(motion)], record.dt)
        # the working point is the record's mean, which the force's own mean is part of
        added = simulate(answer, _midpoints(force - force.mean())[None])
    return added[None, len(motion) :].astype(np.float32)


def _midpoints(v: np.ndarray) -> np.ndarray:
    """A smooth signal (k,) as the input of a system that holds it from sample to sample: the mean
    of each sample and the next.
    """
    return np.asarray((v + np.append(v[1:], v[-1:])) / 2)


def _nonlinear_force(
    part: ThrustBearing, load: float, place: float, moved: np.ndarray, dt: float
) -> np.ndarray:
    """(8) of both sides, (k,) [N] to the right, for currents [A] and displacements [m] (2, k) about
    the working point of a load [N] at a place [m]; dt [s].
    """
    at = loaded(part, load, place)
    gaps = part.gap[0] + place, part.gap[1] - place
    if np.abs(moved[1]).max(initial=0.0) > _REACH * min(gaps):
        raise InvalidInput(
            f"the linear loop leaves the gap of {part.name}; record with a smaller excitation"
        )
    left, right = (
        _side_nonlinear_force(side, coil, gap, point, lag, way * moved, dt)
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


def _side_nonlinear_force(
    side: Side,
    control: float,
    opened: float,
    at: AtPoint,
    model: object,
    moved: np.ndarray,
    dt: float,
) -> np.ndarray:
    """(8) of one side, (k,) [N] towards it. control [A], opened [m]: control current and gap that
    the working point ``at`` adds; model: the core's lags (None: laminated); moved (2, k): current
    [A] and displacement [m] towards the side; dt [s].
    """
    gap = side.gap + opened
    phi_0 = side.flux(side.bias + control, gap)
    R = side.met(phi_0, gap)
    lag = None if model is None else _sampled_lag(model, at.ratio, dt)
    i, x = moved
    drive = side.turns * i

    def lagged(v: np.ndarray) -> np.ndarray:  # h v
        return v if lag is None else np.asarray(simulate(lag, _midpoints(v)[None])[0])

    # d_linear = h (N i + rho phi_0 x)/R, then (7) by substitution
    d_linear = lagged((drive + side.slope * phi_0 * x) / R)
    d = d_linear
    for _ in range(_ROUNDS):
        bracket = _ampere_turns(side, phi_0 + d, gap - x) - _ampere_turns(side, phi_0, gap) - R * d
        d = lagged((drive - bracket) / R)
    return np.asarray(side.slope * (d**2 / 2 + phi_0 * (d - d_linear)))


def _ampere_turns(side: Side, flux: np.ndarray | float, gap: np.ndarray | float) -> np.ndarray:
    """G(phi, g) [A] at flux [Wb] and gap [m]."""
    iron: np.ndarray | float = side.iron
    if not np.isinf(side.flux_limit):
        held = np.minimum(flux, _FULL * side.flux_limit)
        iron = side.iron * side.flux_limit / (side.flux_limit - held)
    return np.asarray((side.slope * gap + iron) * flux)


def _sampled_lag(model: object, ratio: float, dt: float) -> StateSpace:
    """h of a solid core, sampled at dt [s]: its lags where the flux takes ``ratio`` times the
    ampere-turns that they were fitted for.
    """
    A, B, C = closed_lags(model, ratio)  # type: ignore[arg-type]
    return c2d(StateSpace(A, B[:, None], C[None], np.zeros((1, 1)), ["v"], ["h"]), dt)


_LOAD = 0.25  # L over the bias current: the load that amplitude 1 of a quadratic signal stands for
_PASSES = 2  # estimates of the force, each on the records that the one before cleaned
# of the change that the correction makes: standard deviation for what (1), (2) leave out; assumed
_TRUNCATED = 0.05
_PIECE = 65_536  # samples at a time
_GRID = 7  # points of current and of displacement, on which the terms are fitted
# powers (m, n) of i^m x^n: up to the third order, and those of c
_POWERS = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)])
_ODD = np.array([(order - n, n) for order in (3, 5) for n in range(order + 1)])
# a_0 and P_0 of (5), assumed: standard deviations of a load's amplitude about the recorded or the
# file's, and of any load about none
_NEAR, _ANY = 0.1 / _LOAD, 0.5 / _LOAD
_CUBIC = (1.0, 0.5)  # mean and standard deviation of a_odd; assumed
_CERTAIN = 4.0  # standard deviations from which on a record says that there is, or is not
_RARE = 0.01  # probability below which an estimate is none of magnets: something else made it
_ALIKE = 1e-8  # of the largest eigenvalue of (3), below which signals differ by rounding
_UNTOLD = 1e6  # variance of combinations of amplitudes that a record says nothing of
_SAID = 2.0  # standard deviations from which on a static load is reported
# of a parameter's standard deviation: a change by the nonlinearity that is not worth another fit
_SMALL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MagneticForce:
    """loads {axis: static current [A]} that the records show; cubic: a_odd; amplitudes a (b,);
    explains: the share of the linear model's residual that they explain. widening (q,): variances
    that the uncertainty of a adds to the fitted parameters'; moved (q,): dtheta of (4) by the last
    step of a. believed: the estimate is one of magnets; else a is a_0, what magnets would make.
    responses: D a, one (p, k) per record in the fitted signals, SI.
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
        """The records less D a in the fitted signals; signals that no fit needs are left out."""
        cleaned = []
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
            cleaned.append(
                replace(
                    record, signals=names, units=tuple(record.units[j] for j in kept), values=values
                )
            )
        return tuple(cleaned)

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
    """The magnets' nonlinearity in records of which ``result`` is the fit of the linear loop; None
    where the records show that there is none, or no magnet has the estimated coefficients.

    records: those of ``experiment``; before: what was taken out of them already, whose amplitudes
    are part of those returned.
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
                else nonlinear_responses(*driven, turning, magnets_with(plant, values))
            )
            waves[-1] /= experiment.sizes[:, None].astype(np.float32)
    # no magnet follows from these coefficients, or the loop with a whole delay is none that runs
    except AmbroseError:
        return None

    # a_ls of (3), counted from records out of which nothing was taken, then a of (5)
    step = _least_squares_step(*_normal(experiment, result.values, waves), len(result.values))
    removed = np.zeros(len(step.amplitudes)) if before is None else before.amplitudes
    estimate = removed + step.amplitudes
    if _linear(estimate, step.covariance):
        return None
    loads = _known_loads(machine, plants[0], records)
    amplitudes, covariance, believed = _joined(estimate, step.covariance, loads)
    certain = np.abs(amplitudes) > _SAID * np.sqrt(np.diag(covariance))
    static = {
        plants[0].axes[j]: float(_LOAD * _bias(plants[0], j) * amplitudes[j])
        for j in range(len(amplitudes) - 1)
        if certain[j]
    }
    responses = tuple(
        experiment.sizes[:, None] * np.tensordot(amplitudes.astype(np.float32), wave, 1)
        for wave in waves
    )
    return MagneticForce(
        static,
        float(amplitudes[-1]),
        amplitudes,
        step.gained if before is None else before.explains,
        np.einsum("qb,bc,qc->q", step.moved, covariance, step.moved),
        step.moved @ (amplitudes - removed),
        believed,
        experiment.signals,
        responses,
    )


def _known_loads(machine: Machine, plant: Plant, records: Sequence[Record]) -> np.ndarray:
    """The loads' part of a_0 (b - 1,): recorded mean currents over L, else those that carry the
    file's weight; none along the shaft, whose point has its thrust.
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
    """k_i [N/A] and k_s [N/m] of the thrust magnets: estimated ones, else the file's."""
    estimated = {parse_parameter(path).quantity: value for path, value in values.items()}
    k_i, k_s = magnet_coefficients(plant.machine, plant.point)
    return (
        estimated.get("force_per_current", float(k_i[0])),
        estimated.get("negative_stiffness", float(k_s[0])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """(3): the step of the amplitudes (b,) beside q parameters and its covariance S (b, b); moved
    (q, b): -X of (4); gained: share of the cost r'r that it explains.
    """

    amplitudes: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    gained: float


def _least_squares_step(
    H: np.ndarray, middle: np.ndarray, g: np.ndarray, cost: float, q: int
) -> _Step:
    """(3) from H, the covariance ``middle`` of g, g and r'r of ``_normal``, with q parameters;
    an amplitude whose signal is zero is zero, of infinite variance.
    """
    size = np.sqrt(np.diag(H))
    parameters, extra = (
        np.arange(q),
        q + np.flatnonzero(size[q:] > 1e-9 * size[q:].max(initial=0.0)),
    )

    # parameters eliminated: slope = g_b - X'g_q
    X = np.linalg.solve(H[np.ix_(parameters, parameters)], H[np.ix_(parameters, extra)])
    slope = g[extra] - X.T @ g[parameters]
    W = np.vstack([-X, np.eye(len(extra))])
    both = np.concatenate([parameters, extra])
    unit = np.outer(size[extra], size[extra])

    # H_bb - H_bq X in units of the signals' sizes; combinations of signals that cancel are not told
    left, vectors = np.linalg.eigh(
        (H[np.ix_(extra, extra)] - H[np.ix_(extra, parameters)] @ X) / unit
    )
    seen = left > _ALIKE * left.max(initial=0.0)
    inverse = (vectors[:, seen] / left[seen]) @ vectors[:, seen].T / unit
    untold = _UNTOLD * vectors[:, ~seen] @ vectors[:, ~seen].T * size[extra].max(initial=0.0) ** 2

    # sandwich: the slope is W' J'r with W = [-X; I]
    step_covariance = inverse @ W.T @ middle[np.ix_(both, both)] @ W @ inverse + untold / unit
    b = len(H) - q
    step, covariance = np.zeros(b), np.diag(np.full(b, np.inf))
    step[extra - q] = inverse @ slope
    covariance[np.ix_(extra - q, extra - q)] = step_covariance

    # (4): a signal in the records that is not fitted is taken for X a by the parameters
    moved = np.zeros((q, b))
    moved[:, extra - q] = -X
    return _Step(step, covariance, moved, float(slope @ inverse @ slope) / cost)


def _linear(amplitudes: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether the record has no nonlinearity although it would show: a linear simulation's."""
    deviations = np.sqrt(np.diag(covariance))
    none = (np.abs(amplitudes) <= _CERTAIN * deviations).all()
    return bool(none and abs(amplitudes[-1] - 1) > _CERTAIN * deviations[-1])


def _joined(
    amplitudes: np.ndarray, covariance: np.ndarray, loads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """a (b,) and P (b, b) of (5), from the least-squares amplitudes (b,), their covariance S (b, b)
    and the known loads (b - 1,), and whether both agree; where they do not, a_0 and P_0 alone. An
    amplitude without a signal, of infinite variance, keeps its zero.
    """
    seen = np.isfinite(np.diag(covariance))
    S, a_ls = covariance[np.ix_(seen, seen)], amplitudes[seen]
    a_0 = np.append(loads, _CUBIC[0])[seen]

    # another load than the known one, but for certain: any load is as likely
    P_0 = np.diag(np.append(np.full(len(loads), _NEAR), _CUBIC[1])[seen] ** 2)
    believed = _probability_beyond(a_ls - a_0, P_0 + S) > _RARE
    chance = _probability_beyond(a_ls[:-1], S[:-1, :-1])  # of loads like that by noise
    if not believed and chance < 2 * scipy.special.ndtr(-_CERTAIN):
        P_0 = np.diag(np.append(np.full(len(loads), _ANY), _CUBIC[1])[seen] ** 2)
        a_0 = np.append(np.zeros(len(loads)), _CUBIC[0])[seen]
        believed = _probability_beyond(a_ls - a_0, P_0 + S) > _RARE
    K = np.linalg.solve(P_0 + S, P_0).T if believed else np.zeros_like(P_0)

    a, P = np.zeros_like(amplitudes), np.zeros_like(covariance)
    a[seen] = a_0 + K @ (a_ls - a_0)
    P[np.ix_(seen, seen)] = P_0 - K @ P_0
    return a, P, believed


def _probability_beyond(off: np.ndarray, covariance: np.ndarray) -> float:
    """Probability that a draw of mean zero and this covariance (b, b) is further off than ``off``
    (b,): chi^2 of off' covariance^-1 off.
    """
    if not len(off):
        return 1.0
    statistic = off @ np.linalg.pinv(covariance, hermitian=True) @ off
    return float(scipy.special.chdtrc(len(off), statistic))


def _normal(
    experiment: Experiment, theta: np.ndarray, waves: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """H (q + b, q + b), the covariance of g, g (q + b,) and r'r of (3) at theta (q,), summed over
    the records. waves: D (b, p, k) of every record over the signals' weights; constants and turning
    waves, which are fitted as well, are taken out of them in place.
    """
    loops = LeastSquares(experiment, normal_equations).loops(theta)
    parts = []
    for task, wave in zip(experiment.tasks, waves, strict=True):
        loop, directions = loops[task.place]
        turning = synchronised(loop, task)
        solution = normal_equations(loop, directions, turning)

        # with an unknown delay of the excitation the first samples are not fitted
        start = getattr(experiment.models[task.place], "skipped", 0)
        D = wave[:, :, start : start + task.samples]
        _remove_nuisances(D, turning)
        covariance = residual_scores(
            loop, turning, solution, ["e"] * len(task.e), experiment.signals, 1
        ).covariance

        H, g = 0.0, 0.0

        def pieces(
            fit_of: Any = (loop, directions, turning, solution), D: np.ndarray = D
        ) -> Iterator[np.ndarray]:
            return _stacked(jacobian_pieces(*fit_of), D)

        for JD, r in zip(pieces(), residual_pieces(loop, turning, solution), strict=True):
            rows, residual = JD.reshape(len(JD), -1), r[: len(experiment.signals)].ravel()
            H, g = H + rows @ rows.T, g + rows @ residual
        parts.append((H, coloured_products(pieces(), covariance), g, solution.equations.cost))
    return tuple(sum(items) for items in zip(*parts, strict=True))  # type: ignore[return-value]


def _stacked(pieces: Iterable[np.ndarray], D: np.ndarray) -> Iterator[np.ndarray]:
    """Pieces of J (q, p, length) with those of D (b, p, k) below."""
    begin = 0
    for J in pieces:
        yield np.concatenate([J, D[:, :, begin : begin + J.shape[2]]])
        begin += J.shape[2]


def _remove_nuisances(D: np.ndarray, task: Task) -> None:
    """Take out of D (b, p, k) in place what the task's constants and turning waves W explain, by
    least squares: D - (D W')(W W')^-1 W.
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
    """Pieces of a long record, so that arrays made on the way do not grow with it."""
    for start in range(0, samples, _PIECE):
        yield slice(start, min(start + _PIECE, samples))


def without_magnets(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
) -> tuple[MagneticForce | None, tuple[Record, ...], Experiment, ParameterEstimate]:
    """The magnets' nonlinearity in the records of ``result``, and the records without it, their
    experiment and its fit; None and what was given where there is none. The fit's standard
    deviations include what the nonlinearity leaves uncertain.
    """
    force, cleaned = None, tuple(records)
    task, estimate = experiment, result
    for _ in range(_PASSES):
        further = magnetic_force(machine, cleaned, controller, task, estimate, force)
        if further is None:
            break
        small = np.abs(further.moved) < _SMALL * estimate.standard_deviations
        if small.all() or not further.believed:
            # another fit would give the same, or cannot be trusted: its change is in the interval
            extra = np.sqrt(further.widening + further.moved**2)
            if force is None:
                wide = np.hypot(result.standard_deviations, extra)
                return None, cleaned, task, result.widened(wide)
            force = replace(force, widening=extra**2)
            break
        rest = further.less(records)
        begin = dict(zip(result.paths, estimate.values.tolist(), strict=True))
        try:
            refit = build_experiment(machine, rest, controller, result.paths, experiment.options)
            fitted = replace(fit(refit, begin), start=result.start)
        except AmbroseError:
            break
        if not fitted.converged:
            break
        force, cleaned = replace(further, responses=()), rest
        task, estimate = refit, fitted
    if force is None:
        return None, cleaned, task, estimate

    # variances add: noise, the amplitudes' own, what (1) and (2) leave out
    total = np.hypot(
        estimate.standard_deviations,
        np.hypot(np.sqrt(force.widening), _further_terms(result, estimate.values)),
    )
    return force, cleaned, task, estimate.widened(total)


def with_magnets_unsure(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    experiment: Experiment,
    result: ParameterEstimate,
) -> ParameterEstimate:
    """An estimate of records as they are (another method's, or over lines of a spectrum), with
    intervals that include what the magnets' nonlinearity may make of it.
    """
    force = magnetic_force(machine, records, controller, experiment, result)
    if force is None:
        return result
    extra = np.sqrt(force.widening + force.moved**2)
    return result.widened(np.hypot(result.standard_deviations, extra))


def _further_terms(result: ParameterEstimate, values: np.ndarray) -> np.ndarray:
    """Standard deviations (q,) for what (1) and (2) leave out: a twentieth of the change of the
    parameters that taking D a out made, values - result.values, as a share of the value; of those
    of one kind (all k_i, all k_s) the largest share.
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
    """Frequency [rad/s] and phasors (2 a,) of coil currents [A] by (6), then displacements [m], of
    every fitted wave that turns with the rotor; dt [s].
    """
    axes, turning = plant.axes, []
    for frequency in dict.fromkeys(wave.frequency for wave in waves):
        phasors = {
            wave.signal: wave.amplitude * np.exp(1j * wave.phase)
            for wave in waves
            if wave.frequency == frequency
        }
        y = np.array([phasors.get(f"y_{axis}", 0.0) for axis in axes])
        omega = np.array([2 * np.pi * frequency])

        # (6); np.sinc(f dt) is sinc(w dt/2)
        hold = np.exp(-0.5j * omega[0] * dt) * np.sinc(frequency * dt)
        coils = select(plant.system, plant.named("u"), [f"i_{axis}" for axis in axes])
        i = (
            -frequency_response(coils, omega).values[0]
            @ frequency_response(law, omega).values[0]
            @ y
            * hold
        )
        turning.append((float(omega[0]), np.concatenate([i, y])))
    return turning


def nonlinear_responses(
    plant: Plant,
    law: StateSpace,
    record: Record,
    excitations: Sequence[str],
    signals: Sequence[str],
    turning: Sequence[tuple[float, np.ndarray]] = (),
    magnets: Sequence[tuple[float, ...]] = (),
) -> np.ndarray:
    """D of (2), (a + 1, p, k), in the signals (p,) of a record: of the quadratic terms of every
    axis, then of the odd terms of all.

    plant: reduced, with the estimated parameters; law: the controller as it runs; turning:
    frequency [rad/s] and phasors (2 a,) of currents [A], then displacements [m], that no excitation
    makes; magnets: of every bearing ``magnet.parameters`` (empty: the machine file's). Raises
    InvalidInput where no magnet has the coefficients.
    """
    magnets = magnets or magnets_with(plant, {})
    loop, axes = closed_loop(plant, law), plant.axes
    driven = np.array(signal_rows(record, excitations))
    responses = np.empty((len(axes) + 1, len(signals), driven.shape[1]), np.float32)
    odd = np.empty((len(axes), driven.shape[1]), np.float32)

    # moved (2, k): current and displacement of an axis in the linear loop, what turns added
    for j, axis in enumerate(axes):
        moved = simulate(select(loop, excitations, [f"i_{axis}", f"q_{axis}"]), driven)
        for part in _stretches(moved.shape[1] if turning else 0):
            t = record.dt * np.arange(part.start, part.stop)
            for omega, phasors in turning:
                moved[:, part] += (phasors[j :: len(axes), None] * np.exp(1j * omega * t)).real
        quadratic, odd[j] = _forces(moved, plant, j, magnets[j // 2])
        responses[j] = simulate(select(loop, [f"f_{axis}"], signals), quadratic[None])

    # the odd forces of all axes at once: one amplitude
    responses[-1] = simulate(select(loop, [f"f_{axis}" for axis in axes], signals), odd)
    return responses


def magnets_with(plant: Plant, values: Mapping[str, float]) -> list[tuple[float, ...]]:
    """``magnet.parameters`` of every bearing's magnets with the coefficients of ``values``, by
    path; as the machine file has them where no magnet has these. Raises InvalidInput where none has
    the file's either.

    A K_s over K_i that differs from the file's by a share is a gap that does, and a cubic term by
    twice as much: with the file's own magnets one amplitude cannot be right for all axes.
    """
    machine, bias = plant.machine, plant.point.bias_current
    by_file = operating_magnets(machine, bias)
    bearings = list(machine.bearings)
    for k, (bearing, item) in enumerate(zip(machine.bearings, by_file, strict=True)):
        estimated = [
            _coefficients(values, f"bearing.{bearing.name}.{quantity}", stated)
            for quantity, stated in (
                ("force_per_current", item.coefficients.force_per_current),
                ("negative_stiffness", item.coefficients.negative_stiffness),
            )
        ]
        coefficients = magnet.MagnetCoefficients(*estimated)
        if coefficients != item.coefficients:
            bearings[k] = with_coefficients(bearing, bias or bearing.bias_current, coefficients)
    magnets = by_file
    # no magnet has such coefficients
    with suppress(InvalidInput):
        magnets = operating_magnets(replace(machine, bearings=tuple(bearings)), bias)
    return [
        by_file[k].of_force if item.parameters is None else item.parameters
        for k, item in enumerate(magnets)
    ]


def _coefficients(
    values: Mapping[str, float], path: str, stated: tuple[float, float]
) -> tuple[float, float]:
    """A coefficient of zeta and of eta: each by its own path in ``values``, or both by one; else as
    stated in the file.
    """
    zeta, eta = (
        values.get(f"{path}.{way}", values.get(path, value))
        for way, value in zip(("zeta", "eta"), stated, strict=True)
    )
    return zeta, eta


def _forces(moved: np.ndarray, plant: Plant, j: int, magnets: tuple[float, ...]) -> np.ndarray:
    """q and c of (1), (2, k) [N], for current [A] and displacement [m] (2, k) of axis number j;
    zero where one of them never moves.
    """
    largest = [float(np.abs(row).max()) for row in moved]
    if not all(largest):
        return np.zeros_like(moved)
    bias = _bias(plant, j)
    i, x = moved
    axis, even = plant.axes[j], _POWERS.sum(axis=1) == 2
    quadratic = _terms(magnets, axis, _LOAD * bias, *largest)[even]
    odd = _odd_terms(magnets, axis, *largest)
    return np.array(
        [
            sum(c * i**m * x**n for c, (m, n) in zip(terms, powers, strict=True))
            for terms, powers in ((quadratic, _POWERS[even]), (odd, _ODD))
        ]
    )


def _bias(plant: Plant, j: int) -> float:
    """The bias current [A] of axis number j at the plant's operating point."""
    return plant.point.bias_current or plant.machine.bearings[j // 2].bias_current


def _odd_terms(p: tuple[float, ...], axis: str, i: float, x: float) -> np.ndarray:
    """c of (1): coefficients (10,) of i^m x^n, ``_ODD``, fitted to what an axis' force without load
    has beyond its tangent up to currents i [A] and displacements x [m]; p: ``magnet.parameters``.
    The tangent is exact: fitted as well, it would take a part of the fifth order, and k_s with it.
    """
    way, at = int(axis.endswith("_eta")), np.linspace(-1.0, 1.0, _GRID)
    tangent = slopes(p, (0.0, 0.0), (p[6], p[9]))
    beyond = _force_grid(p, axis, 0.0, i, x) - (
        tangent.force_per_current[way] * (i * at[:, None])
        + tangent.negative_stiffness[way] * (x * at)
    )
    return _fitted(_ODD, beyond, i, x)


def _terms(p: tuple[float, ...], axis: str, load: float, i: float, x: float) -> np.ndarray:
    """Coefficients (10,) of i^m x^n, ``_POWERS``, fitted to an axis' force about a load [A] up to
    currents i [A] and displacements x [m]; p: ``magnet.parameters``. Those of second order are q of
    (1) at the load L.
    """
    return _fitted(_POWERS, _force_grid(p, axis, load, i, x), i, x)


def _force_grid(p: tuple[float, ...], axis: str, load: float, i: float, x: float) -> np.ndarray:
    """Force (7, 7) [N] of an axis at currents load +- i [A] and places +- x [m] off its magnetic
    centre, p[6] of zeta and p[9] of eta.
    """
    way, at = int(axis.endswith("_eta")), np.linspace(-1.0, 1.0, _GRID)
    force = np.zeros((_GRID, _GRID))
    for j, current in enumerate(load + i * at):
        for k, place in enumerate((p[6], p[9])[way] + x * at):
            i_zeta, i_eta = (0.0, current) if way else (current, 0.0)
            zeta, eta = (0.0, place) if way else (place, 0.0)
            force[j, k] = magnet.force(i_zeta, i_eta, zeta, eta, p)[way]
    return force


def _fitted(powers: np.ndarray, force: np.ndarray, i: float, x: float) -> np.ndarray:
    """Coefficients (t,) of i^m x^n, (m, n) the rows of ``powers`` (t, 2), by least squares from a
    force (7, 7) on the grid of ``_force_grid``; fitted in units of i and x, of one size.
    """
    at = np.linspace(-1.0, 1.0, _GRID)
    basis = np.stack([at[:, None] ** m * at[None] ** n for m, n in powers], axis=-1)
    terms = np.linalg.lstsq(basis.reshape(-1, len(powers)), force.ravel())[0]
    return np.asarray(terms / i ** powers[:, 0] / x ** powers[:, 1])
