"""Verification of a fixed controller while the seal pressure changes: the full plant as it runs, and closer, a model of it."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import AmbroseError, NumericalFailure, check_positive
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.core.varying.loop import VaryingLoop
from ambrose.core.varying.proof import Proof, proved_gain
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import match_controller
from ambrose.plant.timing import Timing
from ambrose.verification.checks import Checks
from ambrose.verification.criteria import information
from ambrose.verification.moving.pressure import (
    FROZEN,
    PressureSpan,
    Tell,
    filter_poles,
    frozen_peaks,
    judged_rate,
    pressure_loop,
)
from ambrose.verification.moving.schedule import SAME, check_schedule


def check_pressure(
    machine: Machine, span: PressureSpan, law: StateSpace, timing: Timing | None, rate: float, tell: Tell = lambda text: None
) -> Checks:
    """Stability and output sensitivity while the pressure moves within the span, at any speed and at up to ``rate`` [Pa/s].

    law: a controller as for ``plant.loop.match_controller``. Proved is the full plant, of a sampled loop as it runs; where that
    is more than 0.5 % above what was found at rest, a model of it as for ``schedule``, too. The better for the rate is judged
    by the machine's requirement; one that cannot be had has the value inf and says why. Raises InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    plant = assemble(machine, span.middle)
    try:
        loop = pressure_loop(plant, span, law, timing)
        frozen = frozen_peaks(plant, span, law, timing)
    except AmbroseError as error:
        wanted = demand("maximum singular value of a sensitivity", machine.requirements)
        return Checks(span.label, True, (judged_rate(wanted, rate, np.inf, f"not proved: {error}"),))
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    where = f"the worst of {FROZEN} pressures, at {frozen.pressure / 1e5:.4g} bar" if frozen.stable else "unstable"
    title = "Largest output sensitivity while the pressure stands still, found"
    checks = [information("moving.frozen", title, frozen.gain, "-", where)]
    if not frozen.stable:
        return Checks(
            span.label, False, (*checks, judged_rate(wanted, rate, np.inf, "a pressure that stands still is unstable"))
        )
    tell(f"proving the loop {span.label}, at any speed")
    value, detail = _proof(loop, (), np.inf, tell)
    title = "Output sensitivity proved for any motion of the pressure, however fast"
    checks.append(information("moving.sensitivity.any", title, value, "-", detail))
    tell(f"proving the loop {span.label}, at up to {rate / 1e5:.4g} bar/s")
    bounded, words = _proof(loop, filter_poles(frozen, int(np.bincount(loop.owner).max())), rate / span.half, tell)
    if value < bounded:  # what holds for any speed holds for this one
        bounded, words = value, detail
    words = f"{words}; {bounded / frozen.gain - 1:.1%} above what was found at rest"
    if bounded > (1 + SAME) * frozen.gain and (fixed := match_controller(law, plant)).dt is None:
        still = ScheduledSystem([span.low, span.high], [fixed, fixed], "pressure", "Pa")
        closer = check_schedule(machine, span, still, timing, rate, tell=tell).checks[-1]
        title = f"Output sensitivity proved for up to {rate / 1e5:.4g} bar/s on a model"
        checks.append(information("moving.sensitivity.model", title, closer.value, "-", closer.detail))
        if closer.value < bounded:
            bounded, words = closer.value, f"{closer.detail}; full plant: {words}"
    checks.append(judged_rate(wanted, rate, bounded, words))
    note = "proved is the energy gain from disturbances of the measurement to the measurement, which is sigma_max(S_o) at rest"
    return Checks(span.label, True, tuple(checks), notes=(note,))


def _proof(loop: VaryingLoop, poles: tuple[float, ...], rate: float, tell: Tell) -> tuple[float, str]:
    try:
        found: Proof = proved_gain(loop, poles, [rate] * loop.parameters, tell=tell)
    except NumericalFailure as error:
        return np.inf, f"not proved: {error}"
    size = f"full plant, {len(loop.A)} states" + (
        f" and {loop.controller.n_states} of the sampled law" if loop.controller else ""
    )
    return found.gamma, f"{size}; the inequality holds by {found.slack:.0e}, rounding {found.rounding:.0e}"
