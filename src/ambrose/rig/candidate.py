"""One controller with everything that verification and simulation say about it, as a comparison
takes it.

candidate = evaluate("mu", synthesis, full_plants(machine))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ambrose.core.checks import InvalidInput
from ambrose.judge.checks import Check, Checks
from ambrose.judge.plants import Progress, split_covered
from ambrose.judge.result import Synthesis
from ambrose.judge.verdict import verify_points, verify_ranges, verify_tolerances
from ambrose.judge.verification import CONTINUOUS
from ambrose.law.law import LawLike
from ambrose.law.timing import DEFAULT, Timing, machine_timing, timing_of
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.rig import virtual_rig
from ambrose.rig.run_up import steps
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import RUN_UP, RunUp, run_on_rig, simulate_linear

SCENARIOS = ("impulse-orthogonal", "impulse-parallel")  # the two disturbance patterns of P5


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One controller and all results about it. Raises InvalidInput for a name or a label that does
    not tell apart.

    name: for people ("PID", "H-infinity", "mu"); checks: per operating point; boxes: over the
    tolerances around each, from verify_tolerances; traces: (operating point, trace) pairs, several
    scenarios; left_out: labels of the operating points that its schedule does not cover; timing:
    what loop was judged, in words; ranges: over the machine's ranges, from verify_ranges.
    """

    name: str
    synthesis: Synthesis
    checks: tuple[Checks, ...]
    boxes: tuple[Checks, ...] = ()
    traces: tuple[tuple[str, Trace], ...] = ()
    left_out: tuple[str, ...] = ()
    timing: str = CONTINUOUS
    ranges: tuple[Checks, ...] = ()

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a candidate has no name; give it one, e.g. that of its method")
        if not self.checks:
            raise InvalidInput(
                f"candidate {self.name!r} has no checks; verify it at one operating point at least"
            )
        labels = [checks.label for checks in self.checks]
        twice = next((label for label in labels if labels.count(label) > 1), None)
        if twice is not None:
            raise InvalidInput(
                f"candidate {self.name!r} has two verifications labelled {twice!r}; give every "
                "point its label"
            )

    @property
    def robust(self) -> Checks | None:
        """The checks over the tolerances around the first point that has any: the one with all
        curves, bounds and proofs.
        """
        return self.boxes[0] if self.boxes else None

    @property
    def verifications(self) -> tuple[Checks, ...]:
        """The checks at every operating point, then those over the tolerances around each and over
        the ranges.
        """
        return (*self.checks, *self.boxes, *self.ranges)

    @property
    def passed(self) -> bool:
        """Whether no operating point is left out and every check at every one and over the
        tolerances around each is met.
        """
        return not self.left_out and all(checks.passed for checks in self.verifications)

    def at(self, point: str) -> Checks | None:
        """The checks at the operating point of that label; None where it was not verified."""
        return next((checks for checks in self.checks if checks.label == point), None)


@dataclass(frozen=True, slots=True, eq=False)
class Deployed:
    """A controller as it runs on the machine, where that differs from its design.

    law: sampled, without its computing delay, which is verified with it; program: what computes it,
    run on the rig; plants: of the machine that the rig stands for; timing: when it acts (None: it
    is continuous).
    """

    law: LawLike
    program: LawLike
    plants: tuple[Plant, ...]
    timing: Timing | None = None


def find(checks: Checks | None, name: str) -> Check | None:
    """The check of that name, if there is one."""
    return (
        next((check for check in checks.checks if check.name == name), None)
        if checks is not None
        else None
    )


def points_of(machine: Machine, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The labels of all operating points, by rising speed and seal pressure; unknown ones last, as
    they come.

    Raises InvalidInput for no candidates, or two of the same name.
    """
    names = [candidate.name for candidate in candidates]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(
            f"the candidates are named {', '.join(names) or 'not at all'}, but need one name "
            "each; rename them"
        )
    known = {
        point.label: (point.speed, point.seal_pressure) for point in machine.operation.envelope
    }
    labels = dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    return tuple(sorted(labels, key=lambda label: known.get(label, (float("inf"), 0.0))))


def evaluate(
    name: str,
    synthesis: Synthesis,
    plants: Sequence[Plant],
    progress: Progress = lambda stage: None,
    *,
    deployed: Deployed | None = None,
    tolerances: Sequence[Tolerance] | None = None,
) -> Candidate:
    """A controller with everything that verification and simulation say about it.

    plants: full; tolerances: as for ``verify_tolerances``. In time: both patterns of P5 on the
    linear loop, one also on the virtual rig. deployed: as it runs, where that is known: its law is
    verified, its program runs the rig (None: the controller itself does, at the rate that it or the
    machine file knows). Raises InvalidInput.
    """
    law = synthesis
    within, left_out = split_covered(law, plants)
    timing = timing_of(plants[0].machine, synthesis) if deployed is None else deployed.timing
    running = Deployed(law, law, within, timing) if deployed is None else deployed
    checks = verify_points(within, running.law, progress, timing)
    boxes = verify_tolerances(within, running.law, checks, progress, timing, tolerances, design=law)
    ranges, beyond = verify_ranges(plants[0].machine, running.law, checks, progress, timing)
    left_out = (*left_out, *beyond)
    traces: list[tuple[str, Trace]] = []
    for plant, real in zip(within, running.plants, strict=True):
        label = plant.point.label
        progress(f"simulating at {label}")
        traces += [(label, simulate_linear(plant, law, scenario, timing)) for scenario in SCENARIOS]
        progress(f"virtual rig at {label}")
        traces.append((label, run_on_rig(real, running.program, SCENARIOS[-1], timing)))
    words = CONTINUOUS if timing is None else str(timing)
    return Candidate(name, synthesis, checks, boxes, tuple(traces), left_out, words, ranges)


def check_trials(machine: Machine) -> None:
    """Raises InvalidInput for a machine on which a scenario that ``evaluate`` runs is refused,
    before anything is computed.
    """
    timing = machine_timing(machine) or DEFAULT
    for name in SCENARIOS:
        virtual_rig.check_scenario(machine, load_scenario(name), timing.sample_time)


def run_ups(
    plant: Plant, candidates: tuple[Candidate, ...], progress: Progress
) -> tuple[RunUp, ...]:
    """The scheduled candidates and the robust ones beside them while the machine runs up, on the
    linear loop and on the virtual rig; none where no schedule covers the scenario's speeds.
    """
    schedules = [c.synthesis.scheduled for c in candidates if c.synthesis.scheduled is not None]
    if not schedules:  # nor need the machine state what the scenario's speeds are shares of
        return ()
    scenario = load_scenario(RUN_UP).on(plant.machine)
    low, high = scenario.speed_at(0.0), scenario.speed_at(scenario.duration)
    if not any(
        s.axes[0][0] <= low * (1 + 1e-9) and high <= s.axes[0][-1] * (1 + 1e-9) for s in schedules
    ):
        return ()
    runs = []
    for candidate in candidates:
        # the scheduled one, and the fixed ones that are robust
        if candidate.synthesis.method not in {"lpv", "tuned", "mu"}:
            continue
        law = candidate.synthesis.law
        progress(f"{candidate.name}: running up, {RUN_UP}")
        linear = simulate_linear(
            plant, law, scenario, timing_of(plant.machine, candidate.synthesis)
        )
        rig = virtual_rig.run(plant.machine, law, scenario, point=plant.point)
        y = plant.named("y")
        runs.append(
            RunUp(candidate.name, linear, rig, steps(linear, scenario, y), steps(rig, scenario, y))
        )
    return tuple(runs)
