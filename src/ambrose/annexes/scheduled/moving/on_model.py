"""Verification on a reduced model while the seal pressure changes: of a schedule that reads it with
an error, or of a fixed law.

The proof is of the model of moving/model.py, with as many bending modes as it takes to agree with
the full plant's sensitivities at constant pressure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.annexes.scheduled.moving.law import moving_law
from ambrose.annexes.scheduled.moving.model import (
    UnstableAtRest,
    choose_model,
    prove_on_model,
    told_range,
)
from ambrose.annexes.scheduled.moving.spans import (
    FROZEN,
    REST,
    PressureSpan,
    Tell,
    judged_rate,
    pressure_spans,
)
from ambrose.core.checks import AmbroseError, check_positive
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge.checks import Checks
from ambrose.judge.criteria import information
from ambrose.law.law import LawLike
from ambrose.law.timing import Timing
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble


def check_on_model(
    machine: Machine,
    span: PressureSpan,
    law: LawLike,
    timing: Timing | None,
    rate: float,
    error: float = 0.0,
    tell: Tell = lambda text: None,
) -> Checks:
    """Stability and output sensitivity while the pressure moves at up to ``rate`` [Pa/s] and is
    measured within ``error`` [Pa].

    law: continuous; a schedule over pressure that covers the span, or fixed. The proof for the rate
    is judged by the machine's requirement; where there is none, its value is inf and its detail
    says why.
    Raises InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    check_positive(error, "the error of the pressure", "give it in Pa", zero_allowed=True)
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    label = span.label + (f", told to {error / 1e5:.4g} bar" if error else "")

    def not_proved(why: str, stable: bool = True) -> Checks:
        return Checks(label, stable, (judged_rate(wanted, rate, np.inf, f"not proved: {why}"),))

    plant = assemble(machine, span.middle)
    moving = moving_law(law, plant)
    if moving.dt is not None:
        return not_proved("the controller is sampled; give the continuous one that it was made of")
    try:
        pairs = [
            (p, reported)
            for reported in np.linspace(*told_range(span, moving, error), FROZEN)
            for p in _true_pressures(reported, error, span)
        ]
        lag = 0.0 if timing is None else timing.lag
        model = choose_model(plant, span, law, lag, pairs)
        at = (
            f"the worst of {len(pairs)} pairs, at {model.held[0] / 1e5:.4g} bar told as "
            f"{model.held[1] / 1e5:.4g} bar"
        )
        title = "Largest output sensitivity while the pressure stands still, found, full plant"
        checks = [information("moving.frozen", title, model.full_gain, "-", at)]
        tell(f"proving the loop {label}, at up to {rate / 1e5:.4g} bar/s")
        value, words = prove_on_model(model, rate, error, tell)
    except AmbroseError as failure:
        return not_proved(str(failure), stable=not isinstance(failure, UnstableAtRest))
    checks.append(judged_rate(wanted, rate, value, words))
    return Checks(label, True, tuple(checks), notes=(REST,))


def _true_pressures(reported: float, error: float, span: PressureSpan) -> tuple[float, ...]:
    """Pressures of the span that the sensor may report as this one: the ends of the band
    ``reported`` +- error [Pa], and what lies nearest in the span.
    """
    nearest = min(max(reported, span.low), span.high)
    return tuple(
        sorted({max(span.low, reported - error), nearest, min(span.high, reported + error)})
    )


def scheduled_spans(machine: Machine, law: ScheduledSystem) -> tuple[PressureSpan, ...]:
    """The spans of pressure that a schedule over pressure covers, cut at its ends."""
    low, high = law.range
    cut = (
        replace(span, low=max(low, span.low), high=min(high, span.high))
        for span in pressure_spans(machine)
    )
    return tuple(span for span in cut if span.low < span.high)
