"""Closed-loop identification through the Youla residual: the record of an unstable machine becomes
an open-loop experiment.

From a record of the loop v = K y + e two observers make alpha = V~ v - U~ y = V~ e, which no noise
disturbs, and eps = M~ y - N~ v = S(theta) alpha + (M~ + S U~) d (core/realisation.py). S is
stable and zero for the machine as modelled, so that eps shows directly by how much the machine
differs. The parameters are fitted to it by the least squares of output_error/closed_loop.py, with
the error weighted by M~ (I + G K): white measurement noise stays white, and least squares is
efficient near the machine modelled. Lauridsen's paper P1; Hansen, Franklin & Kosut (1989).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    as_several,
    check_positive,
    check_shape,
    invalid,
)
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.presentation import Presented
from ambrose.core.realisation import CoprimeFactors, coprime_factors, injection_gain, residual_lft
from ambrose.core.response import SystemDerivative, impulse_response, simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, as_statespace, index_of, select
from ambrose.identification.findings import WARNING, Code, Finding, signal_rows
from ambrose.identification.output_error.closed_loop import ParameterEstimate, fit_samples
from ambrose.identification.output_error.loop_model import LoopModel, directions_of, loop_model
from ambrose.identification.output_error.normal_equations import Task, distinct
from ambrose.identification.output_error.problem import (
    Experiment,
    FitOptions,
    check_records,
    check_start,
    deployed_controller,
    driven_inputs,
    start_values,
)
from ambrose.identification.output_error.synchronous import synchronous_of
from ambrose.identification.parameters import expand, nominal_values, reduced_plant
from ambrose.law.law import LawLike
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import uncertain
from ambrose.record.record import Record

# S without a model: its pulse response from alpha and eps by linear least squares, and whether
# S(theta) agrees with it.


_MOST = 4000  # unknowns per output


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FiniteResponse(Presented):
    """Pulse response h (p, m, taps) of S, from the sample of the pulse on, and its standard
    deviations (p, m, taps).

    normal (m * taps, m * taps): the normal matrix, the same for every output; noise (p,): standard
    deviation of what the response does not explain; freedom: samples beyond the unknowns.
    """

    h: np.ndarray
    deviation: np.ndarray
    normal: np.ndarray
    noise: np.ndarray
    freedom: int

    def disagreement(self, system: Any) -> np.ndarray:
        """(p,): mean square distance of a sampled system's response, over what the noise makes;
        about 1 where it is S.

        The ratio follows F(m * taps, freedom) for white noise: a few per cent above 1 is much when
        taps are many.
        """
        p, m, taps = self.h.shape
        expected = impulse_response(as_statespace(system), taps)

        # (h - h_S)' X'X (h - h_S) over the unknowns and the noise's variance
        difference = (self.h - expected).reshape(p, m * taps)
        return (
            np.einsum("pi,ij,pj->p", difference, self.normal, difference)
            / (m * taps)
            / self.noise**2
        )


def finite_response(alpha: np.ndarray, eps: np.ndarray, taps: int) -> FiniteResponse:
    """The response of eps (p, k) to alpha (m, k) over ``taps`` samples, and its noise; offsets are
    taken out.

    Raises InvalidInput where the record is too short or alpha does not excite as many taps. The
    response must have decayed after ``taps``, and the noise be white for the deviations to hold, as
    it is in eps. Ljung (1999), section 4.2.
    """
    alpha = check_shape(alpha, "alpha", "(m, k)")
    m, k = alpha.shape
    eps = check_shape(eps, "eps", "(p, k)", k=k)
    if isinstance(taps, bool) or not isinstance(taps, int | np.integer) or not 1 <= taps:
        raise invalid(
            "taps",
            repr(taps),
            "a whole number from 1",
            "cover the decay of S: 3 / |slowest pole| / dt",
        )
    unknowns = m * taps + 1
    freedom = k - taps + 1 - unknowns
    if freedom < unknowns // 4 or unknowns > _MOST:
        raise invalid(
            "taps",
            taps,
            f"at most {min((k * 4 // 5 - 1) // (m + 1), _MOST // m)} for {k} samples",
            "record longer",
        )
    # (m, k - taps + 1, taps)
    lagged = np.lib.stride_tricks.sliding_window_view(alpha, taps, axis=1)[:, :, ::-1]

    # eps(t) = sum over taps of h(tau) alpha(t - tau); means out for the offset
    X = lagged.transpose(1, 0, 2).reshape(k - taps + 1, m * taps)
    X = X - X.mean(axis=0)
    Y = eps[:, taps - 1 :].T
    Y = Y - Y.mean(axis=0)

    # scaled to a unit diagonal before it is factored
    normal = X.T @ X
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    try:
        factor = sla.cho_factor(normal / size / size[:, None])
    except np.linalg.LinAlgError as error:
        raise InvalidInput(
            f"alpha does not excite {taps} taps of every channel; excite longer, or each axis on "
            "its own"
        ) from error
    taps_by_output = sla.cho_solve(factor, X.T @ Y / size[:, None]) / size[:, None]
    noise = np.sqrt(np.sum((Y - X @ taps_by_output) ** 2, axis=0) / freedom)

    # diag((X'X)^-1)^1/2; standard deviations: noise times it
    spread = np.sqrt(np.diag(sla.cho_solve(factor, np.eye(m * taps)))) / size
    p = len(eps)
    shape = (p, m, taps)
    return FiniteResponse(
        taps_by_output.T.reshape(shape),
        np.outer(noise, spread).reshape(shape),
        normal,
        noise,
        freedom,
    )


# The residual system S(theta) of core/realisation.py as a function of the unknown parameters,
# with exact derivatives.
#
# Sampled: the loop as it runs (identification/output_error/loop_model.py), driven by alpha in place
# of the excitation and watched by the nominal plant's observer. Held: the continuous loop of an
# observer-based controller into which alpha is fed, held between the samples (P1's experiment);
# there theta is a feedback around the nominal S, P1 (13).


@dataclass(frozen=True, slots=True, eq=False)
class SampledResidual:
    """S(theta) from alpha (m) to eps (p) of a sampled loop; eps is weighted by ``whitening`` (p,
    p).

    inner: the loop from e_<axis> to y_<axis>, u_<axis>; factors: those of the sampled nominal plant
    and controller.
    """

    inner: LoopModel
    factors: CoprimeFactors
    whitening: np.ndarray

    @property
    def excitations(self) -> tuple[str, ...]:
        return self.factors.alpha

    @property
    def signals(self) -> tuple[str, ...]:
        return self.factors.eps

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """S at theta (q,), of the states (plant, controller, observer), and its derivative for each
        parameter.
        """
        loop, changes = self.inner.loop(theta)
        G = self.factors.plant
        L = self.factors.plant_gain
        L_K = self.factors.controller_gain
        p, n = len(G.outputs), G.n_states
        loop_states, k = loop.n_states, L_K.shape[0]

        # x_o+ = (A + L C) x_o + B (u + alpha) - L y,   eps = y - C x_o
        C_y, C_u = loop.C[:p], loop.C[p:]
        A = np.block([[loop.A, np.zeros((loop_states, n))], [G.B @ C_u - L @ C_y, G.A + L @ G.C]])

        # alpha enters as the excitation, and the controller's states by -L_K
        B = np.vstack([loop.B - np.vstack([np.zeros((loop_states - k, L_K.shape[1])), L_K]), G.B])
        C = self.whitening @ np.hstack([C_y, -G.C])
        D = np.zeros((p, B.shape[1]))

        # the observer is the nominal plant's: it does not move
        directions = []
        for change in changes:
            dA, dB = np.zeros_like(A), np.zeros_like(B)
            dA[:loop_states, :loop_states], dB[:loop_states] = change.A, change.B
            directions.append(SystemDerivative(dA, dB, np.zeros_like(C), D))
        return StateSpace(A, B, C, D, self.excitations, self.signals, loop.dt), directions


def sampled_residual(
    plant: Plant,
    factors: CoprimeFactors,
    paths: Sequence[str],
    nominal: np.ndarray,
    whitening: np.ndarray,
) -> SampledResidual:
    """S(theta) of the sampled loop in the parameters at ``paths``; nominal (q,): their values in
    ``plant``, SI.

    factors: of ``plant`` sampled with a zero-order hold and the controller as it runs (u = K y);
    whitening (p, p).
    """
    K = factors.controller

    # the factors' K is from y, the loop's law from err = -y
    err = [f"err_{axis}" for axis in plant.axes]
    law = StateSpace(K.A, -K.B, K.C, -K.D, err, K.outputs, K.dt)
    signals = [f"{kind}_{axis}" for kind in "yu" for axis in plant.axes]
    inner = loop_model(plant, law, paths, nominal, [f"e_{axis}" for axis in plant.axes], signals)
    return SampledResidual(inner, factors, whitening)


def uncertain_residual(
    plant: Plant, factors: CoprimeFactors, paths: Sequence[str]
) -> GeneralizedPlant:
    """S with the changes of the parameters at ``paths`` pulled out: delta is the change in SI
    units, z and w as the plant's.
    """
    general = uncertain(plant, [Tolerance(path, absolute=1.0) for path in paths])
    count = general.n_w_blocks
    named = GeneralizedPlant(
        general.system,
        general.w[:count],
        factors.plant.inputs,
        general.z[: general.n_z_blocks],
        factors.plant.outputs,
        general.blocks,
    )
    return residual_lft(factors, named)


def held_residual(
    plant: Plant, factors: CoprimeFactors, paths: Sequence[str], nominal: np.ndarray, dt: float
) -> LoopModel:
    """S(theta) of the continuous loop of ``factors``, alpha held over dt [s]: a loop whose
    controller is in the plant.

    nominal (q,): the parameters' values, SI.
    """
    general = uncertain_residual(plant, factors, paths)
    system = general.system
    u, y = (
        index_of(general.u, system.inputs, "input"),
        index_of(general.y, system.outputs, "output"),
    )
    dA, dB = directions_of(general, u)
    count = general.n_w_blocks
    if (
        system.D[: general.n_z_blocks, :count].any()
        or system.D[np.ix_(y, [*range(count), *u])].any()
    ):
        raise NumericalFailure(
            "the plant has feedthrough at its ports; take one reduced without static correction"
        )

    # no controller of its own: alpha is the excitation, and LoopModel's loop is the plant held
    empty = np.zeros((0, 0))
    no_law = StateSpace(empty, empty, empty, empty, (), (), dt)
    B, C = system.B[:, u], system.C[y]
    return LoopModel(
        nominal, system.A, B, C, dA, dB, no_law, factors.alpha, factors.eps, np.ones(len(nominal))
    )


_LOOKED_AT = 10_000  # samples on which the controller is compared with the one that ran
_GROWTH = 10.0  # of the motion over a record, beyond that of its excitation
# of the recorded currents, that the controller given does not explain: doubtful, and refused
_OTHER, _WRONG = 0.01, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ResidualIdentification:
    """The estimate (values, covariance, tests) and how it was reached: the factors, S at its
    values, and its signals.

    residual: S from alpha to eps, sampled. signals: per record alpha_u_<axis> [A] and eps_y_<axis>
    [m], for frf.h1 and ``impulse_response.finite_response``. controller_error: share of the
    recorded currents, from 0, that the controller given does not explain (the largest of all
    records; NaN where u was not recorded apart).
    """

    estimate: ParameterEstimate
    factors: CoprimeFactors
    residual: StateSpace
    signals: tuple[Record, ...]
    controller_error: float


def identify(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: LawLike,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    decay: float = 10.0,
    **options: Any,
) -> ResidualIdentification:
    """The parameters at the paths ``unknown`` from records of the closed loop with e_<axis>,
    u_<axis> [A] and y_<axis> [m].

    controller, start: as in closed_loop.identify; the controller must stabilise the machine as
    modelled, too. noise: y_<axis> -> standard deviation [m] (None: all alike). decay [1/s]: the
    slowest rate at which the observers forget. options: those of FitOptions, but for signals,
    weights and period, of which the residual has its own. Raises InvalidInput, and UnstableSystem
    where machine and controller are not stable together.
    """
    how = FitOptions(**options)
    for name in ("signals", "weights", "period"):
        if getattr(how, name) is not None:
            text = "the Youla residual is made of every u_ and y_<axis> over the whole record"
            raise InvalidInput(f"{name} goes with the method closed-loop; {text}")
    records = as_several(records)
    point, dt = check_records(machine, records)
    paths = expand(machine, unknown)
    plant = reduced_plant(machine, point, how.bending_modes, paths)
    nominal = nominal_values(plant, paths)
    begin = start_values(paths, nominal, start)
    _check_signals(plant, records)
    driven_inputs(plant, records, -(-len(paths) // len(plant.axes)))
    _check_bounded(plant, records)
    law = deployed_controller(plant, controller, dt, how.computing_delay)
    factors, covariance = sampled_factors(plant, law, _sizes(plant, noise), decay)
    signals = tuple(residual_signals(factors, record, how.offset) for record in records)
    error = max(controller_error(factors, record) for record in records)
    if error > _WRONG:
        raise InvalidInput(
            f"the controller given does not explain {100 * error:.0f} % of the recorded currents "
            "u_<axis>; it is not the one "
            "that ran, or its output was limited: check sign, units, sample rate, computing_delay "
            "and the order of the axes"
        )
    whitening = _whitening(covariance)
    model = sampled_residual(plant, factors, paths, nominal, whitening)
    estimate = _fit(plant, model, whitening, paths, nominal, begin, signals, how)
    if error > _OTHER:
        what = (
            f"the controller given leaves {100 * error:.1f} % of the recorded currents unexplained"
        )
        remedy = "the parameters found are biased by as much as it differs from the one that ran"
        warning = Finding(Code.OTHER_CONTROLLER, WARNING, what, remedy=remedy)
        estimate = replace(estimate, warnings=(*estimate.warnings, warning))

    # the model's eps is whitened: back to metres
    S, _ = model.loop(estimate.values)
    S = replace(S, C=np.linalg.solve(whitening, S.C))
    return ResidualIdentification(estimate, factors, S, signals, error)


def identify_injected(
    plant: Plant,
    factors: CoprimeFactors,
    unknown: Sequence[str],
    alpha: np.ndarray,
    eps: np.ndarray,
    dt: float,
    *,
    start: Mapping[str, float] | None = None,
    initial_state: bool = False,
    offset: bool = False,
) -> ParameterEstimate:
    """P1's experiment: alpha (m, k) [A] is fed into the controller, held over dt [s], and eps (p,
    k) [m] read out of it.

    plant: reduced, without feedthrough; factors: of the continuous plant (inputs u_<axis>, outputs
    y_<axis>) and its controller (``observer_controller``). unknown: paths; start: path -> value;
    initial_state, offset: estimated, else zero. Raises InvalidInput.
    """
    dt = check_positive(dt, "dt", "give the sample time in seconds")
    alpha = check_shape(alpha, "alpha", "(m, k)", m=len(factors.alpha))
    eps = check_shape(eps, "eps", "(p, k)", p=len(factors.eps), k=alpha.shape[1])
    if not np.ptp(alpha, axis=1).any():
        raise InvalidInput(
            "alpha never changes: without excitation eps is noise; feed a random binary signal "
            "into the controller"
        )
    paths = expand(plant.machine, unknown)
    nominal = nominal_values(plant, paths)
    begin = start_values(paths, nominal, start)
    model = held_residual(plant, factors, paths, nominal, dt)
    signals = Record(
        plant.machine.name,
        1 / dt,
        (*factors.alpha, *factors.eps),
        ("A",) * len(alpha) + ("m",) * len(eps),
        np.vstack([alpha, eps]),
        plant.point,
    )
    return _fit(
        plant,
        model,
        np.eye(len(model.signals)),
        paths,
        nominal,
        begin,
        (signals,),
        FitOptions(initial_state=initial_state, offset=offset, harmonics=0),
    )


def _fit(
    plant: Plant,
    model: SampledResidual | LoopModel,
    whitening: np.ndarray,
    paths: tuple[str, ...],
    nominal: np.ndarray,
    begin: np.ndarray,
    signals: Sequence[Record],
    options: FitOptions,
) -> ParameterEstimate:
    """The least squares of output_error/closed_loop.py on S, with eps whitened and scaled to the
    size 1. whitening (p, p): of eps.
    """
    measured = [whitening @ record.select(model.signals).values for record in signals]
    size = max(float(np.sqrt(np.mean(eps**2))) for eps in measured)
    if size == 0:
        raise InvalidInput(
            "eps is zero: the machine shows no difference from its model at all; is this record a "
            "simulation of it?"
        )
    tasks = [
        Task(
            *distinct(list(record.select(model.excitations).values)),
            eps / size,
            options.initial_state,
            options.offset,
            synchronous=synchronous_of(record, options.harmonics, options.tones),
        )
        for record, eps in zip(signals, measured, strict=True)
    ]
    check_start([model], begin)
    scale, sizes = np.where(nominal == 0, 1.0, np.abs(nominal)), np.full(len(model.signals), size)
    experiment = Experiment(
        plant.machine.name,
        signals[0].dt,
        options,
        paths,
        nominal,
        scale,
        plant.point,
        (model,),
        tuple(tasks),
        sizes,
        model.signals,
    )
    return fit_samples(experiment, begin)


def sampled_factors(
    plant: Plant, law: StateSpace, noise: np.ndarray | None = None, decay: float = 10.0
) -> tuple[CoprimeFactors, np.ndarray]:
    """The factors of the plant sampled at the controller's rate and the controller, and the
    covariance (p, p) of eps.

    law: sampled, from errors to currents u_<axis>, delay included; noise (p,) [m]: of the sensors
    (None: 1). The plant's observer is the Kalman filter for that noise, unless a pole decays slower
    than ``decay`` [1/s] and grows slower, too; the controller's forgets at ``decay``. The
    covariance is that of white noise passed through it.
    """
    u, y = [f"u_{axis}" for axis in plant.axes], [f"y_{axis}" for axis in plant.axes]

    # positive feedback, v = K y + e: the law has err = -y
    G = c2d(select(plant.system, u, y), law.dt or 0.0)
    K = StateSpace(law.A, -law.B, law.C, -law.D, y, u, law.dt)

    # |pole| = e^(rate dt)
    rates = np.log(np.maximum(np.abs(np.linalg.eigvals(G.A)), 1e-300)) / (law.dt or 1.0)
    L, covariance = injection_gain(
        G.A, G.C, G.dt, decay if (np.abs(rates) < decay).any() else 0.0, noise
    )
    L_K, _ = injection_gain(K.A, K.C, K.dt, decay)
    return coprime_factors(G, K, L, L_K), covariance


def residual_signals(factors: CoprimeFactors, record: Record, offset: bool = False) -> Record:
    """alpha = V~ e and eps = M~ y - N~ (u + e) of a record: an open-loop experiment on S. All
    filters start from zero states.

    offset: the means of u + e and y, such as the currents that carry the rotor, are taken out
    before.
    """
    v, y, e = _command(factors, record)
    if offset:
        v, y = v - v.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    alpha = simulate(factors.V_left, e)
    eps = simulate(select(factors.left, outputs=factors.eps), np.vstack([v, y]))
    return Record(
        record.machine,
        record.sample_rate_hz,
        (*factors.alpha, *factors.eps),
        ("A",) * len(alpha) + ("m",) * len(eps),
        np.vstack([alpha, eps]),
        record.point,
        record.start_time,
    )


def controller_error(factors: CoprimeFactors, record: Record) -> float:
    """The share (0: none) of the recorded currents that the controller does not explain: V~ v - U~
    y against V~ e, rms.

    The controller's initial state and offsets do not count.
    """
    v, y, e = (signals[:, :_LOOKED_AT] for signals in _command(factors, record))

    # V~ v - U~ y - V~ e = 0 for the controller that ran
    left_factor = select(factors.left, outputs=factors.alpha)
    left = simulate(left_factor, np.vstack([v, y])) - simulate(factors.V_left, e)

    # but for its initial state, and a constant in each alpha
    free = [
        simulate(left_factor, np.zeros((len(left_factor.inputs), v.shape[1])), x0=x0).ravel()
        for x0 in np.eye(left_factor.n_states)
    ]
    nuisance = np.vstack([*free, np.kron(np.eye(len(v)), np.ones(v.shape[1]))]).T
    unexplained = left.ravel() - nuisance @ np.linalg.lstsq(nuisance, left.ravel())[0]

    # against V~ u, what the controller did
    whole = simulate(factors.V_left, v - e)
    return float(
        np.linalg.norm(unexplained)
        / max(float(np.linalg.norm(whole - whole.mean(axis=1, keepdims=True))), 1e-300)
    )


def _command(factors: CoprimeFactors, record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the amplifiers receive (m, k), what the sensors measure (p, k), and the excitation (m,
    k).
    """
    axes = [name.removeprefix("u_") for name in factors.plant.inputs]
    e = np.stack(signal_rows(record, [f"e_{axis}" for axis in axes]))
    u = np.stack([record[f"u_{axis}"] for axis in axes])
    return u + e, np.stack([record[name] for name in factors.plant.outputs]), e


