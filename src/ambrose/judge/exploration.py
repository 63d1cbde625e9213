"""One controller over its whole range: poles over speed and pressure, a pulse and unbalance for
every member of the tolerances.

found = explore(machine, controller)
found.maps, found.pulses, found.unbalance
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import (
    InvalidInput,
    UnstableSystem,
    check_positive,
    check_shape,
    invalid,
    named_failure,
)
from ambrose.core.lft import GeneralizedPlant, lft, upper_lft
from ambrose.core.presentation import Presented
from ambrose.core.sampling import held
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.core.worst_case import gain_bound, worst_gain_at
from ambrose.core.worst_case_loop import BoxLoop, box_loop, box_points, gains
from ambrose.judge.campbell import damping_ratio
from ambrose.judge.checks import Curve
from ambrose.judge.plants import (
    Stability,
    campbell_map,
    chosen_point,
    judge_points,
    lost_as_assumed,
)
from ambrose.judge.robust import stability
from ambrose.law.law import SPEED, Law, LawAt, LawLike, law_of
from ambrose.law.loop import Timing, closed_loop, match_controller, running_law, timing_of
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, top_speed
from ambrose.model.static_load import Unbalance, residual_unbalance
from ambrose.model.uncertainty import default_bending_modes, reduce, tolerances_around, uncertain
from ambrose.options import PARTS, Exploring

# Poles of a closed loop while one thing changes: speed, pressure, or a parameter over its
# tolerance; where stability ends.
#
# Poles of a sampled loop are shown as those of the continuous one that it samples, log(z)/dt, and
# modes of the plant above half the sample rate at their true frequency (core/aliasing.py). At each
# value the plant is assembled anew. The ends of stability between two values are found by
# bisection; what comes and goes between them is not seen.


_DEEP = float(np.log(1e-12))  # ln|z| below which a pole is a delay, at no finite s
_BISECTIONS = 12  # a 4096th of the distance between two values

LoopAt = Callable[[float], tuple[StateSpace, StateSpace]]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoleMap(Presented):
    """over: what changes; unit: its SI unit; values (n,) ascending; poles: of each, with an
    imaginary part of zero or more, up to the highest frequency asked for [rad/s]; abscissa (n,)
    [rad/s]: the largest real part of all poles; damping (n,): the least damping ratio of the
    oscillating ones in the range; ends: (value, whether it is stable above).
    """

    over: str
    unit: str
    values: np.ndarray
    poles: tuple[np.ndarray, ...]
    abscissa: np.ndarray
    damping: np.ndarray
    ends: tuple[tuple[float, bool], ...]

    @property
    def stable(self) -> np.ndarray:
        """Whether the loop is stable (n,)."""
        return self.abscissa < 0


def pole_map(
    loop_at: LoopAt,
    over: str,
    unit: str,
    values: Sequence[float],
    highest: float,
) -> PoleMap:
    """The poles of ``loop_at(value)`` over ascending values, at least two. loop_at: the loop and
    the continuous plant that it was closed around, whose states are the loop's first; highest
    [rad/s]: modulus of the poles kept. Raises InvalidInput.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or len(x) < 2 or (np.diff(x) <= 0).any():
        raise invalid(
            f"the values of {over}", f"{x.size} values", "at least two, ascending", "give a range"
        )
    poles = [_continuous(*loop_at(float(value))) for value in x]
    kept = tuple(p[(p.imag >= 0) & (np.abs(p) <= highest)] for p in poles)
    abscissa = np.array([float(p.real.max()) for p in poles])
    rings = [p[p.imag > 1e-6 * np.abs(p)] for p in kept]
    damping = np.array([float(damping_ratio(p).min()) if len(p) else 1.0 for p in rings])
    ends = tuple(
        (_end(loop_at, a, b, before < 0), bool(after < 0))
        for (a, b), (before, after) in zip(
            pairwise(x.tolist()), pairwise(abscissa.tolist()), strict=True
        )
        if (before < 0) != (after < 0)
    )
    return PoleMap(over, unit, x, kept, abscissa, damping, ends)


