"""The proofs along a moving speed and a moving pressure, as the judge asks for them."""

from __future__ import annotations

from collections.abc import Sequence

from ambrose.annexes.scheduled.moving.on_model import check_on_model, scheduled_spans
from ambrose.annexes.scheduled.moving.pressure import check_pressure, covered_spans
from ambrose.annexes.scheduled.moving.spans import pressure_spans
from ambrose.annexes.scheduled.moving.speed import SpeedSpan, check_speed, speed_spans
from ambrose.core.checks import InvalidInput, invalid
from ambrose.judge.checks import Checks
from ambrose.judge.motion import Motion, Progress
from ambrose.law.law import Law
from ambrose.law.scheduling import PRESSURE, SPEED
from ambrose.law.timing import Timing
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.machine import Machine


def refuse(machine: Machine, law: Law, motion: Motion) -> None:
    """Raises InvalidInput where a law cannot be examined along the motion that is asked for."""
    if motion.speed_rate is not None:
        across_the_shaft(
            machine, "nothing along it follows the speed", "leave the speed's rate out"
        )
    if motion.pressure_rate is not None:
        remedy = "leave the pressure's rate out; the process thrust changes within load_time"
        across_the_shaft(machine, "nothing along it follows the seals' pressure", remedy)
    _over_pressure(law, motion.pressure_error)
    if motion.speed_rate is not None:
        _speed_spans(machine, law)


def prove(
    machine: Machine,
    law: Law,
    points: Sequence[Checks],
    timing: Timing | None,
    motion: Motion,
    *,
    tolerances: bool,
    progress: Progress,
) -> tuple[Checks, ...]:
    """The checks while the seal pressure changes, then those while the speed does.

    Without a rate, or with an unstable operating point, there are none. Raises InvalidInput as
    ``refuse`` does.
    """
    if not all(checks.stable for checks in points):
        return ()
    checks = _along_pressure(machine, law, timing, motion, progress)
    if motion.speed_rate is None:
        return checks
    runs = (
        check_speed(machine, span, law, timing, motion.speed_rate, tolerances, progress)
        for span in _speed_spans(machine, law)
    )
    return (*checks, *runs)


def unproved(machine: Machine, motion: Motion) -> str | None:
    """Why nothing is proved for a pressure that changes between the operating points of a machine,
    as a sentence; None where no operating points differ in pressure.
    """
    if not pressure_spans(machine):
        return None
    known = motion.pressure_rate is not None or machine.operation.pressure_rate is not None
    remedy = (
        "the loop must hold every point, with a law that is fixed or scheduled over pressure"
        if known
        else "give --pressure-rate or the file's pressure_rate"
    )
    return f"Nothing is proved for a seal pressure that changes: {remedy}."


def _along_pressure(
    machine: Machine, law: Law, timing: Timing | None, motion: Motion, progress: Progress
) -> tuple[Checks, ...]:
    """The checks while the pressure changes at up to the rate given or that of the machine file.

    There are none for a schedule over speed, or over speed and pressure, and none for a program or
    a function that follows the pressure.
    """
    rate = motion.pressure_rate
    if rate is None:
        rate = machine.operation.pressure_rate
    if rate is None:
        return ()
    schedule = law.schedule
    if schedule is None and law.follows(PRESSURE):
        return ()  # a function or a program: at the pressure of a span's middle it is another law
    if schedule is None:
        return tuple(
            check_pressure(machine, span, law, timing, rate, progress)
            for span in covered_spans(machine, law)
        )
    error = motion.pressure_error
    spans = scheduled_spans(machine, schedule) if _over_pressure(law, error) else ()
    return tuple(
        check_on_model(machine, span, law, timing, rate, error, progress) for span in spans
    )


def _speed_spans(machine: Machine, law: Law) -> tuple[SpeedSpan, ...]:
    """Where a fixed law or a schedule over speed is proved while the speed changes.

    Raises InvalidInput where it cannot be.
    """
    if law.fixed is None and law.scheduled_over is not SPEED:
        raise InvalidInput(
            "a controller scheduled over pressure is not proved while the speed changes; leave "
            "the speed's rate out"
        )
    if law.fixed is None and law.schedule is None:
        raise InvalidInput(
            "a function of the speed is not proved while the speed changes; make it a schedule "
            "(ScheduledSystem), or leave the speed's rate out"
        )
    spans = speed_spans(machine, law)
    if not spans:
        raise InvalidInput(
            "no two operating points differ in speed alone; add one in the machine file, or leave "
            "the speed's rate out"
        )
    return spans


def _over_pressure(law: Law, error: float) -> bool:
    """Whether a law is scheduled over pressure alone.

    Raises InvalidInput for an error [Pa] where it is not.
    """
    over_pressure = law.schedule is not None and law.scheduled_over is PRESSURE
    if error and not over_pressure:
        why = "alone is proved with it" if law.follows(PRESSURE) else "is told of it"
        raise invalid(
            "the error of the pressure",
            f"{error:g} Pa",
            "0",
            f"only a controller scheduled over pressure {why}",
        )
    return over_pressure