def _check_signals(plant: Plant, records: Sequence[Record]) -> None:
    for number, record in enumerate(records, 1):
        for name in [f"{kind}_{axis}" for kind in "uy" for axis in plant.axes]:
            if name not in record.signals:
                raise InvalidInput(
                    f"record {number} has no signal {name}; the residual needs every command and "
                    "displacement of the loop; "
                    "record it, or take closed_loop.identify, which needs the excitation and one "
                    "displacement only"
                )
        for name in [*plant.named("f"), *[f"r_{axis}" for axis in plant.axes]]:
            if name in record.signals and record[name].any():
                raise InvalidInput(
                    f"record {number} holds the excitation {name}; the residual is driven by "
                    "e_<axis> alone; "
                    "take closed_loop.identify, which allows forces, or record with an excitation "
                    "current"
                )


def _check_bounded(plant: Plant, records: Sequence[Record]) -> None:
    """Refuse a record whose motion grows while its excitation does not: S has no such response."""
    for number, record in enumerate(records, 1):
        y = record.select(plant.named("y")).values
        e = np.stack(
            [
                record[name]
                for name in [f"e_{axis}" for axis in plant.axes]
                if name in record.signals
            ]
        )
        k = y.shape[1]
        early, late = slice(0, k // 2), slice(4 * k // 5, k)
        growth = _swing(y[:, late]) / max(_swing(y[:, early]), 1e-300)
        driven = _swing(e[:, late]) / max(_swing(e[:, early]), 1e-300)
        if growth > _GROWTH * max(driven, 1.0):
            raise InvalidInput(
                f"the motion in record {number} grows {growth:.3g} times towards its end, its "
                "excitation does not: the loop "
                "was not stable, or another force acted; cut the record before "
                "(Record.between), or use another controller"
            )


def _swing(signals: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.var(signals, axis=1))))


def _sizes(plant: Plant, noise: Mapping[str, float] | None) -> np.ndarray:
    names = [f"y_{axis}" for axis in plant.axes]
    for name in noise or {}:
        if name not in names:
            raise invalid(
                "noise",
                repr(name),
                f"given for {', '.join(names)}",
                "name the measured displacements",
            )
    sizes = {name: np.nan if noise else 1.0 for name in names} | dict(noise or {})
    return np.array([check_positive(sizes[name], f"the noise of {name}", "in m") for name in names])


def _whitening(covariance: np.ndarray) -> np.ndarray:
    """The symmetric W (p, p) with W covariance W = I, times the noise's mean size, so that eps
    keeps its unit.
    """
    # W = V diag(values)^-1/2 V', times the geometric mean of values^1/2
    values, V = np.linalg.eigh(covariance)
    return (V / np.sqrt(values)) @ V.T * float(np.exp(np.log(values).mean() / 2))