def _continuous(loop: StateSpace, plant: StateSpace) -> np.ndarray:
    p = continuous_poles(loop.A, loop.dt, plant.A)[0].astype(complex)
    p = p if loop.dt is None else p[p.real > _DEEP / loop.dt]
    return p[np.lexsort((p.imag, p.real, np.abs(p)))]


def _end(loop_at: LoopAt, low: float, high: float, stable_below: bool) -> float:
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if (spectral_abscissa(loop_at(middle)[0]) < 0) == stable_below:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


# Families over a box of tolerances: worst-case unbalance by search and by bound, and pulse
# responses of its members.
#
# The loop is closed once with the uncertain parameters pulled out; every member of the family is
# then a small correction to it (``core.box``). The plant may be full, or reduced, or the members be
# those of many speeds, one after the other.


_BLOCK = 64  # members integrated at once


@named_failure("the loop over the box")
def loop_over_box(
    plant: Plant,
    controller: LawLike,
    inputs: Sequence[str],
    outputs: Sequence[str],
    tolerances: Sequence[Tolerance] | None = None,
) -> BoxLoop:
    """The closed loop from inputs (f_<port> [N]) to outputs (q_, qdot_, y_, i_ of the plant), its
    tolerances pulled out.

    controller: err -> u, continuous. tolerances: default the machine's. Raises InvalidInput for
    unknown signals or a sampled controller, UnstableSystem where the nominal loop is unstable.
    """
    K = match_controller(controller, plant)
    if K.dt is not None:
        raise invalid(
            "the controller",
            repr(K),
            "continuous",
            "give the one that the sampled controller was made from",
        )
    model = uncertain(plant, tolerances)
    w, z = model.w[: model.n_w_blocks], model.z[: model.n_z_blocks]
    u, y = list(plant.named("u")), list(plant.named("y"))
    twins = [f"{name} measured" for name in y]  # y_<axis> may be asked for as well
    s = model.system
    rows = [*range(len(s.outputs)), *(s.outputs.index(name) for name in y)]
    system = StateSpace(s.A, s.B, s.C[rows], s.D[rows], s.inputs, [*s.outputs, *twins])
    problem = GeneralizedPlant(system, [*w, *inputs], u, [*z, *outputs], twins, model.blocks)
    minus = StateSpace(K.A, K.B, -K.C, -K.D, K.inputs, K.outputs)  # err = -y
    return box_loop(lft(problem, minus), model.blocks)


@dataclass(frozen=True, slots=True, eq=False)
class BoxUnbalance:
    """Unbalance orbits over a box [m], all (w,): nominal, the largest found by search, and an upper
    bound by mixed mu.

    speeds (w,) [rad/s]; delta (w, k): where each largest one was found. The bound is NaN where it
    was not asked for.
    """

    speeds: np.ndarray
    nominal: np.ndarray
    found: np.ndarray
    bound: np.ndarray
    delta: np.ndarray


@named_failure("the unbalance response over the box")
def unbalance_over_box(
    plant: Plant | Callable[[float], Plant],
    controller: LawLike,
    speeds: ArrayLike,
    residual: Unbalance | None = None,
    tolerances: Sequence[Tolerance] | None = None,
    bound: bool = True,
) -> BoxUnbalance:
    """Largest singular value of the compliance between the bearings times the unbalance force, the
    worst over the box.

    plant: frozen at its own speed, or speed [rad/s] -> Plant. speeds (w,) [rad/s]: of rotation,
    ascending. residual: default that of the machine's balance grade. Source: Lauridsen 2017, paper
    P3, (14). Raises InvalidInput and UnstableSystem.
    """
    speeds = check_shape(speeds, "speeds", "(w,)").astype(float)
    if not callable(plant):
        loop = _compliance(plant, controller, tolerances)
    rows = []
    for speed in speeds:
        check_positive(speed, "the speed of rotation [rad/s]", "unbalance needs one")
        if callable(plant):
            at = plant(float(speed))
            loop = _compliance(at, controller, tolerances)
        else:
            at = plant
        force = _residual(at, residual).force(speed)
        omega = np.array([speed])
        nominal = gains(loop.at(omega), loop, np.zeros((1, loop.parameters)))[0, 0]
        worst = worst_gain_at(loop, float(speed))
        least = max(worst.value, nominal)
        limit = gain_bound(loop, omega, least) if bound else np.nan
        rows.append((nominal * force, least * force, limit * force, worst.delta))
    nominal, largest, limits, delta = zip(*rows, strict=True)
    return BoxUnbalance(
        speeds, np.array(nominal), np.array(largest), np.array(limits), np.array(delta)
    )


