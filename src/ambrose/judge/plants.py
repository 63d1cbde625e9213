"""The full plants of a machine at its operating points, and what they show along the speed."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    feedback,
    select,
    series,
    spectral_abscissa as abscissa_of,
    static_gain,
)
from ambrose.judge import campbell
from ambrose.judge.checks import Curve
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import DEFAULT, Timing, running_law
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble, bending_modes_of
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import (
    default_bending_modes,
    free_mode_reduction,
    with_offsets_of,
)

# The full plants at the operating points of a machine.


def envelope_of(plant: Plant) -> list[Plant]:
    """The full plants at all operating points of the machine, and the given one if it is at
    another.
    """
    points = plant.machine.operation.envelope
    plants = [
        plant if point == plant.point else with_offsets_of(assemble(plant.machine, point), plant)
        for point in points
    ]
    return plants if any(item is plant for item in plants) else [*plants, plant]


Progress = Callable[[str], None]
_CAMPBELL_SPEEDS, _CAMPBELL_MODES = 15, 10  # points over speed; branches drawn
_FURTHER = 3  # bending modes: the outermost pole to 1e-6 of it, 5e-3 where one near moves it


def full_plants(machine: Machine) -> tuple[Plant, ...]:
    """The full finite-element plant at every operating point of the machine; the first is the one
    designs are made for.
    """
    first = machine.operation.design
    others = [point for point in machine.operation.envelope if point is not first]
    return tuple(assemble(machine, point) for point in (first, *others))


def plant_at(machine: Machine, point: str | OperatingPoint | None = None) -> Plant:
    """The full plant at an operating point, given itself or by its label or the beginning of it
    (None: the design point).

    Raises InvalidInput.
    """
    return assemble(machine, chosen_point(machine, point) or machine.operation.design)


def chosen_point(machine: Machine, point: str | OperatingPoint | None) -> OperatingPoint | None:
    return None if point is None else operating_point(machine, point)


def plants_along_speed(plant: Plant) -> Callable[[float], Plant]:
    """Speed [rad/s] -> the plant assembled anew at that speed."""
    beside = assemble(plant.machine, plant.point)
    return lambda speed: with_offsets_of(
        assemble(plant.machine, replace(plant.point, speed=speed), beside=beside), plant
    )


def small_along_speed(plant: Plant) -> Callable[[float], Plant]:
    """Speed [rad/s] -> that plant in its few bending modes that matter and ``_FURTHER``, and the
    compliance of all others at the ports.
    """
    count = default_bending_modes(plant) + _FURTHER
    count = min(count, bending_modes_of(plant.rotor_model)) if plant.machine.lateral else 0

    def at(speed: float) -> Plant:
        there = replace(plant, point=replace(plant.point, speed=speed))
        return free_mode_reduction(there, count, residual=True)

    return at


def split_covered(
    given: LawLike, plants: Sequence[Plant]
) -> tuple[tuple[Plant, ...], tuple[str, ...]]:
    """The plants that a law is meant for, and the labels of the points that it leaves out. Raises
    InvalidInput for none.
    """
    law = law_of(given)
    within = tuple(plant for plant in plants if law.covers(plant))
    if not within and law.range is not None and law.scheduled_over is not None:
        (low, high), along = law.range, law.scheduled_over
        wanted, remedy = (
            "one with an operating point of the machine in it",
            f"design over the machine's own {along.plural}",
        )
        raise invalid(
            "the scheduled range", f"{along.words(low)} to {along.words(high)}", wanted, remedy
        )
    return within, tuple(plant.point.label for plant in plants if not law.covers(plant))


def plant_gain(plant: Plant) -> Curve:
    """Largest singular value of currents -> sensors [m/A], 1 Hz to 5 kHz."""
    omega = np.geomspace(2 * np.pi, 2 * np.pi * 5000, 600)
    gain = frequency_response(
        select(plant.system, plant.named("u"), plant.named("y")), omega
    ).max_singular_value()[None]
    name = "plant gain, currents to sensors"
    return Curve(
        "plant.gain", name, "frequency", omega, gain, ("max singular value",), "rad/s", "m/A"
    )


def campbell_map(plant: Plant, controller: LawLike, progress: Progress) -> tuple[Curve, ...]:
    """Closed-loop natural frequencies and damping over the machine's running range; empty for one
    without.
    """
    low, high = plant.machine.operation.running
    if high <= low:
        return ()
    progress("following the modes over speed")
    along = campbell.campbell(
        plants_along_speed(plant),
        np.linspace(low, high, _CAMPBELL_SPEEDS),
        _CAMPBELL_MODES,
        controller,
    )
    return tuple(campbell.campbell_curves(along))


# Whether a law holds a plant: the one place that says so, of the loop as it runs.
#
# A page, a command or a stage that calls a loop stable holds a ``Stability`` of this module, or a
# check that was made with it. It computes no poles of its own for that: a map of poles, a family
# over tolerances or a run in time shows what they show, and says nothing of what they did not look
# at.


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
    (``law.loop.DEFAULT``); None where a timing is known or the law is sampled itself.
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
