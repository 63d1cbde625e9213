"""mu synthesis by D-K iteration: a controller that keeps its performance for every perturbation,
complex ones included.

K-step: H-infinity synthesis on the plant with D(s) on its z and D(s)^-1 on its w. D-step: the upper
bound of mu of the loop over frequency, and a stable minimum-phase D(s) of low order for it. Real
blocks are treated as complex here, which is safe and conservative; mixed mu, which knows that they
are real, is reported at every step beside it. (Doyle 1985; Packard & Doyle 1993, sec. 9; Skogestad
& Postlethwaite 2005, sec. 8.12.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    check_positive,
    check_shape,
    invalid,
    named_failure,
)
from ambrose.core.hinf_riccati import check_plant
from ambrose.core.lft import Block, GeneralizedPlant, design_grid, lft
from ambrose.core.mu.all_frequencies import proved_below
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.norms import hinf_norm
from ambrose.core.processes import TimeLimit
from ambrose.core.statespace import StateSpace, poles, spectral_abscissa
from ambrose.judge.result import (
    CERTIFYING,
    INTERRUPTED,
    Certificate,
    Status,
    Synthesis,
    generalized_certificate,
)
from ambrose.law.design_problem import with_performance_block
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.mu_scalings import (
    HIGHEST_ORDER,
    DStep,
    FittedScaling,
    Scaling,
    constant,
    d_blocks,
    d_step,
    extrapolate,
    fit_scaling,
    of_scalars,
    peak_below,
    scaled_loop,
    scaled_plant,
)

_GAIN = 1e-3  # a step that lowers the best bound by less than this fraction ends the iteration
_STRIDES = (4.0, 16.0, 64.0)  # how much further than the D-step says D may be moved
_FACTOR = 2.0  # of one step in the search for the first D's level
_FURTHEST = 40  # steps
_TIGHTEST = 1.5e-3  # back-off less 1, below which it is not made smaller
_RUN_AWAY = (
    2.0  # times the fastest pole of the controller before: the seal rig's still runs at 10 kHz
)
_PROOF = (1.01, 1.03, 1.1)  # levels, in mixed peaks, at which an interval proof is tried


@named_failure("the mu controller")
def mu_synthesis(
    plant: GeneralizedPlant,
    *,
    iterations: int = 4,
    order: int | Literal["auto"] = "auto",
    structure: Literal["scalar", "full"] = "scalar",
    backoff: float = 1.03,
    fit_tolerance: float = 0.02,
    omega: ArrayLike | None = None,
    time_limit: float = 120.0,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """D-K iteration on a plant with blocks; the best iterate, verified on ``plant`` itself.

    plant: its blocks are the uncertainty; remaining w and z are the performance, and get a full
    block. iterations: K-steps after the starting controller (H-infinity for the nominal plant).
    order: of every D(s) per channel, or "auto": the smallest with which sigma_max(D M D^-1) peaks
    at most ``fit_tolerance`` [-] above the upper bound of mu; of the iterates within that tolerance
    of the best, the one with the fewest states is then returned. structure: d(s) I ("scalar") or a
    matrix D(s) ("full") for repeated blocks; a D of order n costs 2 r n states of the controller
    for a block of size r either way. backoff [-]: see hinf_synthesis; once D has settled smaller
    ones are tried, too, and kept where gamma falls and poles stay slow. omega (w,) [rad/s]: grid of
    the D-step, default: the plant's poles and a decade around them; resonances and peaks are added.
    time_limit [s] of computing, and five times that on the wall (``core.processes``); progress:
    called with one line of text per step.

    ``gamma`` and the certificate's norm are the H-infinity norm of D M D^-1, a certified bound of
    complex mu: below 1 the performance holds for every perturbation. certificate.margins:
    "mu_complex" (upper bound on the grid), "mu_mixed" and "mu_mixed_lower" (peaks on the grid),
    "mu_mixed_proved" (proved for all frequencies, at most gamma), "mu_frequency" [rad/s],
    "nominal_norm" (performance channels without perturbation), "scaling_states". history: one row
    per controller.

    Ctrl-C, the time limit or a failing step end the iteration: the best verified controller so far
    is returned; ``stopped_early`` says why. Raises InvalidInput (no blocks, or bad arguments) and
    NumericalFailure when not even the first controller could be verified. The controller keeps all
    its states: those of plant and scalings.
    """
    return mu_iterates(
        plant,
        iterations=iterations,
        order=order,
        structure=structure,
        backoff=backoff,
        fit_tolerance=fit_tolerance,
        omega=omega,
        time_limit=time_limit,
        progress=progress,
    ).certified


@named_failure("the mu controller")
def mu_iterates(
    plant: GeneralizedPlant,
    *,
    iterations: int = 4,
    order: int | Literal["auto"] = "auto",
    structure: Literal["scalar", "full"] = "scalar",
    backoff: float = 1.03,
    fit_tolerance: float = 0.02,
    omega: ArrayLike | None = None,
    time_limit: float = 120.0,
    progress: Callable[[str], None] | None = None,
) -> MuIterates:
    """``mu_synthesis`` but for the certificate and mixed mu: of a controller that is compared with
    others first. Arguments and errors are the same.
    """
    if not isinstance(iterations, int | np.integer) or iterations < 0:
        raise invalid(
            "iterations", iterations, "a whole number, at least 0", "4 suits most problems"
        )
    if order != "auto" and (not isinstance(order, int | np.integer) or not 0 <= order <= 10):
        raise invalid(
            "order", repr(order), 'a whole number from 0 to 10, or "auto"', "1 or 2 is usual"
        )
    if structure not in ("scalar", "full"):
        raise invalid(
            "structure",
            repr(structure),
            '"scalar" or "full"',
            "it says how repeated blocks are scaled",
        )
    check_positive(fit_tolerance, "fit_tolerance", "0.02 suits most problems")
    clock = TimeLimit(time_limit)
    complete = _with_performance(check_plant(plant))
    blocks, grid = d_blocks(complete.blocks, structure), _grid(plant, omega)
    job = _Job(
        complete, blocks, order, backoff, fit_tolerance, grid, clock, progress or (lambda _: None)
    )
    iterates: list[_Iterate] = []
    reason = ""
    try:
        iterates.append(_evaluate(job, _start(job), None, 0))
        lowest = 0
        for _ in range(iterations):
            job.check_time()
            iterates.append(_step(job, iterates, lowest))
            if _settled(job, iterates):
                orders = iterates[-1].orders
                if order != "auto" or max(orders) < lowest or lowest >= HIGHEST_ORDER:
                    break
                lowest = 1 + max(orders)
        _tightened(job, iterates)
    except (KeyboardInterrupt, AmbroseError, np.linalg.LinAlgError) as stop:
        # not the time that was left to an inner step
        late = job.clock.reached if job.clock.left <= 0 else str(stop)
        reason = INTERRUPTED if isinstance(stop, KeyboardInterrupt) else late
        if not iterates:
            raise
        if isinstance(stop, KeyboardInterrupt):
            job.say(CERTIFYING)
    return MuIterates(job, tuple(iterates), reason, job.clock.left)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    plant: GeneralizedPlant  # with the performance block
    blocks: Sequence[Block]  # of the D-step
    order: int | Literal["auto"]
    backoff: float
    fit_tolerance: float
    grid: np.ndarray
    clock: TimeLimit
    say: Callable[[str], None]

    @property
    def left(self) -> float:
        """Seconds for a step; never below a millisecond, so that the step itself reports the time
        limit.
        """
        return max(self.clock.left, 1e-3)

    def check_time(self) -> None:
        if self.clock.left <= 0:
            raise NumericalFailure(self.clock.reached)


def _with_performance(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant with a block for its performance, if it has any. Raises InvalidInput where there is
    nothing to scale.
    """
    if not plant.blocks:
        raise InvalidInput(
            "the plant has no blocks; without uncertainty hinf_synthesis is the method"
        )
    if len(plant.w) > plant.n_w_blocks or len(plant.z) > plant.n_z_blocks:
        plant = with_performance_block(plant)
    if len(plant.blocks) < 2:
        raise InvalidInput(
            "the plant has one block only, so there is nothing to scale; use hinf_synthesis"
        )
    return plant