def _compliance(
    plant: Plant, controller: LawLike, tolerances: Sequence[Tolerance] | None
) -> BoxLoop:
    return loop_over_box(
        plant, controller, plant.bearing_named("f"), plant.bearing_named("q"), tolerances
    )


def _residual(plant: Plant, residual: Unbalance | None) -> Unbalance:
    unbalance = residual_unbalance(plant.machine) if residual is None else residual
    if unbalance is None:
        raise InvalidInput(
            "no balancing speed is known; give requirements.balance_speed or a speed range"
        )
    return unbalance


@dataclass(frozen=True, slots=True, eq=False)
class PulseFamily:
    """time (t,) [s]; responses (d, p, t) of the members delta (d, k) at the named outputs; stable
    (d,).
    """

    time: np.ndarray
    responses: np.ndarray
    delta: np.ndarray
    stable: np.ndarray
    outputs: tuple[str, ...]

    def settling(self, band: float = 0.02, outputs: Sequence[str] | None = None) -> np.ndarray:
        """Time (d,) [s] after which the outputs stay within ``band`` [-] of the member's largest
        value; infinite if never.
        """
        keep = [self.outputs.index(name) for name in (self.outputs if outputs is None else outputs)]
        size = np.abs(self.responses[:, keep]).max(axis=1)
        outside = size > band * size.max(axis=1, keepdims=True)
        last = size.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
        step = self.time[1] - self.time[0]
        settled = np.where(outside.any(axis=1), self.time[last] + step, 0.0)
        return np.where(outside[:, -1] | ~self.stable, np.inf, settled)


@named_failure("the pulse responses over the box")
def pulse_family(
    plant: Plant,
    controller: LawLike,
    port: str,
    force: float,
    width: float,
    outputs: Sequence[str],
    delta: ArrayLike | None = None,
    *,
    duration: float = 0.06,
    step: float = 1e-4,
    tolerances: Sequence[Tolerance] | None = None,
) -> PulseFamily:
    """Responses to a rectangular force pulse at a port, of every member delta (d, k) of the box
    (default: ``box_points``).

    force [N], width [s] (infinite: a step). The pulse's edges and the samples, ``step`` [s] apart,
    are met exactly (matrix exponentials). Raises InvalidInput, UnstableSystem.
    """
    loop = loop_over_box(plant, controller, [f"f_{port}"], outputs, tolerances)
    members = (
        box_points(loop.parameters)
        if delta is None
        else check_shape(delta, "delta", "(d, k)", k=loop.parameters)
    )
    on = round(min(width, 2 * duration) / step)
    if width < duration and abs(on * step - width) > 1e-6 * step:
        raise invalid(
            "the width of the pulse [s]",
            width,
            f"a multiple of the step, {step:g} s",
            "change the step",
        )
    time = np.arange(round(duration / step) + 1) * step
    responses = np.empty((len(members), len(outputs), len(time)))
    stable = np.empty(len(members), bool)
    for first in range(0, len(members), _BLOCK):
        block = members[first : first + _BLOCK]
        A, B, C, D = upper_lft(loop.system, block[:, loop.owner, None] * np.eye(len(loop.owner)))
        stable[first : first + _BLOCK] = np.linalg.eigvals(A).real.max(axis=1) < 0
        Ad, Bd = held(A, B, step)
        x = np.zeros((len(block), len(loop.system.A), 1))
        for k in range(len(time)):
            u = force if k < on else 0.0
            responses[first : first + _BLOCK, :, k] = (C @ x + D * u)[..., 0]
            x = Ad @ x + Bd * u
    return PulseFamily(time, responses, np.asarray(members, dtype=float), stable, tuple(outputs))


