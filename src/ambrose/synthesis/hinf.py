"""H-infinity synthesis: the controller that makes the largest gain from w to z (nearly) as small as
any controller can.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import numpy as np

from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    check_positive,
    invalid,
    named_failure,
)
from ambrose.core.frequency import frequency_response
from ambrose.core.hinf_lmi import lmi_controller, lower_bound, shown_bound, smallest_gamma
from ambrose.core.hinf_riccati import (
    Assumptions,
    GammaSearch,
    Level,
    ScaledPlant,
    balancing_states,
    central_controller,
    check_assumptions,
    check_plant,
    full_regularisation,
    normal_form,
    original_controller,
    scale_plant,
    search_gamma,
    unavoidable,
)
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.norms import hinf_norm
from ambrose.core.processes import REMEDY, TimeLimit
from ambrose.core.statespace import ControllerLike, StateSpace, as_statespace, is_stable, select
from ambrose.judge.result import (
    INTERRUPTED,
    Certificate,
    Status,
    Synthesis,
    generalized_certificate,
)
from ambrose.law.design_problem import Weights, design_plant, scale_control
from ambrose.model.plant import Plant

_WIDEST = 2.0  # the back-off less 1 is doubled up to this before giving up
# states up to which the matrix inequalities take over by themselves; their cost grows with the
# sixth power
_LARGEST_LMI = 50
_NORM_ERROR = 1e-6  # relative, of a computed H-infinity norm
_EPSILONS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # of the regularisation, in the scaled plant's units


@named_failure("the H-infinity controller")
def hinf_synthesis(
    plant: GeneralizedPlant,
    *,
    backoff: float = 1.03,
    tolerance: float = 1e-3,
    method: Literal["riccati", "lmi"] = "riccati",
    lower: bool = True,
    time_limit: float = 60.0,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """The central H-infinity controller u = K y at ``backoff`` times the optimal gamma, verified on
    ``plant`` itself.

    plant: continuous; any D11 and D22; the sign of the loop is inside it (core/lft.py). backoff [-]
    >= 1: how far above the optimum to stay, for the optimal controller itself has arbitrarily fast
    poles; tolerance [-]: relative, of the optimal gamma; method: "riccati" (two Riccati equations)
    or "lmi" (slower, needs no assumption on D12, D21 and axis zeros); lower: False leaves
    "gamma_lower" at 0; time_limit [s] of computing,
    and five times that on the wall; progress: called with one line of text per step.

    Where an assumption of the Riccati equations fails, the plant is regularised with the smallest
    useful epsilon; where they fail all the same, up to 50 states, the matrix inequalities take over
    if their solver is installed. The result's ``notes`` say so. ``gamma`` is the closed-loop norm
    recomputed on the original plant; certificate.margins hold "gamma_optimal" (reachable; of
    "riccati" at most ``tolerance`` above the optimum of the plant that was solved, of "lmi" where
    its solver ended), "gamma_lower" (no controller comes below it on the plant as given, shown by a
    disturbance: core/hinf_lmi.py, where nothing was regularised, else what no controller
    can change at single frequencies; 0 says nothing), "gamma_designed" and "epsilon" (0 without
    regularisation);
    history has one row for each gamma tried.

    Raises InvalidInput (no controller can stabilise the plant, with the mode; sampled plants; bad
    arguments) and NumericalFailure (no verified controller, with the reason). Sources: see
    core/hinf_riccati.py, core/hinf_lmi.py.
    """
    if not 1 <= check_positive(backoff, "backoff", "1.02 to 1.05 suits most uses") < 1 + _WIDEST:
        raise invalid(
            "backoff",
            backoff,
            f"at least 1 and below {1 + _WIDEST:g}",
            "1.02 to 1.05 suits most uses",
        )
    if not 1e-10 <= check_positive(tolerance, "tolerance", "1e-3 suits most uses") < 1:
        raise invalid("tolerance", tolerance, "between 1e-10 and 1", "1e-3 suits most uses")
    if method not in ("riccati", "lmi"):
        raise invalid(
            "method", repr(method), '"riccati" or "lmi"', "leave it out for the Riccati equations"
        )
    job = _Job(
        check_plant(plant),
        backoff,
        tolerance,
        TimeLimit(time_limit),
        progress or (lambda _: None),
        lower,
    )
    scaled = scale_plant(plant)
    assumptions = check_assumptions(scaled)
    if method == "lmi":
        return _designed(job, scaled, assumptions, _by_lmi)
    try:
        return _designed(job, scaled, assumptions, _by_riccati)
    except _TimeOut:
        raise
    except NumericalFailure as failure:
        return _instead(job, scaled, assumptions, failure)


def _designed(
    job: _Job, scaled: ScaledPlant, assumptions: Assumptions, method: _Method
) -> Synthesis:
    """As it is where no assumption fails, else regularised; regularised fully where Riccati
    equations fail all the same.
    """
    if assumptions.findings:
        return _regularised(job, scaled, assumptions, method)
    try:
        return _finish(job, scaled, method(job, scaled, 0.0))
    except _TimeOut:
        raise
    except NumericalFailure as failure:
        if method is _by_lmi:
            raise
        job.say(f"{failure}; trying again with everything weighted and disturbed a little")
        return _regularised(job, scaled, full_regularisation(scaled), method)


def _instead(
    job: _Job, scaled: ScaledPlant, assumptions: Assumptions, failure: NumericalFailure
) -> Synthesis:
    """By the matrix inequalities what the Riccati equations refuse, on the plant as it is; or the
    refusal.
    """
    if find_spec("clarabel") is None:
        raise NumericalFailure(
            f"{failure}; the matrix inequalities may do: install their solver with pip install "
            '"ambrose[lmi]"'
        ) from failure
    if len(scaled.A) > _LARGEST_LMI:
        raise failure
    job.say(f"{failure}; trying the matrix inequalities")
    try:
        design = _by_lmi(job, scaled, 0.0)
    except _TimeOut:
        raise
    except NumericalFailure as other:
        raise NumericalFailure(f"{failure}; by the matrix inequalities: {other}") from failure
    note = (
        f"designed by matrix inequalities (method lmi), for the Riccati equations failed: {failure}"
    )
    return _finish(job, scaled, design, (note,))


class _TimeOut(NumericalFailure):
    """The time limit was reached before a verified controller was found."""


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    plant: GeneralizedPlant
    backoff: float
    tolerance: float
    clock: TimeLimit
    say: Callable[[str], None]
    lower: bool

    def check_time(self, best: str = "") -> None:
        if self.clock.left <= 0:
            raise _TimeOut(
                f"no verified controller within the time limit of {self.clock.seconds:g} s{best}; "
                f"{REMEDY}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    controller: StateSpace
    certificate: Certificate
    lower: float
    optimal: float
    designed: float
    epsilon: float
    history: tuple[dict[str, float], ...]
    notes: tuple[str, ...]


def _by_riccati(job: _Job, scaled: ScaledPlant, epsilon: float) -> _Design:
    """Gamma iteration, then the first verified controller at growing back-offs."""
    normal, T_u, T_y = normal_form(scaled)

    def report(level: Level) -> None:
        rho = f", rho(X Y)/gamma^2 = {level.rho:.4g}" if np.isfinite(level.rho) else ""
        job.say(f"gamma {level.gamma:.6g}: {level.reason}{rho}")
        job.check_time()

    def in_balanced_states(why: str) -> tuple[ScaledPlant, GammaSearch]:
        job.say(f"{why}; searching again in states that balance X and Y")
        plant = normal.in_states(*balancing_states(search.best))
        return plant, search_gamma(plant, job.tolerance, report)

    search, fresh = search_gamma(normal, job.tolerance, report), True
    if search.inaccurate:
        normal, search = in_balanced_states("rounding spoiled some of these levels")
        fresh = False
    step, reason = max(job.backoff - 1, 0.0), ""
    while step < _WIDEST:
        gamma = search.best.gamma * (1 + step)
        try:
            A, B, C, D = central_controller(normal, gamma)
            controller = original_controller(
                scaled, (A, B @ T_y, T_u @ C, T_u @ D @ T_y), job.plant.y, job.plant.u
            )
            certificate = verified(job.plant, controller, gamma)
        except (AmbroseError, np.linalg.LinAlgError) as failure:
            reason = f"back-off {1 + step:.4g}: {failure}"
            job.check_time()
            if fresh:
                normal, search = in_balanced_states(reason)
                fresh = False
                continue
            job.say(reason)
        else:
            job.say(f"verified: norm {certificate.closed_loop_norm:.6g} at gamma {gamma:.6g}")
            rows = tuple({**row, "epsilon": epsilon} for row in search.history)
            zero = (
                ("gamma can be made as small as wanted: w can be cancelled completely",)
                if search.vanishing
                else ()
            )
            notes = (*_backoff_note(job, step), *zero)
            return _Design(
                controller,
                certificate,
                shown_bound(normal, search) if job.lower else 0.0,
                search.best.gamma,
                gamma,
                epsilon,
                rows,
                notes,
            )
        step = max(2 * step, job.tolerance)
    raise NumericalFailure(
        f"no controller at back-offs up to {1 + step / 2:.3g} passed its verification on the "
        f"original plant ({reason}); "
        'scale the plant, bring its poles closer together, or use method="lmi"'
    )


def _by_lmi(job: _Job, scaled: ScaledPlant, epsilon: float) -> _Design:
    """The smallest gamma of the matrix inequalities, then the first verified controller at growing
    back-offs.
    """

    def time_left() -> float:
        job.check_time()
        return job.clock.left

    prepared = smallest_gamma(scaled, time_left)
    optimal = prepared.gamma
    job.say(f"the matrix inequalities give gamma {optimal:.6g}")
    step, reason = max(job.backoff - 1, job.tolerance), ""
    while step < _WIDEST:
        gamma = optimal * (1 + step)
        try:
            matrices = lmi_controller(prepared, gamma, time_left)
            controller = original_controller(scaled, matrices, job.plant.y, job.plant.u)
            certificate = verified(job.plant, controller, gamma)
        except _TimeOut:
            raise
        except (AmbroseError, np.linalg.LinAlgError) as failure:
            reason = f"back-off {1 + step:.4g}: {failure}"
            job.say(reason)
        else:
            row = {"gamma": optimal, "feasible": 1.0, "rho": float("nan"), "epsilon": epsilon}
            # where the solver ended is no bound: it may stop short of the smallest gamma
            return _Design(
                controller,
                certificate,
                lower_bound(scaled),
                optimal,
                gamma,
                epsilon,
                (row,),
                _backoff_note(job, step),
            )
        step *= 2
    raise NumericalFailure(
        f"no controller from the matrix inequalities passed its verification ({reason}); scale "
        "the plant, or bring its "
        "poles closer together"
    )


_Method = Callable[[_Job, ScaledPlant, float], _Design]


def _backoff_note(job: _Job, step: float) -> tuple[str, ...]:
    if step <= job.backoff - 1:
        return ()
    return (
        f"the back-off is {1 + step:.4g} instead of {job.backoff:g}: closer to the optimum "
        "verification failed",
    )


def verified(plant: GeneralizedPlant, controller: StateSpace, gamma: float) -> Certificate:
    """The certificate on the original plant; raises NumericalFailure unless stable with a norm
    below ``gamma``.
    """
    certificate = generalized_certificate(plant, controller)
    if not certificate.stable:
        raise NumericalFailure(
            f"the loop is unstable (spectral abscissa {certificate.spectral_abscissa:.4g} rad/s)"
        )
    if not certificate.closed_loop_norm <= gamma * (1 + 1e-5):
        raise NumericalFailure(
            f"the norm is {certificate.closed_loop_norm:.6g}, above gamma = {gamma:.6g}"
        )
    return certificate


def _regularised(
    job: _Job, scaled: ScaledPlant, assumptions: Assumptions, method: _Method
) -> Synthesis:
    """Designs with falling epsilon, until gamma no longer gains; the best verified one."""
    for finding in assumptions.findings:
        job.say(finding)
    best: _Design | None = None
    history: tuple[dict[str, float], ...] = ()
    reason = ""
    enough = max(job.tolerance, (job.backoff - 1) / 3)
    for epsilon in _EPSILONS:
        job.say(f"regularisation with epsilon = {epsilon:g}")
        try:
            design = method(
                job, scaled.extended(assumptions.rows, assumptions.columns, epsilon), epsilon
            )
        except NumericalFailure as failure:
            reason = str(failure)
            if best is not None or isinstance(failure, _TimeOut):
                break
            continue
        history += design.history
        previous, best = best, design if best is None or design.designed < best.designed else best
        if previous is not None and design.optimal > (1 - enough) * previous.optimal:
            break
    if best is None:
        raise NumericalFailure(f"{'; '.join(assumptions.findings)}; but even so: {reason}")
    notes = tuple(f"{finding}, epsilon = {best.epsilon:g}" for finding in assumptions.findings)
    return _finish(job, scaled, best, notes, history)


def _finish(
    job: _Job,
    scaled: ScaledPlant,
    design: _Design,
    notes: tuple[str, ...] = (),
    history: tuple[dict[str, float], ...] | None = None,
) -> Synthesis:
    # a bound of the regularised plant says nothing about this one
    lower = design.lower if design.epsilon == 0 else unavoidable(scaled)
    reached = design.certificate.closed_loop_norm * (1 + _NORM_ERROR)
    margins = {
        "gamma_optimal": design.optimal,
        "gamma_lower": lower if lower <= reached else 0.0,  # what rounding spoiled is none
        "gamma_designed": design.designed,
        "epsilon": design.epsilon,
    }
    certificate = replace(design.certificate, margins=margins)
    notes = (*notes, *design.notes, *_zero_control(job.plant, design))
    for note in notes:
        job.say(f"note: {note}")
    return Synthesis(
        design.controller,
        "hinf",
        certificate.closed_loop_norm,
        Status.VERIFIED if certificate.stable else Status.UNSTABLE,
        certificate,
        design.history if history is None else history,
        notes,
    )


def _zero_control(plant: GeneralizedPlant, design: _Design) -> tuple[str, ...]:
    """A note where doing nothing is as good; raises NumericalFailure for a zero controller where it
    is not.
    """
    open_norm = np.inf
    if is_stable(plant.system):
        with contextlib.suppress(UnstableSystem):
            open_norm = hinf_norm(select(plant.system, plant.w, plant.z)).value
    if open_norm <= design.designed:
        return (
            f"no control does as well: the plant is stable and has norm {open_norm:.6g} without a "
            "controller",
        )
    law = design.controller
    if not (law.D.any() or (law.B.any() and law.C.any())):
        raise NumericalFailure(
            "the controller found is zero, though no control is not optimal; rescale u and y"
        )
    return ()


# The weight of the current tuned so that a synthesised controller works as hard as a reference
# controller does.
#
# Controllers are only comparable at similar gain: paper P5 chooses W_u for each synthesis "to
# obtain similar gains of the direct terms" as the PID in the middle of the frequency range
# (Lauridsen 2017, P5, sec. 4.3, fig. 10).


BAND = (0.0, 2 * np.pi * 200.0)  # [rad/s]
_POINTS = 60  # frequencies of the grid, evenly by logarithm
# the grid starts this factor below the band's end: both controllers integrate, at their own rates
_SPAN = 200.0
_LARGEST_STEP = np.log(30.0)


class Iterates(Protocol):
    """A design that has come to its end: of several controllers that are compared the certificate
    of the chosen one alone is made.
    """

    @property
    def controller(self) -> Any: ...

    @property
    def interrupted(self) -> bool: ...

    @property
    def certified(self) -> Synthesis: ...


@dataclass(frozen=True, slots=True, eq=False)
class Tuning:
    """The tuned weights and the controller they gave.

    mismatch: mean over axes and frequencies of ln(|K_ii| / |R_ii|), 0 when the direct gains agree
    on average; factor [-]: what W_u was multiplied by; converged: whether |mismatch| is within the
    tolerance; history: factor and mismatch of each.
    """

    weights: Weights
    synthesis: Synthesis
    factor: float
    mismatch: float
    converged: bool
    history: tuple[Mapping[str, float], ...]


def direct_gain_mismatch(
    controller: ControllerLike, reference: ControllerLike, band: tuple[float, float] = BAND
) -> tuple[float, float]:
    """Mean and root mean square of ln(|K_ii| / |R_ii|) over the axes and the band [rad/s], on a
    logarithmic grid.

    The grid starts at the band's lower end, but not below 1/200 of the upper one. Raises
    InvalidInput for controllers of different sizes, a reference without direct gain, or an empty
    band.
    """
    controller, reference = as_statespace(controller), as_statespace(reference)
    if controller.D.shape != reference.D.shape or controller.D.shape[0] != controller.D.shape[1]:
        raise invalid(
            "the controller's size",
            controller.D.shape,
            f"square, like the reference's {reference.D.shape}",
            "match",
        )
    low, high = band
    if not 0 <= low < high < np.inf:
        raise invalid(
            "band", band, "ascending, not negative and finite, in rad/s", "0 to 200 Hz is usual"
        )
    omega = np.geomspace(max(low, high / _SPAN), high, _POINTS)
    gains = [
        np.abs(np.diagonal(frequency_response(item, omega).values, axis1=1, axis2=2))
        for item in (controller, reference)
    ]
    if not (gains[1] > 0).all():
        raise InvalidInput(
            "the reference controller has an axis without direct gain; compare with a "
            "decentralised controller"
        )
    ratio = np.log(np.maximum(gains[0], 1e-300) / gains[1])
    return float(ratio.mean()), float(np.sqrt((ratio**2).mean()))


@named_failure("the control weight")
def tune_control_weight(
    plant: Plant | GeneralizedPlant,
    weights: Weights,
    reference_controller: Any,
    synthesize: Callable[[GeneralizedPlant], Iterates],
    *,
    uncertain: bool = True,
    tolerance: float = 0.02,
    max_syntheses: int = 12,
) -> Tuning:
    """W_u multiplied by the factor at which the synthesised controller's direct gains match the
    reference's in the band.

    plant, weights, uncertain: as for ``design_plant``. reference_controller: err_<axis> ->
    u_<axis>, usually the PID. synthesize: design problem -> Synthesis (H-infinity), or what becomes
    one (mu). tolerance [-]: of the mean ln ratio, 0.02 is 2 % of gain. A bracketing secant search
    in ln(factor); where the gains cannot be matched, or at Ctrl-C, the nearest is returned with
    converged False. Raises what ``synthesize`` raises for the weights it is first given.
    """
    check_positive(tolerance, "tolerance", "0.02 is 2 % of gain")
    trials: dict[float, tuple[Iterates, float]] = {}

    def mismatch(x: float) -> float:
        made = synthesize(
            design_plant(plant, scale_control(weights, float(np.exp(x))), uncertain=uncertain)
        )
        trials[x] = made, direct_gain_mismatch(made.controller, reference_controller)[0]
        if made.interrupted:
            raise KeyboardInterrupt
        return trials[x][1]

    interrupted = False
    try:
        _search(mismatch, tolerance, max_syntheses)
    except KeyboardInterrupt:
        if not trials:
            raise
        interrupted = True
    x = min(trials, key=lambda key: abs(trials[key][1]))
    made, mean = trials[x]
    found = made.certified
    if interrupted:
        found = replace(found, stopped_early=f"the search for its control weight was {INTERRUPTED}")
    history = tuple(
        {"factor": float(np.exp(key)), "mismatch": value} for key, (_, value) in trials.items()
    )
    factor = float(np.exp(x))
    met = abs(mean) <= tolerance
    return Tuning(scale_control(weights, factor), found, factor, mean, met, history)


def _search(function: Callable[[float], float], tolerance: float, most: int) -> None:
    """Look for a root of a falling function from x = 0, whose slope is first taken as -1: secant
    steps until the root is bracketed, then false position with halving (Illinois). A trial that
    fails numerically is retried half as far.
    """
    x, f = 0.0, function(0.0)
    ends: dict[bool, tuple[float, float]] = {}  # the newest point on either side, by f > 0
    previous: tuple[float, float] | None = None
    for _ in range(most - 1):
        if abs(f) <= tolerance:
            return
        side = f > 0
        if previous is not None and (previous[1] > 0) == side and (not side) in ends:
            x_other, f_other = ends[not side]
            ends[not side] = (x_other, f_other / 2)
        ends[side] = (x, f)
        if len(ends) == 2:
            (a, fa), (b, fb) = ends[True], ends[False]
            trial = a + (b - a) * fa / (fa - fb)
        else:
            slope = -1.0 if previous is None else min((f - previous[1]) / (x - previous[0]), -0.1)
            trial = x + float(np.clip(-1.2 * f / slope, -_LARGEST_STEP, _LARGEST_STEP))
        previous = (x, f)
        try:
            x, f = trial, function(trial)
        except NumericalFailure:
            x = 0.5 * (x + trial)
            f = function(x)
