"""Robust verification of one closed loop: what holds for every value of the uncertain parameters
within their tolerances.

| check | what | how |
|---|---|---|
| robust.stability.box | corners and samples of the box at which the loop is unstable | counted |
| robust.stability.margin | smallest factor on all tolerances that destabilises | found by search |
| robust.stability.proved | factor on all tolerances up to which it is stable (mu) | proved |
| robust.sensitivity.worst | largest singular value of S_o over the box | found by search |
| robust.sensitivity.bound | upper bound of the same (mixed mu) | proved, or grid |
| robust.sensitivity.input | largest singular value of S_i over the box | found by search |
| robust.sensitivity.at... | one parameter only: S_o at five of its values | found by search |
| robust.performance | mixed mu of the weighted loop: below 1 the weights are met | on a grid |

"Proved" is at all frequencies, on the model that the detail names; where the proof of the bound
fails it is evaluated on a frequency grid, and its title says so. A proof that fails for numerical
reasons is reported as "not proved" and why.

Curves: "robust.sensitivity" and "robust.sensitivity.input" (families over delta), "robust.mu". Give
it the full plant: searches and proofs work on the response at the ports of the parameters, and cost
little more for hundreds of states.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid, named_failure
from ambrose.core.frequency import evaluate, schur_form
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.mu.all_frequencies import chords
from ambrose.core.mu.bounds import mu_peak
from ambrose.core.statespace import StateSpace, is_stable, select, spectral_abscissa
from ambrose.core.worst_case import (
    FAILURES,
    BoxGain,
    gain_bound,
    peak_at,
    proved_gain,
    proved_margin,
    worst_gain,
    worst_gain_beside,
)
from ambrose.core.worst_case_loop import (
    BoxLoop,
    BoxMargin,
    box_loop,
    box_margin,
    corners,
    default_grid,
    envelope,
    gains,
    samples,
    unstable_poles,
)
from ambrose.judge.checks import Check, Checks, Curve, information, judge, required_line
from ambrose.judge.loop_response import half_order_share, solid_cores
from ambrose.law.design_problem import Weights, design_plant, unit_problem, with_performance_block
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import match_axes, match_controller
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.description import OperatingPoint, Requirements, Tolerance
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import in_tolerances, perturbed

# values of delta at which the curves over one tolerance are drawn
FAMILY = (-1.0, -0.5, 0.0, 0.5, 1.0)
# between what is found and what is proved, above which the search looks again where the proof ends
_APART = 0.01
_LOWEST, _HIGHEST = 0.1 * TWO_PI, 5e3 * TWO_PI  # rad/s, of the curves
_BOUND_POINTS = 60  # frequencies of the proved curve, beside those near the peak; assumed

Progress = Callable[[str, float], None]
CoreShare = Callable[[BoxLoop, BoxGain], tuple[float, str]]


@named_failure("the checks over the tolerances")
def check(
    plant: Plant | GeneralizedPlant,
    controller: LawLike,
    tolerances: Sequence[Tolerance] | None = None,
    weights: Weights | None = None,
    *,
    requirements: Requirements | None = None,
    omega: ArrayLike | None = None,
    informed: bool = True,
    progress: Progress | None = None,
) -> Checks:
    """The verdict on ``controller`` (err -> u, continuous) over the whole box of tolerances.

    plant: full or reduced, or a GeneralizedPlant with u_<axis>, y_<axis> and real blocks;
    tolerances: default the machine's. weights: with them robust performance is evaluated too.
    requirements: default the machine's; sensitivity_peak is the limit of the worst case. omega (w,)
    [rad/s]: grid of the curves (default 0.1 Hz to 5 kHz, dense around resonances). informed: by how
    much the tolerances might grow with stability proved, which a proved bound of the sensitivity
    proves for themselves, the input's sensitivity, and the curves. progress(stage, fraction) is
    called between stages. An unstable nominal loop yields stable=False. Raises
    InvalidInput: sampled controllers, wrong sizes, no tolerances.
    """
    tell = progress or (lambda stage, fraction: None)
    machine = plant.machine if isinstance(plant, Plant) else None
    if requirements is None:
        requirements = machine.requirements if machine is not None else Requirements()
    unit = unit_problem(plant, tolerances)
    controller = _matched(controller, plant, unit)
    if controller.dt is not None:
        remedy = (
            "give the continuous controller it was made from; nominal.check takes the sampled one"
        )
        raise invalid("the controller", repr(controller), "continuous", remedy)
    tell("closed loop", 0.0)
    label = _label(plant)
    closed = lft(unit, controller)
    if not is_stable(closed):
        abscissa = spectral_abscissa(closed)
        found = judge(
            "stability.abscissa",
            "Spectral abscissa",
            abscissa,
            "rad/s",
            Demand(0.0, "<", ""),
            "nominal parameters",
        )
        return Checks(
            label,
            False,
            (found,),
            (),
            ("Nothing about robustness was evaluated: the nominal loop is unstable.",),
        )
    output, input_ = _sensitivity_loops(closed, unit)
    grid = _grid(output, omega)
    checks = _stability(output, label, tell, informed)
    notes = []
    box_holds = all(check.passed is not False for check in checks)
    tell("sensitivity over the box", 0.4)
    share = _core_share(plant, controller, tolerances)
    sensitivity_checks, curves, worst = _sensitivity(
        output, input_ if informed else None, grid, requirements, box_holds, share
    )
    checks += sensitivity_checks
    if not box_holds:
        notes.append(
            "The loop is unstable somewhere in the box: the worst-case gains are infinite."
        )
    if weights is not None:
        tell("robust performance", 0.7)
        found, more_curves = _performance(
            design_plant(plant, weights, tolerances), controller, grid
        )
        checks.append(found)
        curves += more_curves
    tell("done", 1.0)
    return Checks(label, True, tuple(checks), tuple(curves), tuple(notes), _points(output, worst))


def examine(
    plant: Plant, controller: LawLike, tolerances: Sequence[Tolerance] | None = None
) -> Checks:
    """Stability and the worst output sensitivity over the box by search alone: no bound, no proof,
    no curves.

    Arguments, verdict on an unstable nominal loop and errors as for ``check``.
    """
    unit = unit_problem(plant, tolerances)
    closed = lft(unit, _matched(controller, plant, unit))
    if not is_stable(closed):
        return check(plant, controller, tolerances)
    output, _ = _sensitivity_loops(closed, unit)
    counted, unstable = _corner_check(output)
    margin = _margin_check(output, box_margin(output, also=unstable if len(unstable) else None))
    worst = worst_gain(output) if counted.passed and margin.passed else None
    share = _core_share(plant, controller, tolerances)
    checks = (counted, margin, _worst_check(output, worst, plant.machine.requirements, share))
    return Checks(_label(plant), True, checks, (), (), _points(output, worst))


def _core_share(
    plant: Plant | GeneralizedPlant,
    controller: LawLike,
    tolerances: Sequence[Tolerance] | None,
) -> CoreShare:
    """``half_order_share`` at the point of the box where a gain was found."""

    def share(loop: BoxLoop, found: BoxGain) -> tuple[float, str]:
        if not solid_cores(plant):
            return 1.0, ""
        (at,) = _points(loop, found)
        return half_order_share(perturbed(cast(Plant, plant), at, tolerances), controller)

    return share


def _points(loop: BoxLoop, worst: BoxGain | None) -> tuple[dict[str, float], ...]:
    """Where a search found the worst gain, by parameter; none where the box does not hold."""
    if worst is None:
        return ()
    return (
        {block.name: float(value) for block, value in zip(loop.blocks, worst.delta, strict=True)},
    )


@named_failure("the stability margin over the tolerances")
def stability(
    plant: Plant | GeneralizedPlant,
    controller: LawLike,
    tolerances: Sequence[Tolerance] | None = None,
) -> Check:
    """How many corners and samples of the whole box are unstable: the quick verdict where
    parameters are many.

    Arguments as for ``check``. Raises InvalidInput, and UnstableSystem for a loop that is unstable
    at its centre.
    """
    output, _, _ = box_loops(plant, controller, tolerances)
    corner_check = _corner_check(output)[0]
    names = f"all {output.parameters} tolerances"
    return replace(corner_check, name="robust.stability.all", title=f"Unstable points over {names}")


def _label(plant: Plant | GeneralizedPlant) -> str:
    if not isinstance(plant, Plant):
        return f"{plant.system.n_states} states"
    point = plant.point.label or f"{plant.point.speed / TWO_PI:.4g} Hz"
    size = "full model" if plant.bending_modes is None else f"{plant.bending_modes} bending modes"
    return f"{point}, {size}"


def _matched(
    controller: LawLike, plant: Plant | GeneralizedPlant, unit: GeneralizedPlant
) -> StateSpace:
    """The controller with its signals in the order of the axes of the plant."""
    if isinstance(plant, Plant):
        return match_controller(controller, plant)
    return match_axes(
        law_of(controller).at(OperatingPoint()), [name.removeprefix("u_") for name in unit.u]
    )


def box_loops(
    plant: Plant | GeneralizedPlant,
    controller: LawLike,
    tolerances: Sequence[Tolerance] | None = None,
) -> tuple[BoxLoop, BoxLoop, BoxLoop]:
    """S_o, S_i [-] and K S_o [A/m] (up to sign) of a loop with its real parameters pulled out, for
    ``core.box`` and its search.

    plant, tolerances: as for ``check``. Raises InvalidInput, UnstableSystem.
    """
    unit = unit_problem(plant, tolerances)
    closed = lft(unit, _matched(controller, plant, unit))
    n_w = unit.n_w_blocks
    n_z = unit.n_z_blocks
    a = len(unit.u)
    w, z = list(unit.w), list(unit.z)

    # (w_delta, w2) -> (z_delta, z2 = u)
    control = select(closed, w[:n_w] + w[n_w + a :], z[:n_z] + z[n_z + a :])
    return (*_sensitivity_loops(closed, unit), box_loop(control, unit.blocks))


def _sensitivity_loops(closed: StateSpace, unit: GeneralizedPlant) -> tuple[BoxLoop, BoxLoop]:
    """(w_delta, w2) -> (z_delta, -S_o w2), and (w_delta, w1) -> (z_delta, S_i w1): v = u + w1."""
    n_w = unit.n_w_blocks
    n_z = unit.n_z_blocks
    a = len(unit.u)
    model = chords(closed)  # of both, once

    def part(inputs: np.ndarray, outputs: np.ndarray, direct: float) -> BoxLoop:
        system = model.part(outputs, inputs)
        system.D[n_z:, n_w:] += direct * np.eye(a)
        names = [unit.w[i] for i in inputs], [unit.z[i] for i in outputs]
        return box_loop(
            StateSpace(closed.A, closed.B[:, inputs], closed.C[outputs], system.D, *names),
            unit.blocks,
            system,
        )

    # w = (w_delta, w1, w2), z = (z_delta, z1 = err, z2 = u); the direct 1 makes v of u
    output = part(np.r_[:n_w, n_w + a : len(unit.w)], np.arange(n_z + a), 0.0)
    return output, part(np.arange(n_w + a), np.r_[:n_z, n_z + a : len(unit.z)], 1.0)


def _grid(loop: BoxLoop, omega: ArrayLike | None) -> np.ndarray:
    if omega is None:
        grid = default_grid(loop, 100)
        return grid[(grid >= _LOWEST) & (grid <= _HIGHEST)]
    grid = check_shape(omega, "omega", "(w)").astype(float)
    if len(grid) < 3 or grid[0] <= 0 or not (np.diff(grid) > 0).all():
        raise invalid(
            "omega",
            f"{len(grid)} values",
            "three or more, ascending and positive, in rad/s",
            "sort them",
        )
    return grid


def _named(loop: BoxLoop, delta: np.ndarray) -> str:
    """delta (k,) in words: "seal.center.k +1 (in tolerances)"."""
    return in_tolerances(dict(zip((block.name for block in loop.blocks), delta, strict=True)))


def _stability(loop: BoxLoop, label: str, tell: Progress, informed: bool) -> list[Check]:
    tell("stability over the box", 0.1)
    counted, unstable = _corner_check(loop)
    tell("stability margin", 0.2)
    margin = box_margin(loop, also=unstable if len(unstable) else None)
    checks = [counted, _margin_check(loop, margin)]
    if informed:
        tell("proof of stability", 0.3)
        checks.append(_proof_check(loop, margin, label))
    return checks


def _proof_check(loop: BoxLoop, margin: BoxMargin, label: str) -> Check:
    proved = proved_margin(loop, margin.factor)
    verdict = (
        "every point within the tolerances is stable"
        if proved.value >= 1
        else "not proved for the whole tolerances"
    )
    detail = f"not proved: {proved.why}" if proved.why else f"{verdict}; mixed mu"
    title = "Tolerances times this are stable, proved at all frequencies"
    model = f"on the model of {loop.system.n_states} states ({label})"
    return information(
        "robust.stability.proved", title, proved.value, "-", f"{detail}; {model}", ">="
    )


def _corner_check(loop: BoxLoop) -> tuple[Check, np.ndarray]:
    """The count, and the unstable points (c, k)."""
    points = np.vstack([corners(loop.parameters), samples(loop.parameters)])
    unstable = unstable_poles(loop, points) > 0
    where = f"; for one, {_named(loop, points[np.argmax(unstable)])}" if unstable.any() else ""
    unstable_check = judge(
        "robust.stability.box",
        "Unstable points of the tolerance box, counted",
        int(unstable.sum()),
        "-",
        Demand(0.0, "<=", "every tolerance"),
        f"{len(points)} corners and samples{where}",
    )
    return unstable_check, points[unstable]


def _margin_check(loop: BoxLoop, margin: BoxMargin) -> Check:
    detail = "no destabilising perturbation found up to 20 times the tolerances"
    if np.isfinite(margin.factor):
        detail = f"unstable at {_named(loop, margin.delta)}, {margin.frequency / TWO_PI:.4g} Hz"
    title = "Smallest destabilising factor on the tolerances, found by search"
    return judge(
        "robust.stability.margin",
        title,
        margin.factor,
        "-",
        Demand(1.0, ">=", "every tolerance"),
        detail,
    )


def _sensitivity(
    output: BoxLoop,
    input_: BoxLoop | None,
    grid: np.ndarray,
    requirements: Requirements,
    box_holds: bool,
    share: CoreShare,
) -> tuple[list[Check], list[Curve], BoxGain | None]:
    members = _members(output)
    stable = np.ones(len(members), bool) if box_holds else unstable_poles(output, members) == 0
    worst, bound = _worst_and_bound(output, grid) if box_holds else (None, None)
    checks = [_worst_check(output, worst, requirements, share)]
    if worst is not None and bound is not None:
        factor, words = share(output, worst)
        checks.append(replace(bound, value=factor * bound.value, detail=bound.detail + words))
    if worst is not None and input_ is not None:
        drive = worst_gain(input_)
        detail = f"{_named(input_, drive.delta)}, {drive.frequency / TWO_PI:.4g} Hz"
        title = "Worst-case input sensitivity over the box, found by search"
        factor, words = share(input_, drive)
        value, detail = factor * drive.value, detail + words
        checks.append(information("robust.sensitivity.input", title, value, "-", detail))
    if output.parameters == 1:
        checks += [
            information(
                f"robust.sensitivity.at{d:+g}",
                f"Output sensitivity at {_named(output, np.array([d]))}",
                v,
                "-",
                where,
            )
            for d, (v, where) in zip(FAMILY, _at_family(output, stable), strict=True)
        ]
    curves = [
        _family(loop, grid, stable, worst, f"robust.sensitivity{suffix}", title, limits)
        for loop, suffix, title, limits in (
            (
                output,
                "",
                "Output sensitivity over the tolerances",
                required_line(requirements.sensitivity_peak),
            ),
            (input_, ".input", "Input sensitivity over the tolerances", ()),
        )
        if loop is not None and input_ is not None
    ]
    return checks, curves, worst


def _worst_check(
    loop: BoxLoop, worst: BoxGain | None, requirements: Requirements, share: CoreShare
) -> Check:
    rule = demand("maximum singular value of a sensitivity", requirements)
    value, detail = np.inf, "the loop is unstable in the box"
    if worst is not None:
        factor, words = share(loop, worst)
        value, detail = (
            factor * worst.value,
            f"{_named(loop, worst.delta)}, {worst.frequency / TWO_PI:.4g} Hz{words}",
        )
    title = "Worst-case output sensitivity over the box, found by search"
    return judge("robust.sensitivity.worst", title, value, "-", rule, detail)


def _members(loop: BoxLoop) -> np.ndarray:
    """The points of the box (d, k) that the curves show: FAMILY for one parameter, the corners for
    several.
    """
    return np.array(FAMILY)[:, None] if loop.parameters == 1 else corners(loop.parameters)


def _at_family(loop: BoxLoop, stable: np.ndarray) -> list[tuple[float, str]]:
    """Peak gain of a loop with one parameter at every delta of FAMILY, and where it is; infinite
    where it is unstable.
    """
    grid, points = default_grid(loop), _members(loop)
    result = []
    for point, row, holds in zip(points, gains(loop.at(grid), loop, points), stable, strict=True):
        i = int(np.clip(row.argmax(), 1, len(grid) - 2))
        at, value = peak_at(loop, point, grid[i - 1], grid[i], grid[i + 1])
        result.append(
            (max(value, float(row.max())), f"{at / TWO_PI:.4g} Hz")
            if holds
            else (np.inf, "unstable")
        )
    return result


def _worst_and_bound(loop: BoxLoop, grid: np.ndarray) -> tuple[BoxGain, Check]:
    """The largest gain found, and the bound of it: proved at all frequencies, or where that fails
    on a net of frequencies.
    """
    worst = worst_gain(loop)
    near = worst.frequency * np.linspace(0.98, 1.02, 5)
    bound = proved_gain(loop, worst.value, near)
    # search where the proof says it may be
    if np.isfinite(bound.value) and bound.value > (1 + _APART) * worst.value:
        refined = worst_gain_beside(loop, bound.frequency)
        if refined.value > worst.value:
            worst = refined
    how = "proved at all frequencies"
    value = bound.value
    reason = ""
    if bound.why:
        net = np.unique(np.concatenate([grid[:: max(1, len(grid) // _BOUND_POINTS)], near]))
        how, reason = "on a frequency grid", f"; not proved: {bound.why}"
        try:
            value = gain_bound(loop, net, worst.value)
        except FAILURES as error:
            how, reason = "not available", f": {error}"
    detail = (
        f"{value / worst.value - 1:.2%} above what was found"
        if np.isfinite(value)
        else "it does not exclude instability"
    )
    title = f"Upper bound of the worst-case output sensitivity, {how}"
    return worst, information("robust.sensitivity.bound", title, value, "-", detail + reason)


def _family(
    loop: BoxLoop,
    grid: np.ndarray,
    stable: np.ndarray,
    worst: BoxGain | None,
    name: str,
    title: str,
    limits: tuple[tuple[str, float], ...],
) -> Curve:
    """Largest singular value against frequency: over delta for one parameter; else nominal, worst
    and the corners' envelope.

    Rows of unstable loops are left out.
    """
    M, points = loop.at(grid), _members(loop)
    if loop.parameters == 1:
        labels = tuple(
            f"{loop.blocks[0].name} {d:+g}"
            for d, holds in zip(FAMILY, stable, strict=True)
            if holds
        )
        rows = [gains(M, loop, points[stable])]
    else:
        rows = [gains(M, loop, np.zeros((1, loop.parameters)))]
        labels = ("nominal",)
        if stable.any():
            rows.append(envelope(M, loop, points[stable])[None])
            labels += ("largest of the stable corners",)
        if worst is not None:
            rows.append(gains(M, loop, worst.delta[None]))
            labels += ("worst case",)
    return Curve(name, title, "frequency", grid, np.vstack(rows), labels, "rad/s", "-", limits)


def _performance(
    problem: GeneralizedPlant, controller: StateSpace, grid: np.ndarray
) -> tuple[Check, list[Curve]]:
    title = "Mixed mu of the weighted loop, on a frequency grid"
    whole = with_performance_block(problem)
    closed = lft(whole, controller)
    form = schur_form(closed.A, closed.B, closed.C, closed.D, expand=True)
    start = grid[:: max(1, len(grid) // 120)]
    try:
        peak = mu_peak(
            lambda omega: evaluate(form, 1j * omega),
            whole.blocks,
            start,
            tolerance=1e-3,
            max_points=600,
        )
    except FAILURES as error:
        return information(
            "robust.performance", title, float("inf"), "-", f"not available: {error}"
        ), []
    holds = (
        "performance is met over the whole box"
        if peak.upper < 1
        else f"it holds for {1 / peak.upper:.3g} of box and weights"
    )
    detail = f"lower bound {peak.lower:.3g}, {peak.frequency / TWO_PI:.4g} Hz; {holds}"
    curve = Curve(
        "robust.mu",
        "Structured singular value of the weighted loop",
        "frequency",
        peak.omega,
        peak.values[None],
        ("upper bound",),
        "rad/s",
        "-",
        (("robust performance", 1.0),),
    )
    return information("robust.performance", title, peak.upper, "-", detail), [curve]