ALONG = ("pulses",)  # what there is of a machine's axis along the shaft
OVER = {"speed": "rad/s", "pressure": "Pa"}
_STANDING = 9  # speeds along the range at which stability is judged
_VALUES, _SPEEDS = 21, 24  # of a map, and of the unbalance over the tolerances
_BEYOND = {"speed": 1.2, "pressure": 2.0}  # times the largest of the machine, to which a map goes
_HIGHEST = 1e3 * TWO_PI  # [rad/s] of the poles kept, or three times the top speed
_FORCE, _WIDTH = 100.0, 2e-3  # [N], [s] of the pulse (P3, Fig. 9)
_LASTS = 0.2  # [s] that the response is followed; assumed


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Exploration(Presented):
    """maps: poles over speed and pressure; campbell: curves over speed; pulses: responses to 100 N
    for 2 ms at ``port``, its nominal member first; unbalance: orbits over speed, nominal, worst
    found over the tolerances and an upper bound. standing: stability at the
    operating points and along the speed range, as judged, whatever the parts. assumed: where the
    loop would be lost at the rate that rig and export assume, as nobody states one. notes: how each
    was computed; timing: of the loop, in words; controller: what a page calls it.
    """

    machine: Machine
    point: OperatingPoint
    timing: str
    maps: tuple[PoleMap, ...] = ()
    campbell: tuple[Curve, ...] = ()
    pulses: PulseFamily | None = None
    port: str = ""
    unbalance: BoxUnbalance | None = None
    standing: tuple[Stability, ...] = ()
    assumed: tuple[Stability, ...] = ()
    notes: tuple[str, ...] = ()
    controller: str = ""

    @property
    def stable(self) -> bool:
        """Whether the judge found every operating point stable, and every member and every value
        that was looked at besides.
        """
        within = [
            bool(item.stable[item.values <= _largest(self.machine, item.over) * (1 + 1e-9)].all())
            for item in self.maps
        ]
        judged = bool(self.standing) and all(item.stable for item in self.standing)
        judged &= not self.assumed
        members = self.pulses is None or bool(self.pulses.stable.all())
        return judged and all(within) and members

    def facts(self) -> dict[str, Any]:
        """Where stability ends, how many members are stable, the largest orbit."""
        facts: dict[str, Any] = {"machine": self.machine.name, "stable": self.stable}
        for item in self.maps:
            facts[f"ends over {item.over}"] = [value for value, _ in item.ends]
        if self.pulses is not None:
            facts["stable members"] = (
                f"{int(self.pulses.stable.sum())} of {len(self.pulses.stable)}"
            )
        if self.unbalance is not None:
            facts["largest orbit found, 0-p"] = float(self.unbalance.found.max())
        return facts

    def to_dict(self) -> dict[str, Any]:
        """Everything, SI, ready for JSON; of the pulse family envelope and settling."""
        data: dict[str, Any] = {
            "machine": self.machine.name,
            "point": self.point.label,
            "timing": self.timing,
            "stable": self.stable,
            "operating_points": [
                {"label": s.label, "stable": s.stable, "abscissa": s.abscissa}
                for s in self.standing
            ],
            "lost_at_the_assumed_rate": [
                {"label": s.label, "abscissa": s.abscissa} for s in self.assumed
            ],
            "notes": list(self.notes),
            "maps": [
                {
                    "over": m.over,
                    "unit": m.unit,
                    "values": m.values.tolist(),
                    "abscissa": m.abscissa.tolist(),
                    "least_damping": m.damping.tolist(),
                    "ends": [{"at": at, "stable_above": above} for at, above in m.ends],
                    "poles": [[p.real.tolist(), p.imag.tolist()] for p in m.poles],
                }
                for m in self.maps
            ],
            "campbell": [curve.to_dict() for curve in self.campbell],
        }
        if self.pulses is not None:
            family, kept = self.pulses, self.pulses.responses[self.pulses.stable]
            data["pulses"] = {
                "port": self.port,
                "outputs": list(family.outputs),
                "time": family.time.tolist(),
                "nominal": family.responses[0].tolist(),
                "members": len(family.stable),
                "stable": int(family.stable.sum()),
                "low": kept.min(axis=0).tolist() if len(kept) else None,
                "high": kept.max(axis=0).tolist() if len(kept) else None,
                "settling": [float(t) if np.isfinite(t) else None for t in family.settling()],
            }
        if self.unbalance is not None:
            u = self.unbalance
            bound = None if np.isnan(u.bound).any() else u.bound.tolist()
            data["unbalance"] = {
                "speeds": u.speeds.tolist(),
                "nominal": u.nominal.tolist(),
                "found": u.found.tolist(),
                "bound": bound,
                "worst_member": u.delta.tolist(),
            }
        return data


