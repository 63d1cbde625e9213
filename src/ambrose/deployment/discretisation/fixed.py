"""A controller made ready to run at a sample rate, and verified as it will run: sampled, late, over the uncertainty.

Timing: the displacements are read at sample k, the code computes u[k] from e[k], and the currents reach the amplifiers
``delay`` samples later, held until the next ones. The code holds the controller without the delay; every verification here
holds it with the delay, around the plant sampled with a zero-order hold (diagram in core/lft.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, check_positive, invalid
from ambrose.core.realisation.modal_form import ModalForm, modal_form
from ambrose.core.sampling import Method, c2d, delayed
from ambrose.core.statespace import StateSpace, as_statespace, feedback, poles, select, series, spectral_abscissa, static_gain
from ambrose.core.worst_case.loop import corners, samples
from ambrose.plant.loop import named_controller
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.plant.uncertainty import perturbed
from ambrose.synthesis.certificate import certify, match_controller
from ambrose.synthesis.result import Status
from ambrose.verification import nominal
from ambrose.verification.checks import Check, Checks
from ambrose.verification.criteria import Demand, information, judge

_FULL_POINTS = 40  # points of the box at which the eigenvalues of the full plant's loop are computed
_MODES = 3  # bending modes per plane of the plant on which all points are examined
_INSIDE = 32
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Deployment:
    """A controller as it will run.

    controller: sampled, in modal form with blocks of ``sizes``, without the computing delay; increment (n, n): A - I with
    all its digits (a slow pole is 1 - 1e-7); delay [samples]; source: what it was made from; checks: the verification at every
    operating point; box: over the tolerances (None: not done); problems: what speaks against deploying it, one sentence each.
    """

    controller: StateSpace
    increment: np.ndarray
    sizes: tuple[int, ...]
    delay: int
    method: str
    source: StateSpace
    checks: tuple[Checks, ...]
    box: Checks | None
    problems: tuple[str, ...]

    @property
    def verified(self) -> bool:
        """Whether the source was verified and the sampled loop is stable wherever it has to be."""
        return not self.problems

    @property
    def in_loop(self) -> StateSpace:
        """The controller with its computing delay."""
        return delayed(self.controller, self.delay)


def deploy(
    controller: Any,
    sample_time: float,
    delay: float = 0.0,
    *,
    method: Method = "tustin",
    prewarp: float | None = None,
    plants: Sequence[Plant] = (),
    force: bool = False,
    progress: Progress = lambda stage: None,
) -> Deployment:
    """``controller`` sampled at sample_time [s] and verified with the computing delay [s] in the loop.

    controller: a Synthesis or a system, continuous or sampled already. method: "tustin", exact at
    ``prewarp`` [rad/s] if given, or "zoh". plants: the full plant at every operating point, the nominal one first; its
    machine's tolerances are the uncertainty. Refused unless ``force``: a controller that is unstable itself or was not
    verified, and one whose sampled loop is unstable at an operating point or in the tolerances, or was not examined (no
    plants). Raises InvalidInput (also for a delay that is no whole number of samples, and a sample rate too low for the
    fastest pole, force or not) and UnstableSystem.
    """
    check_positive(sample_time, "the sample time", "give it in seconds")
    status = getattr(controller, "status", None)
    source = as_statespace(getattr(controller, "controller", controller))
    count = whole_samples(delay, sample_time)
    problems = list(own_problems(source, status, examined=bool(plants)))
    if problems and not force:
        raise UnstableSystem(refusal(problems))
    sampled, increment, form = _sampled(source, sample_time, method, prewarp)
    late = delayed(sampled, count)
    checks, box = _verified(late, plants, progress)
    problems += _loop_problems(checks, box)
    if problems and not force:
        raise UnstableSystem(refusal(problems))
    return Deployment(sampled, increment, form.sizes, count, method, source, checks, box, tuple(problems))


def whole_samples(delay: float, sample_time: float) -> int:
    """``delay`` [s] as a number of samples. Raises InvalidInput for a fraction."""
    check_positive(delay, "the computing delay", "give it in seconds", zero_allowed=True)
    count = round(delay / sample_time)
    if abs(delay - count * sample_time) > 1e-6 * sample_time:
        remedy = "round it up: outputs are written when the next sample is taken"
        raise invalid("the computing delay", f"{delay:g} s", f"a whole number of samples of {sample_time:g} s", remedy)
    return count


def fastest_allowed(controller: StateSpace) -> float:
    """The lowest sample rate [Hz] that a continuous controller can be run at: its fastest pole lies at half of it."""
    return float(np.abs(poles(controller)).max(initial=0.0) / np.pi)


def check_rate(source: StateSpace, dt: float) -> None:
    """Refuse a sample time [s] that is too long for a continuous controller's fastest pole. Raises InvalidInput."""
    needed = fastest_allowed(source)
    if 1 / dt < needed:
        remedy = f"sample at {needed:.4g} Hz or more, or roll the controller off below {np.pi / dt:.4g} rad/s"
        fastest = f"{needed * np.pi:.4g} rad/s"
        raise invalid("the sample rate", f"{1 / dt:.4g} Hz", f"at least {needed:.4g} Hz for a pole at {fastest}", remedy)