def _grid(plant: GeneralizedPlant, omega: ArrayLike | None) -> np.ndarray:
    grid = (
        design_grid(plant)
        if omega is None
        else np.unique(check_shape(omega, "omega", "(w)").astype(float))
    )
    if len(grid) < 3 or grid[0] <= 0:
        raise invalid(
            "omega",
            f"{len(grid)} frequencies from {grid.min(initial=0):g}",
            "3 or more, positive",
            "in rad/s",
        )
    return grid


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    controller: StateSpace
    gamma: float  # certified bound of complex mu
    used: FittedScaling | None  # D of the K-step that made it
    fitted: FittedScaling  # from this controller's own loop: for the next K-step
    step: DStep
    stable_abscissa: float
    row: dict[str, float]

    @property
    def orders(self) -> tuple[int, ...]:
        return (0,) if self.used is None else self.used.scaling.orders


def _start(job: _Job) -> StateSpace:
    """H-infinity for the nominal plant; where that fails, for the whole one without scaling."""
    if job.plant.blocks[-1].full:
        try:
            return _k_step(job, _performance_only(job.plant), job.backoff).controller
        except NumericalFailure as failure:
            job.say(
                f"no start from the nominal plant ({failure}); starting from the whole plant "
                "without scaling"
            )
    return _k_step(job, job.plant, job.backoff).controller