def explore(
    machine: Machine,
    controller: LawLike,
    *,
    point: str | OperatingPoint | None = None,
    progress: Callable[[str], None] = lambda stage: None,
    **options: Any,
) -> Exploration:
    """A controller over the range of a machine, around an operating point (None: the one designs
    are made for).

    options: of ``ambrose.options.Exploring``; along the shaft there is ALONG alone. Raises
    InvalidInput.
    """
    asked = Exploring(**options)
    parts = asked.parts or PARTS
    spans = {"pressure": asked.pressure, "speed": asked.speed}
    reach = {name: span for name, span in spans.items() if span is not None}
    if not machine.lateral:
        parts = ALONG if tuple(parts) == PARTS and not reach else parts
        if set(parts) - set(ALONG) or reach:
            machine.across_the_shaft("nothing along it follows speed, pressure or unbalance")
    law = law_of(controller)
    timing = timing_of(machine, law, asked.rate, asked.delay_samples)
    at = chosen_point(machine, point) or machine.operation.design
    plant = assemble(machine, at)
    notes: list[str] = []
    progress("stability at the operating points")
    standing = judge_points(machine, law, timing, _between(machine, law, at))
    done = Exploration(
        machine,
        at,
        "continuous" if timing is None else str(timing),
        standing=standing,
        assumed=lost_as_assumed(machine, law, timing, standing),
        controller=law.named,
    )
    if "poles" in parts:
        done = replace(done, maps=tuple(_maps(machine, law, timing, at, reach, notes, progress)))
    if "campbell" in parts:
        done = replace(done, campbell=campbell_map(plant, _along_speed(law, timing, at), progress))
    tolerances = tolerances_around(plant)
    if {"pulses", "unbalance"} & set(parts) and not tolerances:
        notes.append(
            "no tolerances at this operating point: a family over them is the nominal loop alone"
        )
    elif {"pulses", "unbalance"} & set(parts):
        done = _over_tolerances(done, plant, law, timing, parts, asked.bound, notes, progress)
    return replace(done, notes=tuple(notes))


def _between(machine: Machine, law: Law, at: OperatingPoint) -> tuple[OperatingPoint, ...]:
    """Operating points along the machine's running range, all else as at one of them; those that
    the law has no place for are left out.
    """
    low, high = machine.operation.running
    if high <= low:
        return (at,)
    speeds = np.linspace(low, high, _STANDING).tolist()
    if law.follows(SPEED) and law.range is not None:
        first, last = (float(np.atleast_1d(end)[0]) for end in law.range)
        speeds = [speed for speed in speeds if first <= speed <= last]
    return (at, *(replace(at, speed=speed, label=f"{speed:.4g} rad/s") for speed in speeds))


def _along_speed(law: Law, timing: Timing | None, at: OperatingPoint) -> StateSpace | LawAt:
    """The law as it runs for a map over speed: a function of it where it changes with it."""

    def running_at(point: OperatingPoint) -> StateSpace:
        return law.at(point) if timing is None else timing.in_loop(law.at(point))

    if law.follows(SPEED):
        return lambda speed: running_at(replace(at, speed=speed))
    return running_at(at)