def own_problems(source: StateSpace, status: Status | None, *, examined: bool) -> list[str]:
    """What speaks against a controller before its loop is closed, one sentence each."""
    return status_problems(status, examined=examined) + instability(source)


def status_problems(status: Status | None, *, examined: bool) -> list[str]:
    """What a controller's own status says against it; ``examined``: whether its loop is about to be."""
    if status is None or status is Status.UNCERTIFIED:
        return [] if examined else ["the controller carries no certificate: it was never verified on a plant"]
    return [] if status is Status.VERIFIED else [f"the controller's status is '{status}', not 'verified'"]


def instability(source: StateSpace, where: str = "") -> list[str]:
    """One sentence if the controller itself is unstable; integrators are meant to be on the boundary."""
    size = max(float(np.abs(poles(source)).max(initial=0.0)), 1.0)
    abscissa = spectral_abscissa(source)
    if not source.n_states or abscissa <= 1e-9 * size:
        return []
    pole = f"a pole at {abscissa:+.4g} rad/s"
    return [f"the controller itself is unstable{where} ({pole}): it runs away whenever the loop is open"]


def refusal(problems: Sequence[str]) -> str:
    """The message of a deployment refused."""
    text = "; ".join(problems)
    return f"this controller is not deployed: {text}; design or verify it again, or say that it is wanted all the same (force)"


def _sampled(source: StateSpace, dt: float, method: Method, prewarp: float | None) -> tuple[StateSpace, np.ndarray, ModalForm]:
    """The sampled controller, its A - I from the continuous modal form (no digits lost to 1 - 1e-7), and that form."""
    if source.dt is not None:
        if abs(source.dt - dt) > 1e-9 * dt:
            raise invalid("the sample time", f"{dt:g} s", f"the controller's {source.dt:g} s", "it is sampled already")
        form = modal_form(source)
        return form.system, form.system.A - np.eye(form.system.n_states), form
    check_rate(source, dt)
    form = modal_form(source)
    K, n = form.system, form.system.n_states
    sampled = c2d(K, dt, method, prewarp=prewarp)
    eye = np.eye(n)
    increment = K.A @ c2d(StateSpace(K.A, eye, eye, np.zeros((n, n))), dt, method, prewarp=prewarp).B if n else np.zeros((0, 0))
    inside = np.zeros((n, n), bool)
    for start, k in zip(form.starts, form.sizes, strict=True):
        inside[start : start + k, start : start + k] = True
    increment = np.where(inside, increment, 0.0)
    A = eye + increment
    return StateSpace(A, sampled.B, sampled.C, sampled.D, source.inputs, source.outputs, dt), increment, form


