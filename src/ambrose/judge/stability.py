"""Whether a law holds a plant: the one place that says so, of the loop as it runs.

A page, a command or a stage that calls a loop stable holds a ``Stability`` of this module, or a
check that was made with it. It computes no poles of its own for that: a map of poles, a family over
tolerances or a run in time shows what they show, and says nothing of what they did not look at.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, feedback, select, series, static_gain
from ambrose.core.statespace import spectral_abscissa as abscissa_of
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import running_law
from ambrose.law.timing import DEFAULT, Timing
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True)
class Stability:
    """What was found of one loop.

    label: of the operating point; abscissa [rad/s]: the largest real part of the loop's poles, of a
    sampled loop that of ln(z)/T; model: the plant, in words; timing: the loop, in words.
    """

    label: str
    abscissa: float
    model: str
    timing: str

    @property
    def stable(self) -> bool:
        """Whether every pole lies to the left of the imaginary axis."""
        return self.abscissa < 0


def loop_abscissa(loop: StateSpace) -> float:
    """Spectral abscissa [rad/s] of the unity feedback around controller and plant in series."""
    unit = static_gain(np.eye(len(loop.outputs)), dt=loop.dt)
    return abscissa_of(feedback(loop, unit))


def judge_stability(plant: Plant, given: LawLike, timing: Timing | None) -> Stability:
    """Stability of the loop of a plant, with a timing as it runs: sampled, held and late.

    plant: full, else ``model`` says how far it is reduced. Raises InvalidInput where the law is not
    one for the plant.
    """
    law = running_law(law_of(given), plant, timing)
    system = select(plant.system, plant.named("u"), plant.named("y"))
    if law.dt is not None:
        system = c2d(system, law.dt)
    modes = plant.bending_modes
    kind = "full plant" if modes is None else f"plant with {modes} bending modes per plane"
    return Stability(
        plant.point.label or f"{plant.point.speed:g} rad/s, {plant.point.seal_pressure:g} Pa",
        loop_abscissa(series(law, system)),
        f"{kind}, {plant.system.n_states} states",
        "continuous" if timing is None else str(timing),
    )


def judge_assumed(plant: Plant, given: LawLike, timing: Timing | None) -> Stability | None:
    """Stability at the rate and delay that virtual rig and export assume where nobody states one
    (``law.timing.DEFAULT``); None where a timing is known or the law is sampled itself.
    """
    if timing is not None or law_of(given).at(plant.point).dt is not None:
        return None
    return judge_stability(plant, given, DEFAULT)


def judge_points(
    machine: Machine,
    given: LawLike,
    timing: Timing | None,
    extra_points: Iterable[OperatingPoint] = (),
) -> tuple[Stability, ...]:
    """Stability on the full plant at every operating point of a machine that the law covers, and at
    ``extra_points``.
    """
    law = law_of(given)
    envelope = machine.operation.envelope
    points = [*envelope, *(point for point in extra_points if point not in envelope)]
    plants = (assemble(machine, point) for point in points)
    return tuple(judge_stability(plant, law, timing) for plant in plants if law.covers(plant))


def lost_as_assumed(
    machine: Machine, given: LawLike, timing: Timing | None, held: Sequence[Stability]
) -> tuple[Stability, ...]:
    """Where the loop would be unstable at the rate that others assume (``judge_assumed``), of the
    operating points at which it is ``held`` as it was judged; none where a rate is known.
    """
    stable = {item.label for item in held if item.stable}
    law = law_of(given)
    found = []
    for point in machine.operation.envelope if timing is None else ():
        plant = assemble(machine, point)
        judged = judge_assumed(plant, law, timing) if law.covers(plant) else None
        if judged is not None and not judged.stable and judged.label in stable:
            found.append(judged)
    return tuple(found)


def describe(results: Sequence[Stability]) -> str:
    """The stabilities in a sentence: where the loop holds, where it is lost."""
    if not results:
        return "not judged: the law covers none of the operating points"
    lost = [item for item in results if not item.stable]
    if lost:
        worst = max(lost, key=lambda item: item.abscissa)
        return (
            f"unstable at {len(lost)} of {len(results)} operating points, "
            f"the most at {worst.label} ({worst.abscissa:+.4g} rad/s)"
        )
    return f"stable at all {len(results)} operating points examined ({results[0].model})"