def _largest(machine: Machine, over: str) -> float:
    points = machine.operation.envelope
    return top_speed(machine) if over == "speed" else max(point.seal_pressure for point in points)


def _maps(
    machine: Machine,
    law: Law,
    timing: Timing | None,
    at: OperatingPoint,
    reach: dict[str, tuple[float, float]],
    notes: list[str],
    progress: Callable[[str], None],
) -> list[PoleMap]:
    maps = []
    for over, unit in OVER.items():
        top = _largest(machine, over)
        span = reach.get(over, (0.0, _BEYOND[over] * top))
        if span[1] <= span[0] or (over not in reach and reach):
            continue

        @cache  # asked for first whether there is a loop
        def loop_at(value: float, over: str = over) -> tuple[StateSpace, StateSpace]:
            key = "speed" if over == "speed" else "seal_pressure"
            plant = assemble(machine, replace(at, label="", **{key: value}))
            return closed_loop(plant, running_law(law, plant, timing)), plant.system

        progress(f"poles over {over}")
        values, last = np.linspace(*span, _VALUES), ""
        usable = []
        for value in values.tolist():
            try:
                loop_at(value)
            except InvalidInput as error:  # outside a table of the seal, or of the schedule
                last = str(error)
                continue
            usable.append(value)
        if len(usable) < 2:
            notes.append(f"no map over {over}: {last}")
            continue
        if last:
            notes.append(
                f"the map over {over} leaves out what the machine or the controller does not "
                f"cover: {last}"
            )
        maps.append(pole_map(loop_at, over, unit, usable, max(_HIGHEST, 3 * top_speed(machine))))
    if not maps and not notes:
        notes.append("no map of poles: the machine neither turns nor has a seal under pressure")
    return maps


def _over_tolerances(
    done: Exploration,
    plant: Plant,
    law: Law,
    timing: Timing | None,
    parts: Sequence[str],
    bound: bool,
    notes: list[str],
    progress: Callable[[str], None],
) -> Exploration:
    fixed = match_controller(law, plant)
    if fixed.dt is not None:
        notes.append(
            "the families need the continuous law that a sampled controller was made from; this "
            "one is sampled"
        )
        return done
    model = fixed if timing is None else timing.late(fixed)
    modes = default_bending_modes(plant)
    reduced = reduce(plant, modes)
    delay_words = (
        "" if timing is None else ", the continuous law with the sampled loop's mean delay"
    )
    notes.append(f"families: {modes} bending modes per plane{delay_words}")
    tolerances = tolerances_around(plant)
    try:
        if "pulses" in parts:
            progress("a pulse for every member of the tolerances")
            port = plant.bearing_named("f")[0][2:]
            outputs = [*plant.bearing_named("q"), *plant.named("i")]
            family = pulse_family(
                reduced,
                model,
                port,
                _FORCE,
                _WIDTH,
                outputs,
                duration=_LASTS,
                tolerances=tolerances,
            )
            done = replace(done, pulses=family, port=port)
        residual, top = residual_unbalance(plant.machine), _highest_speed(plant.machine)
        if "unbalance" in parts and not stability(reduced, model, tolerances).passed:
            notes.append(
                "no unbalance: some loops within the tolerances are unstable, so that no orbit is "
                "the largest"
            )
        elif "unbalance" in parts and residual is not None and top:
            progress("unbalance over speed and tolerances")
            speeds = np.linspace(top / _SPEEDS, top, _SPEEDS)
            worst = unbalance_over_box(reduced, model, speeds, residual, tolerances, bound)
            notes.append(
                "unbalance: rotor and seals as at the operating point's speed; worst case found "
                "by search"
            )
            done = replace(done, unbalance=worst)
        elif "unbalance" in parts:
            notes.append("no unbalance: neither balance_speed nor a speed range says what it is")
    except UnstableSystem as error:
        notes.append(f"no families: {error}")
    return done


def _highest_speed(machine: Machine) -> float:
    return float(
        machine.requirements.unbalance_to
        or top_speed(machine)
        or machine.requirements.balance_speed
        or 0.0
    )