def _k_step(
    job: _Job, plant: GeneralizedPlant, backoff: float, tolerance: float = 1e-3
) -> Synthesis:
    return hinf_synthesis(
        plant, backoff=backoff, tolerance=tolerance, lower=False, time_limit=job.left
    )


def _performance_only(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant without uncertainty, between the signals of the last block."""
    last = plant.blocks[-1]
    return GeneralizedPlant(
        plant.system, plant.w[-last.n_w :], plant.u, plant.z[-last.n_z :], plant.y
    )


def _step(job: _Job, iterates: Sequence[_Iterate], lowest: int) -> _Iterate:
    """One K-step with the last D, then the evaluation of its controller."""
    last = iterates[-1]
    if len(iterates) == 1:
        used = _first_scaling(job, last)
    else:
        fitted = (
            fit_scaling(last.step, job.order, job.fit_tolerance, lowest) if lowest else last.fitted
        )
        used = _further(job, last, fitted)
    made = _k_step(job, scaled_plant(job.plant, used.scaling), job.backoff)
    for note in made.notes:
        job.say(f"K-step: {note}")
    return _evaluate(job, made.controller, used, len(iterates))


def _gamma(job: _Job, scaling: Scaling, tolerance: float = 1e-2) -> float:
    """The smallest gamma of a K-step; inf where there is none."""
    job.check_time()
    try:
        made = _k_step(job, scaled_plant(job.plant, scaling), 1.1, tolerance)
    except NumericalFailure:
        return float("inf")
    return made.certificate.margins["gamma_optimal"]


def _further(job: _Job, last: _Iterate, fitted: FittedScaling) -> FittedScaling:
    """D as fitted, or some times as far from the D used last, whichever the K-step likes best.

    Where the loop is flat the new D lies close to the old one, and D-K crawls along a long valley;
    steps of several times the length cost one H-infinity synthesis each.
    """
    if last.used is None:
        return fitted
    best = fitted
    value = _gamma(job, fitted.scaling, _GAIN)
    taken = 1.0
    for factor in _STRIDES:
        trial = extrapolate(last.step, last.used, fitted, factor)
        gamma = np.inf if trial is None else _gamma(job, trial.scaling, _GAIN)
        if trial is not None and gamma < value * (1 - _GAIN):
            best = trial
            value = gamma
            taken = factor
    if taken > 1:
        job.say(f"D moved {taken:g} times as far")
    return best


def _first_scaling(job: _Job, start: _Iterate) -> FittedScaling:
    """The first D: constants in the ratios of the nominal controller's loop, at the level that
    promises most.

    Where gamma is smallest over the level, D and K may be optimal for each other, with the optimum
    far away and no way to it but a crawl; off this point the D-step sees which way to go. So the
    best level and its neighbours are followed one step.
    """
    peak = int(np.argmax(start.step.upper))
    size = [
        start.step.D_w[peak, place.w.start, place.w.start].real
        for place in start.step.structure.places
    ]
    tried: dict[int, float] = {}

    def at(k: int) -> FittedScaling:
        return of_scalars(
            start.step, [*(constant(float(x) * _FACTOR**k) for x in size[:-1]), constant(1.0)]
        )

    def gamma(k: int) -> float:
        if k not in tried:
            tried[k] = _gamma(job, at(k).scaling)
        return tried[k]

    # Downhill over the level 2^k, by four steps, then by single ones.
    best = 0
    for stride in (4, 1):
        while abs(best) < _FURTHEST:
            move = min((best, best - stride, best + stride), key=gamma)
            if move == best:
                break
            best = move
    if not np.isfinite(gamma(best)):
        return start.fitted

    def ahead(k: int) -> float:
        job.check_time()
        try:
            made = _k_step(job, scaled_plant(job.plant, at(k).scaling), 1.05, 1e-2)
        except NumericalFailure:
            return float("inf")
        step = d_step(lft(job.plant, made.controller), job.blocks, job.grid[::2], rounds=0)
        return _gamma(job, fit_scaling(step, job.order, job.fit_tolerance).scaling, _GAIN)

    # What the K-step reaches after one more D-step from each.
    follow = {k: ahead(k) for k in (best, best - 1, best + 1)}
    # no detour for nothing
    chosen = min(follow, key=lambda k: follow[k] * (1.0 if k == best else 1.01))
    job.say(f"first D: constant, gamma {gamma(chosen):.4g} and {follow[chosen]:.4g} one step on")
    return at(chosen)


def _evaluate(
    job: _Job, controller: StateSpace, used: FittedScaling | None, number: int
) -> _Iterate:
    """Everything about a controller, on the original plant. Raises NumericalFailure when its loop
    is unstable.
    """
    loop = lft(job.plant, controller)
    abscissa = spectral_abscissa(loop)
    if not abscissa < 0:
        raise NumericalFailure(f"the loop is unstable (spectral abscissa {abscissa:.4g} rad/s)")
    step = d_step(loop, job.blocks, job.grid)
    fitted = fit_scaling(step, job.order, job.fit_tolerance)
    scalings = [fitted.scaling] if used is None else [fitted.scaling, used.scaling]
    gamma = min(hinf_norm(scaled_loop(loop, scaling)).value for scaling in scalings)
    row = {
        "iteration": float(number),
        "gamma": gamma,
        "order": float(controller.n_states),
        "d_order": float(max(used.scaling.orders)) if used is not None else 0.0,
        "scaling_states": float(used.scaling.states) if used is not None else 0.0,
        "seconds": job.clock.elapsed,
    }
    job.say(
        f"iteration {number}: complex mu <= {gamma:.4f}, order {controller.n_states}, D of order "
        f"{int(row['d_order'])}, {row['seconds']:.1f} s"
    )
    return _Iterate(controller, gamma, used, fitted, step, abscissa, row)


def _mu(job: _Job, step: DStep) -> dict[str, float]:
    """Complex and mixed bounds of the plant's own blocks, on the step's grid."""
    blocks = job.plant.blocks
    ceiling = step.upper

    # The D-step's bound holds for d I on repeated blocks, thus also for full D there, and for
    # mixed mu: a ceiling that spares frequencies.
    complex_peak = step.peak
    if any(b.repeat > 1 for b in blocks):
        complex_peak, ceiling, _ = peak_below(step, blocks, ceiling, g_scaling=False)
    mixed, values, known = peak_below(step, blocks, ceiling, g_scaling=True)
    # the lower bound where the upper one is highest
    at = np.flatnonzero(known)[np.argsort(-values[known])[:3]]
    lower = mu_bounds(step.M[at], blocks, tolerance=1e-3).lower.max()
    return {
        "mu_complex": complex_peak,
        "mu_mixed": mixed,
        "mu_mixed_lower": min(float(lower), mixed),
        "mu_frequency": float(step.omega[at[0]]),
    }


def _tightened(job: _Job, iterates: list[_Iterate]) -> None:
    """Once D has settled, the back-off is what keeps gamma up: K-steps with a quarter of it, and a
    quarter of that, go on from the best iterate as long as gamma falls.

    Added to ``iterates`` where gamma falls and no pole is twice as fast as before the first of
    them: nearer to the optimum the controller's poles run away.
    """
    if len(iterates) < 2:
        return
    backoff, allowed = job.backoff, _RUN_AWAY * _fastest(_best(job, iterates))
    while backoff - 1 > _TIGHTEST and job.clock.left > 0:
        backoff = 1 + (backoff - 1) / 4
        best = _best(job, iterates)
        for scaling in (best.fitted, best.used):
            if scaling is None:
                continue
            try:
                made = _k_step(
                    job,
                    scaled_plant(job.plant, scaling.scaling),
                    backoff,
                    min(1e-3, (backoff - 1) / 3),
                )
                found = _evaluate(job, made.controller, scaling, len(iterates))
            except AmbroseError as failure:
                job.say(f"back-off {backoff:.4g}: {failure}")
                continue
            if found.gamma < best.gamma * (1 - _GAIN) and _fastest(found) <= allowed:
                job.say(f"back-off {backoff:.4g}: gamma {found.gamma:.4f}, before {best.gamma:.4f}")
                iterates.append(found)
                break


def _fastest(iterate: _Iterate) -> float:
    return float(np.abs(poles(iterate.controller)).max(initial=0.0))


def _settled(job: _Job, iterates: Sequence[_Iterate]) -> bool:
    """Whether the last step brought nothing; the first one is never the last."""
    least = _GAIN if job.order != "auto" else max(_GAIN, 0.25 * job.fit_tolerance)
    return len(iterates) > 2 and iterates[-1].gamma > (1 - least) * min(
        item.gamma for item in iterates[:-1]
    )


def _best(job: _Job, iterates: Sequence[_Iterate]) -> _Iterate:
    """The smallest gamma; with automatic order the fewest states within ``fit_tolerance`` of it."""
    best = min(iterates, key=lambda item: item.gamma)
    if job.order == "auto":
        near = [item for item in iterates if item.gamma <= best.gamma * (1 + job.fit_tolerance)]
        fewest = min(item.controller.n_states for item in near)
        best = min(
            (item for item in near if item.controller.n_states == fewest),
            key=lambda item: item.gamma,
        )
    return best


@dataclass(frozen=True, eq=False)
class MuIterates:
    """A D-K iteration that has come to its end; left [s]: of its time limit."""

    job: _Job
    iterates: tuple[_Iterate, ...]
    reason: str
    left: float

    @property
    def controller(self) -> StateSpace:
        """Of the best iterate."""
        return _best(self.job, self.iterates).controller

    @property
    def interrupted(self) -> bool:
        return self.reason == INTERRUPTED

    @cached_property
    def certified(self) -> Synthesis:
        """The best iterate with its certificate, and mixed mu of them all."""
        job = self.job
        if self.left > 0:  # what was computed since is not this iteration's
            job = replace(job, clock=TimeLimit(self.left))
        rows = [
            {"iteration": item.row["iteration"], "gamma": item.gamma, **_mu(job, item.step)}
            | item.row
            for item in self.iterates
        ]
        pairs = zip(self.iterates, rows, strict=True)
        return _result(job, [replace(item, row=row) for item, row in pairs], self.reason)


def _result(job: _Job, iterates: Sequence[_Iterate], reason: str) -> Synthesis:
    best = _best(job, iterates)
    row = best.row
    found = generalized_certificate(_performance_only(job.plant), best.controller)
    names = ("mu_complex", "mu_mixed", "mu_mixed_lower", "mu_frequency", "scaling_states")
    margins = {name: row[name] for name in names}
    margins["mu_mixed_proved"] = _proved(job, best)
    margins["nominal_norm"] = found.closed_loop_norm
    certificate = Certificate(
        best.stable_abscissa < 0,
        best.stable_abscissa,
        best.gamma,
        found.fastest_pole,
        margins,
        f"generalized plant with {job.plant.system.n_states} states and {len(job.plant.blocks)} "
        "blocks",
    )
    number = iterates.index(best)
    notes = [f"iteration {number} of {len(iterates) - 1} is the best"]
    stopped = f"after iteration {len(iterates) - 1}, {reason}" if reason else None
    if stopped:
        notes.append(f"stopped early: {stopped}")
    for note in notes:
        job.say(note)
    return Synthesis(
        best.controller,
        "mu",
        best.gamma,
        Status.VERIFIED if certificate.stable else Status.UNSTABLE,
        certificate,
        tuple(item.row for item in iterates),
        tuple(notes),
        stopped_early=stopped,
    )


def _proved(job: _Job, best: _Iterate) -> float:
    """A level that mixed mu is proved to stay below at every frequency: gamma itself, or less where
    the proof succeeds.
    """
    if job.clock.left <= 0:
        return best.gamma
    loop = lft(job.plant, best.controller)
    for factor in _PROOF:
        level = factor * best.row["mu_mixed"]
        if level >= best.gamma:
            break
        if proved_below(loop, job.plant.blocks, level):
            return level
    return best.gamma
