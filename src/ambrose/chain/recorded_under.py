"""Under which controller the machine on site is recorded: one that the judge says holds it there.

The PID of the machine file where it holds, as on site; else the tuned controller, else the best of
the others. What is asked is the loop that is recorded: at the machine's operating point, sampled
and late as the rig runs it, whatever loop the controller was designed for.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ambrose.judge.result import Synthesis
from ambrose.judge.stability import Stability, judge_stability
from ambrose.law.timing import DEFAULT, machine_timing
from ambrose.machine.axial import in_file
from ambrose.model.plant import Plant
from ambrose.rig.candidate import Candidate

FIRST = ("pid", "tuned")  # the methods that are asked before the others, in this order


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """candidate: the one that is recorded (None: none holds the machine); words: its name and why
    it is not the PID ("": it is the PID), or in a sentence why there is none.
    """

    candidate: Candidate | None
    words: str = ""


def as_recorded(plant: Plant, synthesis: Synthesis) -> Stability:
    """What the judge says of the loop while the rig records it.

    plant: full, at the point of the record. Raises InvalidInput where the controller is not one for
    the plant, or runs at another rate than the machine.
    """
    return judge_stability(plant, synthesis.controller, machine_timing(plant.machine) or DEFAULT)


def reference(
    plant: Plant, candidates: Sequence[Candidate], waiting: Collection[str] = ()
) -> Reference | None:
    """Under which of the candidates the machine is recorded, as soon as that is certain (None: not
    before one of those in ``waiting`` is there).

    plant: as for ``as_recorded``; waiting: the methods whose controllers are still to come.
    Schedules are left out: the record is of one speed.
    """
    by_method = {item.synthesis.method: item for item in candidates}
    lost: list[tuple[Candidate, Stability]] = []
    for method in FIRST:
        if method in waiting:
            return None
        if method not in by_method:
            continue
        item = by_method[method]
        held = as_recorded(plant, item.synthesis)
        if held.stable:
            return Reference(item, _instead(item, lost))
        lost.append((item, held))
    if waiting:
        return None

    others = [
        item
        for item in candidates
        if item.synthesis.method not in FIRST and item.synthesis.scheduled is None
    ]
    judged = [(item, as_recorded(plant, item.synthesis)) for item in others]
    holding = [item for item, held in judged if held.stable]
    if not holding:
        return Reference(None, _none(plant, [*lost, *judged]))
    from ambrose.report.comparison.envelope import nearest

    best = nearest(holding)
    return Reference(best, _instead(best, lost))


def _instead(chosen: Candidate, lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """Why not one that goes before it; "" where there is none."""
    if not lost:
        return ""
    return f"{chosen.name}, because {_listed(lost)} not hold the machine at {_where(lost[0][1])}"


def _none(plant: Plant, lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """Cause and remedy where nothing holds."""
    if not lost:
        return "no controller of the study is fixed, so there is none to record the machine under"
    machine = plant.machine
    if machine_timing(machine) is None:
        remedy = in_file(
            machine, "state [controller] sample_time, for which controllers are then designed"
        )
    else:
        remedy = "design one that holds this loop, or state a shorter [controller] sample_time"
    return (
        f"nothing to record: {_listed(lost)} not hold the machine at {_where(lost[0][1])}; {remedy}"
    )


def _listed(lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """The controllers with the rates at which they lose the machine, and "does" or "do"."""
    words = [f"{item.name} ({held.abscissa:+.3g} 1/s)" for item, held in lost]
    verb = "does" if len(words) == 1 else "do"
    return f"{', '.join(words[:-1])} and {words[-1]} {verb}" if words[1:] else f"{words[0]} {verb}"


def _where(held: Stability) -> str:
    return f"{held.label}, {held.timing}"