def _verified(
    late: StateSpace, plants: Sequence[Plant], progress: Progress
) -> tuple[tuple[Checks, ...], Checks | None]:  # fmt: skip
    checks = []
    for plant in plants:
        progress(f"verifying the sampled loop at {plant.point.label}")
        matched = named_controller(plant, match_controller(late, plant))
        checks.append(nominal.check(plant, matched))
    box = None
    if plants and plants[0].machine.tolerances:
        progress("verifying the sampled loop over the tolerances")
        box = box_check(plants[0], match_controller(late, plants[0]))
    return tuple(checks), box


def box_check(plant: Plant, late: StateSpace) -> Checks:
    """Stability and the sampled output sensitivity of a loop over its machine's tolerances, at corners and samples.

    By eigenvalues. plant: the full one. late: the sampled controller with its delay. Unlike ``robust.check`` it proves nothing
    between the points: a sampled plant depends on its parameters through a matrix exponential.
    """
    machine = plant.machine
    names = [tolerance.parameter for tolerance in machine.tolerances]
    points = np.vstack([np.zeros((1, len(names))), corners(len(names)), samples(len(names), _INSIDE)])
    small = reduce(plant, _MODES) if plant.bending_modes is None else plant
    abscissa = np.empty(len(points))
    peak = np.empty(len(points))
    for i, point in enumerate(points):
        delta = dict(zip(names, point.tolist(), strict=True))
        found = certify(perturbed(small, delta), late)
        abscissa[i], peak[i] = found.spectral_abscissa, found.closed_loop_norm
        if i < _FULL_POINTS:
            abscissa[i] = max(abscissa[i], _abscissa(perturbed(plant, delta), late))
    unstable = abscissa >= 0
    worst = int(np.argmax(np.where(unstable, np.inf, peak)))
    outermost = int(abscissa.argmax())

    def where(i: int) -> str:
        return ", ".join(f"{name} {value:+.3g}" for name, value in zip(names, points[i], strict=True))

    example = f"; for one, {where(outermost)} ({abscissa[outermost]:+.4g} rad/s)" if unstable.any() else ""
    full = min(_FULL_POINTS, len(points))
    extent = f"{len(points)} corners and samples, {full} of them on the full plant{example}"
    value = np.inf if unstable.any() else float(peak[worst])
    checks: list[Check] = [
        judge(
            "sampled.stability.box", "Unstable points of the tolerance box, sampled loop", int(unstable.sum()), "-",
            Demand(0.0, "<=", "every tolerance"), extent,
        ),
        information("sampled.abscissa.box", "Outermost pole over the box", float(abscissa.max()), "rad/s", where(outermost)),
        information("sampled.sensitivity.box", "Sampled output sensitivity over the box", value, "-", where(worst)),
    ]  # fmt: skip
    return Checks("over the tolerances, sampled", not unstable[0], tuple(checks))


def _abscissa(plant: Plant, late: StateSpace) -> float:
    dt = late.dt
    if dt is None:
        raise InvalidInput("the controller is continuous; box_check takes the sampled one")
    opened = c2d(select(plant.system, plant.named("u"), plant.named("y")), dt)
    return spectral_abscissa(feedback(series(late, opened), static_gain(np.eye(len(plant.axes)), dt=dt)))


def _loop_problems(checks: Sequence[Checks], box: Checks | None) -> list[str]:
    if not checks:
        return ["its sampled loop was not examined: no plant was given"]
    found = [f"the sampled loop is unstable at {c.label}" for c in checks if not c.stable]
    if box is not None and box.checks[0].passed is False:
        found.append(
            f"the sampled loop is unstable at {box.checks[0].value:.0f} points of the tolerances ({box.checks[0].detail})"
        )
    return found


def unmet(deployment: Deployment) -> tuple[str, ...]:
    """The checks of the sampled loop whose limits are not met, in words; they warn and do not stop a deployment."""
    return tuple(
        f"{checks.label}: {check.title} {check.value:.4g} {check.unit} (limit {check.relation} {check.limit:.4g})"
        for checks in deployment.checks
        for check in checks.checks
        if check.passed is False and check.limit is not None
    )


__all__ = ["Deployment", "box_check", "deploy", "fastest_allowed", "unmet", "whole_samples"]
