"""One loop at a glance: whether it holds, its sensitivity, its loci and a pulse, in milliseconds.

For who turns a slider and looks: a part of ``nominal.check``, made of the same functions, without
its refined peaks and without what takes the machine apart along its speed. On a reduced plant it
says of how many bending modes; the verdict on the full plant is verify's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import named_failure
from ambrose.core.frequency import largest_gain
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import judge
from ambrose.judge.loop_response import frequency_grid, loop_evaluator
from ambrose.judge.margins import opened_loops
from ambrose.judge.rotor_modes import modes
from ambrose.judge.sensitivity import ALL_AXES, sensitivity_curve
from ambrose.judge.stability import Stability, judge_stability
from ambrose.judge.transient import pulse_checks, pulse_response
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, running_law
from ambrose.law.timing import Timing
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI, demand
from ambrose.model.plant import Plant, top_speed

_LOWEST = 0.5 * TWO_PI  # [rad/s]
_PER_DECADE = 60  # points of the grid, beside those around the poles
LARGEST, MOST = "largest of the axes", "axis that moves most"


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """What one sees of a loop; of an unstable one only that.

    sensitivity: the largest |S_ii| of any axis over frequency, which ISO 14839-3 judges; omega (w,)
    [rad/s] and loci (w, a): the loop of every axis, opened at its sensor with the others closed;
    pulse: the displacement that answers a short current, of the axis that
    moves most, over the first quarter of a second. checks: the peaks on the grid of the largest
    axis, which has a zone, and of all axes together, against the limits that ``check`` has.
    """

    stability: Stability
    sensitivity: Curve | None = None
    omega: np.ndarray | None = None
    loci: np.ndarray | None = None
    pulse: Curve | None = None
    checks: tuple[Check, ...] = ()

    @property
    def peak(self) -> float:
        """The largest sensitivity on the grid; inf where the loop is unstable."""
        return np.inf if self.sensitivity is None else float(self.sensitivity.y.max())

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and meets the limits of its sensitivity, on the grid."""
        return self.stability.stable and all(check.passed is not False for check in self.checks)


@named_failure("the loop")
def glance(plant: Plant, given: LawLike, timing: Timing | None) -> Glance:
    """A loop at a glance. Raises InvalidInput where the law is not one for the plant."""
    stability = judge_stability(plant, given, timing)
    if not stability.stable:
        return Glance(stability)
    law = running_law(given, plant, timing)
    requirements = plant.machine.requirements
    speed = max(top_speed(plant.machine), plant.point.speed)
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * speed)
    if law.dt is not None:
        highest = min(highest, np.pi / law.dt)
    closed = closed_loop(plant, law)
    poles = modes(closed, plant.ports, plant.system).poles
    response = loop_evaluator(plant, law)(frequency_grid(poles, _LOWEST, highest, _PER_DECADE))
    curve = sensitivity_curve(response, requirements)
    largest = replace(curve, y=curve.y.max(axis=0)[None], labels=(LARGEST,))
    answer = pulse_response(closed, plant, longest=0.0)
    _, (moved, _) = pulse_checks(answer, plant, requirements)
    most = int(np.abs(moved.y).max(axis=1).argmax())
    # one name at every point, whichever axis it is, so that all stand in one picture
    one = replace(moved, y=moved.y[most][None], labels=(MOST,))
    together = float(largest_gain(response.output_sensitivity()).max())
    checks = tuple(
        judge(name, title, value, "-", demand(rule, requirements))
        for name, title, value, rule in (
            ("axis", LARGEST, float(largest.y.max()), "sensitivity of an axis"),
            ("max", ALL_AXES, together, "maximum singular value of a sensitivity"),
        )
    )
    loops = opened_loops(response, "output")
    return Glance(stability, largest, response.omega, loops, one, checks)
