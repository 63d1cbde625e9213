"""Stage: controllers compared while the machine runs up, on the linear loop and on the nonlinear virtual rig."""

from __future__ import annotations

from collections.abc import Callable

from ambrose.evaluation import Candidate, RunUp
from ambrose.plant.model import Plant
from ambrose.simulation import virtual_rig
from ambrose.simulation.run_up import spin_up, steps
from ambrose.simulation.scenario import load_scenario

SCENARIO = "spin-up-steps"  # P3: 20 to 300 Hz in 1 s, a step of force or set point every 50 ms
Progress = Callable[[str], None]


def run_ups(plant: Plant, candidates: tuple[Candidate, ...], progress: Progress) -> tuple[RunUp, ...]:
    """The scheduled candidates and the robust ones beside them; none where no schedule covers the scenario's speeds."""
    scenario = load_scenario(SCENARIO)
    low, high = scenario.speed_at(0.0), scenario.speed_at(scenario.duration)
    schedules = [c.synthesis.scheduled for c in candidates if c.synthesis.scheduled is not None]
    if not any(s.range[0] <= low * (1 + 1e-9) and high <= s.range[1] * (1 + 1e-9) for s in schedules):
        return ()
    runs = []
    for candidate in candidates:
        if candidate.synthesis.method not in {"lpv", "mu"}:  # the scheduled one, and the fixed one that is robust
            continue
        law = candidate.synthesis.law
        progress(f"{candidate.name}: running up, {SCENARIO}")
        linear = spin_up(plant, law, scenario)
        rig = virtual_rig.run(plant.machine, law, scenario, point=plant.point)
        y = plant.named("y")
        runs.append(RunUp(candidate.name, linear, rig, steps(linear, scenario, y), steps(rig, scenario, y)))
    return tuple(runs)
