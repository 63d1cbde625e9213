"""One controller over its whole range: poles over speed and pressure, a pulse and unbalance for
every member of the tolerances.

found = explore(machine, controller)
found.maps, found.pulses, found.unbalance
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace
from ambrose.judge.checks import Curve
from ambrose.judge.family.poles import PoleMap, pole_map
from ambrose.judge.family.responses import (
    BoxUnbalance,
    PulseFamily,
    pulse_family,
    unbalance_over_box,
)
from ambrose.judge.plants import campbell_map, chosen_point
from ambrose.judge.robust import stability
from ambrose.judge.stability import Stability, judge_points, lost_as_assumed
from ambrose.law.law import Law, LawAt, LawLike, law_of
from ambrose.law.loop import closed_loop, match_controller, running_law
from ambrose.law.scheduling import SPEED
from ambrose.law.timing import Timing, timing_of
from ambrose.machine.axial import AxialMachine, across_the_shaft
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, top_speed
from ambrose.model.reduce import default_bending_modes, reduce
from ambrose.model.unbalance import residual_unbalance
from ambrose.model.uncertainty import tolerances_around

PARTS = ("poles", "campbell", "pulses", "unbalance")
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
    was computed; timing: of the loop, in words.
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
    parts: Sequence[str] = PARTS,
    point: str | OperatingPoint | None = None,
    reach: dict[str, tuple[float, float]] | None = None,
    bound: bool = False,
    rate: float | None = None,
    delay_samples: int | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Exploration:
    """A controller over the range of a machine, around an operating point (None: the one designs
    are made for).

    parts: some of PARTS (along the shaft ALONG alone). reach: of a map, {"pressure": (0.0, 4e5)}
    [Pa], "speed" [rad/s] (None: zero to twice the largest pressure, to 1.2 times the top speed).
    bound: an upper bound beside the worst unbalance found, which takes longer. rate [Hz],
    delay_samples: of the sampled loop. Raises InvalidInput.
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown or not parts:
        raise invalid(
            "the parts", ", ".join(unknown) or "none", f"some of {', '.join(PARTS)}", "correct them"
        )
    for name, span in (reach or {}).items():
        if name not in OVER or not 0 <= span[0] < span[1]:
            remedy = "give speed or pressure from a lower to a higher value"
            raise invalid(
                f"the range of {name}",
                f"{span[0]:g} to {span[1]:g}",
                "ascending, of speed or pressure",
                remedy,
            )
    if isinstance(machine, AxialMachine):
        parts = ALONG if tuple(parts) == PARTS and not reach else parts
        if set(parts) - set(ALONG) or reach:
            across_the_shaft(machine, "nothing along it follows speed, pressure or unbalance")
    law = law_of(controller)
    timing = timing_of(machine, law, rate, delay_samples)
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
    )
    if "poles" in parts:
        done = replace(
            done, maps=tuple(_maps(machine, law, timing, at, reach or {}, notes, progress))
        )
    if "campbell" in parts:
        done = replace(done, campbell=campbell_map(plant, _along_speed(law, timing, at), progress))
    tolerances = tolerances_around(plant)
    if {"pulses", "unbalance"} & set(parts) and not tolerances:
        notes.append(
            "no tolerances at this operating point: a family over them is the nominal loop alone"
        )
    elif {"pulses", "unbalance"} & set(parts):
        done = _over_tolerances(done, plant, law, timing, parts, bound, notes, progress)
    return replace(done, notes=tuple(notes))


def _between(machine: Machine, law: Law, at: OperatingPoint) -> tuple[OperatingPoint, ...]:
    """Operating points along the machine's speed range, all else as at one of them; those that the
    law has no place for are left out.
    """
    low, high = machine.operation.speed_range
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
