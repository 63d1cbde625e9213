"""Whether a size can be held to all that is asked: limits that no controller passes first, then a
controller tuned to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ambrose.annexes.sizing.magnets import Costs, Size, costs, flux_within, need, resized
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.statespace import StateSpace
from ambrose.judge.capacity import capacity_margin
from ambrose.judge.envelope import envelope_of
from ambrose.judge.result import Synthesis
from ambrose.judge.unavoidable import beyond_reach, unavoidable_sensitivity
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.criteria import SENSITIVITY, demand
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.static_load import operating_magnets
from ambrose.synthesis.fixed_order.job import Job, Law, first_law, prepare
from ambrose.synthesis.fixed_order.tuning import INTERRUPTED, tuned
from ambrose.synthesis.methods.tuned import Tuned

CAPACITY = "load capacity"
RESERVE = 2.0  # of force over static load: two to three are usual; assumed


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A size and what became of it. ratio: the largest of all requirements over their limits, on
    the full plants at all operating points and on the worst corners found of the tolerances; at
    most 1 where all are met (inf: nothing was tuned). binding: what stands against a smaller one,
    or against this one. ratios {requirement: over its limit}; sensitivity [-] and gain [A/m] of K
    S_o that were reached; capacity: the least margin of what unbalance and loads leave, of the
    ``demand`` named; controller None where none was tuned.
    """

    size: Size
    machine: Machine
    costs: Costs
    ratio: float
    binding: str
    ratios: dict[str, float] = field(default_factory=dict)
    sensitivity: float = float("inf")
    gain: float = float("inf")
    capacity: float = float("inf")
    demand: str = ""
    synthesis: Synthesis | None = None

    @property
    def met(self) -> bool:
        return self.ratio <= 1.0

    @property
    def controller(self) -> StateSpace | None:
        return None if self.synthesis is None else self.synthesis.controller


def tuning_job(
    machine: Machine, method: Tuned, time_limit: float, order: int | None = None
) -> tuple[Job, Law]:
    """What is tuned for a machine at all its operating points, and what to begin with; its order
    does not grow.
    """
    start = pid_controller(machine.reference or first_settings(machine), machine)
    plants = envelope_of(assemble(machine, machine.operation.design))
    states = method.order if order is None else order
    job = prepare(
        plants,
        start,
        method.timing(),
        states,
        method.structure,
        method.bending_modes,
        None,
        time_limit,
        None,
    )
    job.most_states = None
    return job, first_law(job, start, states, method.structure)


def attempt(
    machine: Machine,
    size: Size,
    method: Tuned,
    *,
    reserve: float = RESERVE,
    near: Trial | None = None,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Trial:
    """Try a size of the machine's magnets and amplifiers. near: a trial whose controller is begun
    with; where that does not lead to one that meets all, the reference controller is.

    reserve [-]: force at the largest control current over static load, at least. time_limit [s] of
    computing. Raises InvalidInput where the machine file has no magnets to scale,
    KeyboardInterrupt.
    """
    price = costs(machine, size)
    found = resized(machine, size)
    words = _screened(machine, found, size, price, method, reserve)
    if words:
        return Trial(size, found, price, float("inf"), words)

    # the neighbour's controller first; the reference where that does not meet all
    best = Trial(size, found, price, float("inf"), "no controller was found")
    for start in (near, None) if near is not None else (None,):
        trial = _tuned(best, method, start, time_limit)
        if trial.ratio < best.ratio or best.synthesis is None:
            best = trial
        if best.met:
            break
    progress(
        f"{size.area:.3g} of the area, {size.bias:.3g} of the bias: {best.binding} at "
        f"{best.ratio:.3g} of its limit"
    )
    return best


def _tuned(before: Trial, method: Tuned, near: Trial | None, time_limit: float) -> Trial:
    """The trial with a controller, tuned from a neighbour's, or from the reference controller."""
    found = before.machine
    try:
        job, law = tuning_job(found, method, time_limit)
        synthesis = tuned(
            job,
            law if near is None else _scaled(near, found),
            method.structure,
            again=near is not None,
        )
    except NumericalFailure as error:
        return replace(before, binding=f"no controller was found: {error}")
    if synthesis.stopped_early == INTERRUPTED:
        raise KeyboardInterrupt

    # unbalance and loads over what bias, current, force and voltage leave
    timing = method.timing(found)
    margin, words = capacity_margin(found, synthesis.controller, timing, weight_taken=True)

    # what binds: the largest ratio of a value to its limit
    ratios = synthesis.ratios
    if np.isfinite(margin):
        ratios[CAPACITY] = 1 / margin if margin else float("inf")
    binding = max(ratios, key=lambda name: ratios[name])
    return replace(
        before,
        ratio=ratios[binding],
        binding=binding,
        ratios=ratios,
        capacity=margin,
        demand=words,
        synthesis=synthesis,
        sensitivity=ratios["sensitivity"] * job.aims.sensitivity,
        gain=synthesis.certificate.margins["ratio_gain"] * job.aims.gain,
    )


def _screened(
    given: Machine, found: Machine, size: Size, price: Costs, method: Tuned, reserve: float
) -> str:
    """Why no controller can hold a size; "" where one may."""
    if not flux_within(given, size):
        return (
            "flux density: the machine file states no iron, and its own largest current is passed"
        )
    if any(item.doubt for item in operating_magnets(found)) or price.reserve < reserve:
        return (
            f"static load: {price.reserve:.3g} times it are left at the largest current, "
            f"{reserve:.3g} are asked"
        )

    # the sensitivity that no controller avoids, given the unstable poles and the delay
    limit = (
        demand("maximum singular value of a sensitivity", found.requirements).limit
        or SENSITIVITY.limits[0].value
    )
    try:
        return beyond_reach(
            *unavoidable_sensitivity(assemble(found, found.operation.design), method.timing(found)),
            limit,
        )
    except (InvalidInput, NumericalFailure) as error:
        return str(error)


def _scaled(near: Trial, found: Machine) -> StateSpace:
    """A neighbour's controller with the gain that gives the same force per displacement, over what
    the magnets need.
    """
    # K_p k_i/k_s is kept: the gain by the mean k_s/k_i after over before
    before, after = (
        np.mean([need(item) for item in operating_magnets(machine)])
        for machine in (near.machine, found)
    )
    K = near.controller
    assert K is not None
    return StateSpace(K.A, K.B, after / before * K.C, after / before * K.D, K.inputs, K.outputs)
