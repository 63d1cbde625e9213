"""A controller for a machine that has none yet and is to float on the rig at once.

What is asked is the loop as the rig starts it: the full plant at the nominal operating point,
sampled and late as the controller or else the machine file says.
"""

from __future__ import annotations

from ambrose.judge.result import Synthesis
from ambrose.judge.stability import Stability, judge_stability
from ambrose.law.timing import DEFAULT, timing_of
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import design


def at_the_start(machine: Machine, controller: Synthesis) -> Stability:
    """What the judge says of the loop as the rig starts it. Raises InvalidInput where the
    controller is not one for the machine.
    """
    timing = timing_of(machine, controller) or DEFAULT
    return judge_stability(assemble(machine), controller, timing)


def first_controller(machine: Machine) -> Synthesis:
    """The PID of the machine file, or one tuned for the rig's rate where the PID does not hold the
    machine there. Raises InvalidInput and NumericalFailure.
    """
    plant = assemble(machine)
    made = design(plant, "pid")
    if at_the_start(machine, made).stable:
        return made
    timing = timing_of(machine, made) or DEFAULT
    return design(plant, "tuned", rate=timing.rate, delay_samples=timing.delay_samples)


def why_lost(name: str, machine: Machine, controller: Synthesis) -> str:
    """In words, what the judge says of a controller that does not hold the machine at the start; ""
    of one that does.
    """
    held = at_the_start(machine, controller)
    if held.stable:
        return ""
    return (
        f"{name} does not hold the machine at {held.label}, {held.timing} "
        f"({held.abscissa:+.3g} 1/s); choose another one"
    )
