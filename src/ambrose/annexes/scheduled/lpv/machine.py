"""LPV control of a machine over its speed, its seal pressure or both: the family of design
problems, the synthesis, the full plant at every point of the schedule.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ambrose.annexes.scheduled.lpv.synthesis import PlantAt, lpv_synthesis
from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant, design_grid, lft
from ambrose.core.scheduled import ScheduledSystem, check_axes, corners as around, grid_points
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.core.worst_case_loop import box_loop, corners, default_grid, gains
from ambrose.judge.result import CERTIFYING, Synthesis, certify_on_full_plant
from ambrose.law.design_problem import (
    Weights,
    apply_delay,
    design_plant,
    design_tolerances,
    machine_weights,
    open_model,
    scale_control,
    unit_problem,
    with_performance_block,
)
from ambrose.law.law import SPEED, Scheduling
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import free_mode_reduction

# LPV control with the tolerances inside: turns of a scheduled synthesis and a constant scaling D
# for every grid point.
#
# Uncertain parameters delta within -1 .. 1 stand in the plants as blocks, w = delta z. Whatever
# they do in time, and whichever D belongs to the value that the scheduling parameter has at that
# instant, z^T D^2 z - w^T D^2 w >= 0. An LPV controller for the plants with D on z and D^-1 on w,
# of the gain gamma, therefore keeps its performance to gamma for all tolerances divided by gamma,
# however parameter and tolerances move (scaled bounded real lemma; Apkarian & Gahinet 1995, IEEE
# Trans. Automatic Control 40). K-step: that controller. D-step: at every grid point the constant D
# with the smallest peak of sigma_max(D M D^-1). The turns are judged by what is asked for:
# stability and output sensitivity at the corners of the tolerances themselves, of which D, blind to
# what is real and what stands still, knows nothing.


_TURNS = 3  # K-steps with one control weight; more were never better
_BACKOFF = 1.2  # nearer to the optimum the second pass of a scaled problem fails
_POWERS = (10.0, 30.0, 100.0)  # of the norm that stands for the peak over frequency
_PER_DECADE = 30  # frequencies at which corners are judged


@dataclass(frozen=True, slots=True, eq=False)
class Worst:
    """The largest output sensitivity found (inf: a member is unstable), and how many of how many
    members are unstable.

    No members: the loop is unstable without any deviation.
    """

    sensitivity: float
    unstable: int
    members: int


def tolerant_lpv(
    plants: Sequence[PlantAt],
    axes: tuple[np.ndarray, ...],
    synthesis: Callable[[PlantAt, float], Synthesis],
    judge: Callable[[ScheduledSystem], Worst],
    limit: float,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Synthesis, Worst, int, bool]:
    """The scheduled controller that ``judge`` finds best, the place of its plants, and whether D
    was in its problem.

    plants: the uncertain problem of a parameter's value with blocks, one function for each control
    weight to try, the most careful first; one follows the other until the judged sensitivity is at
    most ``limit``. synthesis: of plants without blocks, at a back-off. A turn that is unstable
    without any deviation is the last. Ctrl-C ends the turns: the best so far is returned,
    ``stopped_early`` says so. Raises NumericalFailure where no turn is stable without deviations.
    """
    best: tuple[Synthesis, Worst, int, bool] | None = None
    reason = ""
    try:
        for place, plant_at in enumerate(plants):
            problem = _Scaled(plant_at, axes)
            for turn in range(_TURNS):
                try:
                    result = synthesis(problem.plant, _BACKOFF)
                except NumericalFailure as failure:
                    reason = f"{failure}; narrow the tolerances"
                    say(f"turn {turn + 1} failed: {reason}")
                    break
                worst = judge(result.law)  # type: ignore[arg-type]
                if not worst.members:
                    reason = (
                        "it is unstable without any deviation on a model with more bending modes; "
                        "take more into the design"
                    )
                    raise _Lost
                say(
                    f"turn {turn + 1}: gamma {result.gamma:.3f}, {worst.unstable} of "
                    f"{worst.members} members of the tolerances "
                    f"unstable, sigma_max(S_o) {worst.sensitivity:.3f}"
                )
                if best is None or _order(worst) < _order(best[1]):
                    best = result, worst, place, turn > 0
                elif turn:
                    break
                problem.rescale(result.law)  # type: ignore[arg-type]
            if best is not None and best[1].sensitivity <= limit:
                break
    except _Lost:
        say(f"turn {turn + 1}: {reason}")
    except KeyboardInterrupt:
        if best is None:
            raise
        say(CERTIFYING)
        best = (replace(best[0], stopped_early="interrupted"), *best[1:])
    if best is None:
        raise NumericalFailure(f"no scheduled controller for these tolerances was found: {reason}")
    return best


class _Lost(Exception):
    """Further turns would only be faster, and worse."""


def _order(worst: Worst) -> tuple[int, float]:
    return worst.unstable, worst.sensitivity


class _Scaled:
    """The problems with D around them: log D at the grid's values, linear in between; at first that
    of the loop without any.
    """

    def __init__(self, plant_at: PlantAt, axes: tuple[np.ndarray, ...]) -> None:
        self._plant_at = plant_at
        self._axes, self._values = axes, grid_points(axes)
        self._kept: dict[Any, GeneralizedPlant] = {}
        first = self.uncertain(self._values[0])
        self._log_d = np.zeros((len(self._values), len(first.blocks)))
        self._nominal = True

    def uncertain(self, value: Any) -> GeneralizedPlant:
        if value not in self._kept:
            self._kept[value] = with_performance_block(self._plant_at(value))
        return self._kept[value]

    def plant(self, value: Any) -> GeneralizedPlant:
        """The scaled problem at a value of the parameter, without blocks; before the first D the
        performance alone.
        """
        plant = self.uncertain(value)
        if self._nominal:
            last = plant.blocks[-1]
            w, z = plant.w[-last.n_w :], plant.z[-last.n_z :]
            return GeneralizedPlant(
                select(plant.system, [*w, *plant.u], [*z, *plant.y]), w, plant.u, z, plant.y
            )

        # log D is linear between the grid's values; D_z on the rows of z, D_w^-1 on the columns
        # of w.
        index, share = around(self._axes, np.atleast_1d(value)[None])
        d = np.exp(share[0] @ self._log_d[index[0]])
        d_w, d_z = _spread(plant, d)
        s = plant.system
        q = len(plant.w)
        r = len(plant.z)
        B = s.B.copy()
        C = s.C.copy()
        D = s.D.copy()
        B[:, :q], D[:, :q] = B[:, :q] / d_w, D[:, :q] / d_w
        C[:r], D[:r] = C[:r] * d_z[:, None], D[:r] * d_z[:, None]
        return GeneralizedPlant(replace(s, B=B, C=C, D=D), plant.w, plant.u, plant.z, plant.y)

    def rescale(self, law: ScheduledSystem) -> None:
        """The D-step."""
        self._nominal = False
        for i, value in enumerate(self._values):
            plant = self.uncertain(value)
            M = frequency_response(lft(plant, law.at(value)), design_grid(plant)).values
            self._log_d[i] = constant_scaling(plant, M, self._log_d[i])


def _spread(plant: GeneralizedPlant, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d of the blocks on their signals w and z."""
    return tuple(np.repeat(d, [getattr(b, side) for b in plant.blocks]) for side in ("n_w", "n_z"))  # type: ignore[return-value]


