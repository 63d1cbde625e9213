"""What a design may be asked for beside its method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.law.scheduling import PRESSURE, SPEED, Scheduling
from ambrose.law.timing import Timing, machine_timing, timing_of
from ambrose.machine.machine import Machine

STRUCTURES = ("free", "plane", "axis", "pid", "filters")


BACKOFF_ADVICE = "1.03 to 1.2 suits most uses"


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignOptions:
    """rate [Hz]: the loop runs sampled, its controller ``delay_samples`` late. None: as the machine
    file says; where that states no rate either, the controller is designed without delay.

    loss [-]: with a rate, the order is reduced until the worst sampled sensitivity has risen by
    this share (0.05: 5 %). order: states of the polished or the tuned controller (None: half of
    what mu needs; three per axis, six of "filters"). bending_modes: how many the design model keeps
    per plane (None: none; tuning takes all that the sensitivity is judged at, and one more).
    structure of the tuned controller: "plane" (zeta and eta kept apart where the bearings stand at
    one angle), "axis" (each alone), "free", or a filter bank: "pid" (per channel a PID and a low
    pass), "filters" (and notches). match_reference: scale the control weight until the direct gains
    below 200 Hz match the reference controller's, so that controllers are comparable (P5); None:
    where the machine has a reference controller and a constant control weight. speeds, pressures or
    both: lowest and highest [rad/s], [Pa] that a controller is scheduled over (neither: the speeds
    of the operating points with the plant's seal pressure; where there is one speed alone, their
    pressures); speed_rate [rad/s^2], pressure_rate [Pa/s]: the fastest change (None: any), for
    which gamma may be lower. tolerances: a scheduled controller is designed over them ("mu",
    "polish" and "tuned" always are). backoff [-]: how far above the smallest gamma a scheduled
    controller stays (None: 1.1; 1.2 over tolerances): nearer to 1 it is better, and faster.
    envelope: "hinf" and "mu" are designed for all operating points at once, what changes between
    them being real parameters; "hinf" is then D-K iteration over those alone. Raises InvalidInput.
    """

    rate: float | None = None
    delay_samples: int | None = None
    loss: float | None = None
    order: int | None = None
    bending_modes: int | None = None
    structure: str = "free"
    match_reference: bool | None = None
    speeds: tuple[float, float] | None = None
    speed_rate: float | None = None
    pressures: tuple[float, float] | None = None
    pressure_rate: float | None = None
    tolerances: bool = False
    backoff: float | None = None
    envelope: bool = False

    def __post_init__(self) -> None:
        if self.rate is not None:
            check_positive(self.rate, "rate", "10000 Hz is usual")
        if self.delay_samples is not None:
            _check_count(self.delay_samples, "the computing delay (delay_samples)", "1 is usual")
        if self.bending_modes is not None:
            _check_count(self.bending_modes, "bending_modes", "0 designs for the rigid rotor")
        if self.structure not in STRUCTURES:
            raise invalid(
                "structure",
                repr(self.structure),
                f"one of {', '.join(STRUCTURES)}",
                "leave the default",
            )
        if self.order is not None:
            _check_count(self.order, "order", "None leaves it to the method")
        if self.loss is not None:
            check_positive(self.loss, "loss", "0.05 allows 5 %", zero_allowed=True)
        if (
            self.backoff is not None
            and not 1 < check_positive(self.backoff, "backoff", BACKOFF_ADVICE) <= 2
        ):
            raise invalid("backoff", self.backoff, "above 1 and at most 2", BACKOFF_ADVICE)
        if self.match_reference not in (None, True, False):
            raise invalid(
                "match_reference",
                repr(self.match_reference),
                "True, False or None",
                "None decides by the machine file",
            )
        for along, ends, rate in self.schedules:
            if ends is not None:
                low, high = check_shape(ends, f"{along.name}s", "(2)")
                if not 0 <= low < high:
                    what = f"the lower {along.name}, then the higher, none negative"
                    raise invalid(
                        f"{along.name}s", f"{low:g} and {high:g} {along.unit}", what, "swap the two"
                    )
            if rate is not None:
                check_positive(
                    rate,
                    f"{along.name}_rate",
                    f"give it in {along.rate_unit}, or leave it out for any",
                )
        for along, ends, _ in self.schedules if len(self.schedules) > 1 else ():
            if ends is None:
                remedy = f"give the {along.name}s, or leave {along.name}_rate out"
                raise invalid(
                    f"{along.name}s", None, "given for a schedule over speed and pressure", remedy
                )

    @property
    def schedules(self) -> tuple[tuple[Scheduling, tuple[float, float] | None, float | None], ...]:
        """What is asked to be scheduled over: parameter, its ends and its largest rate."""
        given = (
            (SPEED, self.speeds, self.speed_rate),
            (PRESSURE, self.pressures, self.pressure_rate),
        )
        return tuple(item for item in given if item[1:] != (None, None))

    def on(self, machine: Machine) -> DesignOptions:
        """These options with the rate and the delay that hold on a machine. Raises InvalidInput for
        a loss without a rate.
        """
        timing = self.timing(machine)
        if timing is None:
            if self.loss is not None:
                raise invalid(
                    "rate",
                    None,
                    "given with a loss",
                    "say at which rate [Hz] the controller will run",
                )
            return replace(self, delay_samples=1)
        return replace(self, rate=timing.rate, delay_samples=timing.delay_samples)

    def timing(self, machine: Machine | None = None) -> Timing | None:
        """When the controller will act; None where no rate is known."""
        asked = (
            self.delay_samples
            if self.rate is not None or machine_timing(machine) is not None
            else None
        )
        return timing_of(machine, None, self.rate, asked)


def _check_count(value: Any, name: str, remedy: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise invalid(name, repr(value), "a whole number, zero or more", remedy)
