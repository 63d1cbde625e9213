"""A controller scheduled over speed made ready to run at a sample rate, and verified at frozen speeds over its range.

Every grid point is sampled by itself, in states common to all, and the code takes the sampled matrices linearly between the
points. That is not the sampled form of the continuous interpolation: Tustin's map bends, which leaves the two apart by second
order in the grid's spacing. ``deviation`` says by how much, and the loop is verified as the code runs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, check_positive, invalid
from ambrose.core.realisation.modal_form import modal_form
from ambrose.core.sampling import Method, c2d, delayed
from ambrose.core.scheduled import ScheduledSystem, interval_points
from ambrose.core.statespace import StateSpace, as_statespace
from ambrose.deployment.discretisation.fixed import (
    Progress,
    box_check,
    check_rate,
    instability,
    refusal,
    status_problems,
    whole_samples,
)
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import named_controller
from ambrose.plant.model import Plant
from ambrose.synthesis.certificate import match_controller
from ambrose.verification import nominal
from ambrose.verification.checks import Checks

BETWEEN = 1  # speeds in every interval of the grid at which the loop is verified
_TINY = 2.0**-150  # weight of the states among the outputs, from which the transform is read
_RESIDUAL = 1e-8
_FREQUENCIES = 200


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledDeployment:
    """A scheduled controller as it will run.

    sampled: at the grid of speeds, in common states, without the computing delay, clamped at the ends; increments (k, n, n):
    A - I with all its digits; sizes: blocks of the states at the middle of the grid; delay [samples]; source: what it was made
    from; deviation [-]: largest distance, half-way between grid points, from the sampled continuous interpolation, relative
    to its gain at the same frequency, found at the speed deviation_at. speeds (s,), checks: the verification over the range;
    points: at the machine's own operating points in the range; outside: the others, where the code clamps; box: over the
    tolerances at the slowest, a middle and the fastest speed; problems: what speaks against deploying it, one sentence each.
    """

    sampled: ScheduledSystem
    increments: np.ndarray
    sizes: tuple[int, ...]
    delay: int
    method: str
    source: ScheduledSystem
    deviation: float
    deviation_at: float
    speeds: np.ndarray
    checks: tuple[Checks, ...]
    points: tuple[Checks, ...]
    outside: tuple[Checks, ...]
    box: tuple[Checks, ...]
    problems: tuple[str, ...]

    @property
    def verified(self) -> bool:
        """Whether the source was verified and the sampled loop is stable wherever it has to be."""
        return not self.problems

    def in_loop(self, speed: float) -> StateSpace:
        """The controller at a frozen speed [rad/s], with its computing delay."""
        return delayed(self.sampled.at(speed), self.delay)


def deploy_scheduled(
    controller: Any,
    sample_time: float,
    delay: float = 0.0,
    *,
    method: Method = "tustin",
    prewarp: float | None = None,
    machine: Machine | None = None,
    between: int = BETWEEN,
    force: bool = False,
    progress: Progress = lambda stage: None,
) -> ScheduledDeployment:
    """A scheduled ``controller`` sampled at sample_time [s] and verified with the computing delay [s] in the loop.

    controller: a Synthesis with a schedule, or a ScheduledSystem over the speed in rad/s. method, prewarp
    [rad/s]: as in ``deploy``. machine: its full plant is closed at every grid point and ``between`` speeds in every interval,
    with the pressures and bias of its first operating point in the range (else its first), at its own operating points, and
    over its tolerances. Refused unless ``force``, as ``deploy`` does; operating points outside the range are examined with the
    clamped controller and do not refuse. Motion of the speed is not examined. Raises InvalidInput and UnstableSystem.
    """
    check_positive(sample_time, "the sample time", "give it in seconds")
    source = _schedule_of(controller)
    count = whole_samples(delay, sample_time)
    problems = status_problems(getattr(controller, "status", None), examined=machine is not None)
    problems += _unstable_itself(source, between)
    if problems and not force:
        raise UnstableSystem(refusal(problems))
    progress("sampling at every grid point")
    common, sizes = common_states(source)
    sampled, increments = _sampled(common, sample_time, method, prewarp)
    deviation, where = _deviation(common, sampled, sample_time, method, prewarp)
    speeds = interval_points(source.grid, between)
    result = ScheduledDeployment(
        sampled, increments, sizes, count, method, source, deviation, where, speeds, (), (), (), (), tuple(problems)
    )  # fmt: skip
    if machine is None:
        problems.append("its sampled loop was not examined: no machine was given")
    else:
        result = _verified(result, machine, progress)
        problems += _loop_problems(result)
    if problems and not force:
        raise UnstableSystem(refusal(problems))
    return replace(result, problems=tuple(problems))


def _schedule_of(controller: Any) -> ScheduledSystem:
    source = getattr(controller, "scheduled", controller)
    if not isinstance(source, ScheduledSystem):
        raise InvalidInput("the controller has no schedule; deploy() takes a fixed one")
    if (source.parameter, source.unit) != ("speed", "rad/s"):
        found = f"{source.parameter} [{source.unit}]"
        raise invalid("the scheduling parameter", found, "speed [rad/s]", "generated code is scheduled over the speed only")
    return replace(source, outside="clamp")


def _unstable_itself(source: ScheduledSystem, between: int) -> list[str]:
    for speed in interval_points(source.grid, between):
        found = instability(source.at(float(speed)), f" at {speed:.4g} rad/s")
        if found:
            return found
    return []


def common_states(source: ScheduledSystem) -> tuple[ScheduledSystem, tuple[int, ...]]:
    """The schedule in the modal states of its middle grid point, the same at every point, and the sizes of their blocks.

    Where the transform is too ill-conditioned to give the other points back to 1e-8, the states stay as they are.
    """
    n = source.n_states
    middle = source.systems[len(source.systems) // 2]
    if n == 0:
        return source, ()
    seen = StateSpace(
        middle.A, middle.B, np.vstack([middle.C, _TINY * np.eye(n)]), np.zeros((len(middle.C) + n, len(source.inputs)))
    )
    if middle.dt is not None:
        seen = StateSpace(seen.A, seen.B, seen.C, seen.D, dt=middle.dt)
    form = modal_form(seen)
    X = form.system.C[len(middle.C) :] / _TINY
    inverse = np.linalg.inv(X)
    moved = [StateSpace(inverse @ s.A @ X, inverse @ s.B, s.C @ X, s.D, s.inputs, s.outputs, s.dt) for s in source.systems]
    back = max(
        np.abs(X @ new.A @ inverse - old.A).max() / max(np.abs(old.A).max(), 1e-300)
        for new, old in zip(moved, source.systems, strict=True)
    )
    if not back <= _RESIDUAL:
        return source, (1,) * n
    return replace(source, systems=tuple(moved)), form.sizes


def _sampled(
    source: ScheduledSystem, dt: float, method: Method, prewarp: float | None
) -> tuple[ScheduledSystem, np.ndarray]:  # fmt: skip
    """The sampled schedule and A - I (k, n, n) at its points, with the digits that 1 - 1e-7 would lose."""
    n = source.n_states
    eye = np.eye(n)
    if source.dt is not None:
        if abs(source.dt - dt) > 1e-9 * dt:
            raise invalid("the sample time", f"{dt:g} s", f"the controller's {source.dt:g} s", "it is sampled already")
        return source, np.array([s.A - eye for s in source.systems])
    systems, increments = [], []
    for K in source.systems:
        check_rate(K, dt)
        found = c2d(K, dt, method, prewarp=prewarp)
        step = K.A @ c2d(StateSpace(K.A, eye, eye, np.zeros((n, n))), dt, method, prewarp=prewarp).B if n else np.zeros((0, 0))
        increments.append(step)
        systems.append(StateSpace(eye + step, found.B, found.C, found.D, K.inputs, K.outputs, dt))
    return replace(source, systems=tuple(systems)), np.array(increments).reshape(len(systems), n, n)


def _deviation(
    source: ScheduledSystem, sampled: ScheduledSystem, dt: float, method: Method, prewarp: float | None
) -> tuple[float, float]:  # fmt: skip
    """The largest distance, and its speed [rad/s], between the two ways to be half-way between grid points."""
    if source.dt is not None:
        return 0.0, float(source.grid[0])
    omega = np.geomspace(1e-5, 0.98, _FREQUENCIES) * np.pi / dt
    found = []
    for speed in (source.grid[1:] + source.grid[:-1]) / 2:
        meant = response(c2d(source.at(float(speed)), dt, method, prewarp=prewarp), omega)
        size = np.linalg.norm(meant, 2, axis=(1, 2))
        apart = np.linalg.norm(response(sampled.at(float(speed)), omega) - meant, 2, axis=(1, 2))
        found.append((float((apart / np.maximum(size, np.finfo(float).tiny)).max()), float(speed)))
    return max(found)


def response(system: StateSpace, omega: np.ndarray) -> np.ndarray:
    """The frequency response (w, p, m) of a sampled system at omega (w,) [rad/s]."""
    z = np.exp(1j * omega * float(system.dt or 1.0))
    if not system.n_states:
        return np.broadcast_to(system.D, (len(omega), *system.D.shape)).astype(complex)
    inner = z[:, None, None] * np.eye(system.n_states) - system.A
    return system.C @ np.linalg.solve(inner, np.broadcast_to(system.B, (len(omega), *system.B.shape))) + system.D


def _verified(deployment: ScheduledDeployment, machine: Machine, progress: Progress) -> ScheduledDeployment:
    low, high = deployment.sampled.range
    own = machine.operation.points
    inside = [point for point in own if low <= point.speed <= high]
    start = (inside or list(own))[0]

    def check(point: OperatingPoint) -> Checks:
        progress(f"verifying the sampled loop at {point.label}")
        plant = assemble(machine, point)
        return nominal.check(plant, named_controller(plant, _late(deployment, plant)))

    swept = [replace(start, speed=float(v), label=f"{v:.6g} rad/s") for v in deployment.speeds]
    boxes = []
    if machine.tolerances:
        inner = start.speed if low < start.speed < high else float(deployment.source.grid[len(deployment.source.grid) // 2])
        for speed in sorted({low, inner, high}):
            progress(f"verifying the sampled loop over the tolerances at {speed:.4g} rad/s")
            plant = assemble(machine, replace(start, speed=speed))
            boxes.append(replace(box_check(plant, _late(deployment, plant)), label=f"over the tolerances at {speed:.6g} rad/s"))
    return replace(
        deployment,
        checks=tuple(check(point) for point in swept),
        points=tuple(check(point) for point in inside),
        outside=tuple(check(point) for point in own if point not in inside),
        box=tuple(boxes),
    )


def _late(deployment: ScheduledDeployment, plant: Plant) -> StateSpace:
    return as_statespace(match_controller(deployment.in_loop(plant.point.speed), plant))


def _loop_problems(deployment: ScheduledDeployment) -> list[str]:
    unstable = [c.label for c in (*deployment.checks, *deployment.points) if not c.stable]
    found = [f"the sampled loop is unstable at {', '.join(unstable)}"] if unstable else []
    for box in deployment.box:
        count = box.checks[0]
        if count.passed is False:
            found.append(f"the sampled loop is unstable {box.label} at {count.value:.0f} points ({count.detail})")
    return found


def unmet_over_range(deployment: ScheduledDeployment) -> tuple[str, ...]:
    """Checks whose limits the stable sampled loop misses, each once, at the speed where it is worst; they warn."""
    worst: dict[str, tuple[float, str, int]] = {}
    for checks in (*deployment.checks, *deployment.points):
        for check in checks.checks:
            if check.passed is not False or check.limit is None:
                continue
            over = check.limit - check.value if check.relation == ">=" else check.value - check.limit
            text = f"{checks.label}: {check.title} {check.value:.4g} {check.unit} (limit {check.relation} {check.limit:.4g})"
            before = worst.get(check.name, (-np.inf, "", 0))
            worst[check.name] = (over, text, before[2] + 1) if over > before[0] else (before[0], before[1], before[2] + 1)
    return tuple(f"{text}, worst of {count}" for _, text, count in worst.values())


def sensitivity_peak(checks: Sequence[Checks]) -> tuple[float, str]:
    """The largest output sensitivity [-] among stable verifications, and where."""
    found = [(c["sensitivity.output.max"].value, c.label) for c in checks if c.stable]
    return max(found, default=(np.inf, "no point"))


__all__ = ["BETWEEN", "ScheduledDeployment", "deploy_scheduled", "response", "sensitivity_peak", "unmet_over_range"]