def constant_scaling(plant: GeneralizedPlant, M: np.ndarray, log_d: np.ndarray) -> np.ndarray:
    """log d (blocks,), the last 0, with the smallest peak of sigma_max(D M D^-1) over M (w, n_z,
    n_w) that descent finds.
    """
    which = np.arange(len(plant.blocks), dtype=float)
    of_w, of_z = (side.astype(int) for side in _spread(plant, which))
    count = len(which)

    def cost(x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        # ln of the p-norm over frequency of sigma_1(D M D^-1), over its peak, for powers in range
        d = np.exp(np.append(x, 0.0))
        U, s, Vh = np.linalg.svd(M * d[of_z][:, None] / d[of_w])
        top = s[:, 0].max()
        share = (s[:, 0] / top) ** power
        total = share.sum()

        # d ln sigma_1 = sum |u_k|^2 d ln d_z,k - sum |v_k|^2 d ln d_w,k, added up by block
        left = (share / total) @ np.abs(U[:, :, 0]) ** 2
        right = (share / total) @ np.abs(Vh[:, 0]) ** 2
        slope = np.bincount(of_z, left, count) - np.bincount(of_w, right, count)
        return float(np.log(total) / power + np.log(top)), slope[:-1]

    # D matters up to a factor: the last is 1. Low powers first, for the peak alone is not smooth.
    x = log_d[:-1] - log_d[-1]
    for power in _POWERS:
        x = minimize(
            cost, x, args=(power,), jac=True, method="L-BFGS-B", options={"maxiter": 300}
        ).x
    return np.append(x, 0.0)


def worst_corners(units: Mapping[Any, GeneralizedPlant], law: ScheduledSystem) -> Worst:
    """The largest output sensitivity of the frozen loops at the corners of the tolerances (and at
    their middle).

    units: the open problem with all weights and scales 1 at each value that is looked at
    (``problem.unit_problem``).
    """
    worst = 0.0
    unstable = 0
    members = 0
    for value, unit in units.items():
        closed = lft(unit, law.at(value))
        if not is_stable(closed):
            return Worst(np.inf, 0, 0)
        a = len(unit.u)
        w = list(unit.w)
        z = list(unit.z)

        # After the blocks w1 (a) at u and w2 at y, z1 (a) = err and z2 = u: w2 -> z1 is -S_o.
        loop = box_loop(
            select(
                closed, w[: unit.n_w_blocks] + w[unit.n_w_blocks + a :], z[: unit.n_z_blocks + a]
            ),
            unit.blocks,
        )

        # delta at all corners; an unstable member is counted, and left out of the gains
        every = corners(loop.parameters)
        stable = np.array([_holds(loop.system, delta[loop.owner]) for delta in every])
        unstable, members = unstable + int((~stable).sum()), members + len(every)
        omega = default_grid(loop, _PER_DECADE)
        corner_gains = gains(
            loop.at(omega), loop, np.vstack([np.zeros(loop.parameters), every[stable]])
        )
        worst = max(worst, float(corner_gains.max()))
    return Worst(worst if not unstable else np.inf, unstable, members)


def _holds(system: StateSpace, delta: np.ndarray) -> bool:
    n = len(delta)

    # w = delta z, z = C x + D w:   x' = (A + B delta (I - D delta)^-1 C) x
    inner = np.linalg.solve(np.eye(n) - system.D[:n, :n] * delta, system.C[:n])
    return bool(np.linalg.eigvals(system.A + (system.B[:, :n] * delta) @ inner).real.max() < 0)


POINTS, POINTS_OF_TWO = 8, 3  # of a grid that is not given, along each of its parameters
_MACHINE_BACKOFF = 1.1  # gamma of the law over the least that exists, where none is stated
# factors of the control weight, tried until the tolerances are held
_CONTROL = (1.0, 0.7, 0.5, 0.35)
_MODES = 3  # bending modes per plane besides those of the design, on which corners are judged
_FAR = 20  # times the highest of the operating points
_PADE = 2  # order of the delay's approximation
_PEAK = 3.0  # where no sensitivity is required: border of zone A of ISO 14839-3


def schedule_grid(
    machine: Machine, point: OperatingPoint, along: Scheduling = SPEED, count: int = POINTS
) -> np.ndarray:
    """``count`` values (count,) of speed or pressure, evenly from the lowest to the highest of the
    machine's operating points.

    Points count that are those of ``point`` in everything else; over speed, only those that turn.
    Raises InvalidInput where they leave no range.
    """
    alike = [
        p
        for p in machine.operation.envelope
        if replace(along.moved(p, along.of(point)), label=point.label) == point
    ]
    values = sorted(
        {value for p in (*alike, point) if (value := along.of(p)) > 0 or along is not SPEED}
    )
    if len(values) < 2:
        other = "seal pressure" if along is SPEED else "speed"
        option = "--speeds-hz" if along is SPEED else "--pressures-bar"
        raise InvalidInput(
            f"machine {machine.name!r} has no range of {along.name}s at the {other} of "
            f"{point.label or 'this point'}; give the "
            f"{along.name}s ({option}), or add operating points at the lowest and the highest"
        )
    return np.linspace(values[0], values[-1], count)


def plants_along(
    plant: Plant,
    along: Scheduling = SPEED,
    bending_modes: int = 0,
    lag: float = 0.0,
    weights: Weights | None = None,
    tolerances: Sequence[Tolerance] | None = None,
) -> Callable[[Any], GeneralizedPlant]:
    """The design problem at a speed or pressure (or both), all else as at the plant's operating
    point, in common states.

    lag [s]: by which the currents act late. weights: None: the machine's; tolerances: None: none.
    """
    chosen, uncertain = weights or machine_weights(plant.machine), tolerances is not None

    def at(value: Any) -> GeneralizedPlant:
        small = free_mode_reduction(
            replace(plant, point=along.moved(plant.point, value)), bending_modes
        )
        return design_plant(
            apply_delay(open_model(small, tolerances, uncertain), lag), chosen, uncertain=uncertain
        )

    return at


def design_schedule(
    plant: Plant,
    grid: Sequence[Any] | np.ndarray | None = None,
    along: Scheduling = SPEED,
    *,
    bending_modes: int = 0,
    rate: float | tuple[float | None, ...] | None = None,
    lag: float = 0.0,
    tolerances: bool = False,
    backoff: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """A controller scheduled over speed, pressure or both for a full plant, verified on it at every
    point of its schedule.

    grid (k,) [rad/s] or [Pa], of both one for each: None: ``schedule_grid``; it holds the plant's
    own value in its range. rate [of its unit per s], of both one for each: the fastest change
    (None: any); bending_modes: per plane, lag [s]: of the currents, in the design model.
    tolerances: it is designed over the machine's, without the lag, with a control weight as small
    as the output sensitivity required at their corners, judged with the lag, needs
    (``tolerant_lpv``). backoff: how far above the smallest gamma it stays (None: 1.1, and 1.2 over
    tolerances). ``controller`` is the frozen form at the plant's own. margins gain those of
    ``certificate.full_plant_margins``; a controller that does not hold the full plant at every
    point has the status "unstable". Raises InvalidInput and NumericalFailure as ``lpv_synthesis``.
    """
    machine, point = plant.machine, plant.point
    weights = machine_weights(machine)
    if grid is None:
        grid = tuple(
            schedule_grid(machine, point, one, POINTS_OF_TWO if along.parts else POINTS)
            for one in along.each
        )
    axes, design_value = check_axes(grid, along.name), along.of(point)
    for one, axis in zip(along.each, axes, strict=True):
        value, (low, high) = one.of(point), axis[[0, -1]]
        if not low <= value <= high:
            remedy = f"widen the {one.name}s or assemble it within them"
            raise invalid(
                f"the plant's {one.name}",
                one.number(value),
                f"between {low:g} and {one.number(high)}",
                remedy,
            )
        usual = max(one.of(p) for p in machine.operation.envelope)
        if high > _FAR * usual > 0:
            remedy = (
                f"the machine's highest operating point has {one.number(usual)}; check the unit "
                "of the schedule"
            )
            raise invalid(
                f"the highest {one.name} of the schedule",
                one.number(high),
                f"at most {_FAR} times the machine's",
                remedy,
            )
    if along is not SPEED and not machine.seals:
        raise InvalidInput(
            f"machine {machine.name!r} has no seal, and nothing changes with the {along.name}; "
            "use another method"
        )
    say = progress or (lambda _: None)

    def scheduled(plants: PlantAt, usual: float = _MACHINE_BACKOFF) -> Synthesis:
        above = usual if backoff is None else backoff
        return lpv_synthesis(
            plants,
            axes,
            rate=rate,
            backoff=above,
            nominal=design_value,
            parameter=along.name,
            unit=along.unit,
            progress=say,
        )

    if tolerances:
        result = _over_tolerances(plant, axes, along, bending_modes, lag, say, scheduled)
    else:
        result = scheduled(plants_along(plant, along, bending_modes, lag))
        result = replace(result, weights=weights)
    return certify_on_full_plant(plant, result)


def _over_tolerances(
    plant: Plant,
    axes: tuple[np.ndarray, ...],
    along: Scheduling,
    modes: int,
    lag: float,
    say: Callable[[str], None],
    scheduled: Callable[[PlantAt, float], Synthesis],
) -> Synthesis:
    machine, weights = plant.machine, machine_weights(plant.machine)
    if not machine.tolerances:
        raise InvalidInput(
            f"machine {machine.name!r} has no tolerances; add [[tolerance]] tables, or design "
            "without them"
        )
    wide, points = design_tolerances(machine), grid_points(axes)
    judged = sorted({points[len(points) // 2], *grid_points([axis[[0, -1]] for axis in axes])})
    tried = [scale_control(weights, factor) for factor in _CONTROL]
    units = {}
    for value in judged:
        small = free_mode_reduction(
            replace(plant, point=along.moved(plant.point, value)), modes + _MODES
        )
        units[value] = unit_problem(
            apply_delay(open_model(small, machine.tolerances, True), lag, _PADE)
        )
    limit = machine.requirements.sensitivity_peak or _PEAK
    # the delay is judged, not designed for: with Pade's states the second pass of a scaled problem
    # needs 1.4 times the optimum
    plants = [plants_along(plant, along, modes, 0.0, item, wide) for item in tried]
    result, worst, place, scaled = tolerant_lpv(
        plants, axes, scheduled, partial(worst_corners, units), limit, say
    )
    where = f"{'; ' if along.parts else ', '}".join(along.words(value) for value in judged)
    factor = f", control weight times {_CONTROL[place]:g}" if place else ""
    what = (
        f"holds for {1 / result.gamma:.0%} of them, however they move"
        if scaled
        else "is without deviations: they were held all the same"
    )
    words = f"none is unstable and sigma_max(S_o) is at most {worst.sensitivity:.3f}"
    notes = (
        f"designed over {len(wide)} tolerances{factor}: gamma {result.gamma:.3g} {what}",
        f"of {worst.members} corners of all tolerances at {where}, "
        f"{f'{worst.unstable} are unstable' if worst.unstable else words} on the model with "
        f"{modes + _MODES} bending modes",
    )
    # D bends the scaled one
    kept = [note for note in result.notes if not note.startswith("for a plant that is linear")]
    margins = {
        **result.certificate.margins,
        "corner_sensitivity": worst.sensitivity,
        "corner_sensitivity_limit": limit,
    }
    margins["unstable_corners"] = float(worst.unstable)
    certificate = replace(result.certificate, margins=margins)
    return replace(result, weights=tried[place], certificate=certificate, notes=(*notes, *kept))
