"""When a controller acts: its sample rate and its computing delay, one answer for design,
verification, simulation and code.

The displacements are read at sample k, the currents computed from them are set ``delay_samples``
later and held. What is given by the caller goes before the controller's own rate, that before the
rate it was designed for, and the machine file comes last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ambrose.core.checks import SAME_CLOCK, check_positive, invalid, same_clock
from ambrose.core.sampling import c2d, delayed, pade
from ambrose.core.statespace import StateSpace, append, series
from ambrose.law.law import Law, LawLike, law_of
from ambrose.machine.limits import DELAY_SAMPLES
from ambrose.machine.machine import Machine

_PADE_ORDER = 2  # 1.5 samples at 10 kHz: 1e-4 degrees off at 200 Hz, 0.3 at 1 kHz


@dataclass(frozen=True, slots=True)
class Timing:
    """A controller runs every ``sample_time`` [s]; its currents act ``delay_samples`` (0, 1, ...)
    later. source: who says so.

    Raises InvalidInput.
    """

    sample_time: float
    delay_samples: int = 1
    source: str = "given"

    def __post_init__(self) -> None:
        check_positive(self.sample_time, "the sample time", "give it in seconds")
        if (
            isinstance(self.delay_samples, bool)
            or not isinstance(self.delay_samples, int)
            or self.delay_samples < 0
        ):
            least = "a whole number of samples, zero or more"
            raise invalid(
                "the computing delay (delay_samples)", repr(self.delay_samples), least, "1 is usual"
            )
        if self.delay_samples > DELAY_SAMPLES:  # each is a state of every axis
            raise invalid(
                "delay_samples", self.delay_samples, f"at most {DELAY_SAMPLES}", "1 is usual"
            )

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return 1 / self.sample_time

    @property
    def lag(self) -> float:
        """By how much the currents are late on average [s]: computing, and half a sample of
        holding.
        """
        return (self.delay_samples + 0.5) * self.sample_time

    def in_loop(self, law: StateSpace) -> StateSpace:
        """A fixed law as the loop sees it: sampled by Tustin's map unless it is, and late. Raises
        InvalidInput.
        """
        if law.dt is not None and not same_clock(law.dt, self.sample_time):
            remedy = "leave the rate out, or give the continuous controller"
            raise invalid(
                "the controller's sample time", f"{law.dt:g} s", f"{self.sample_time:g} s", remedy
            )
        sampled = law if law.dt is not None else c2d(law, self.sample_time, "tustin")
        return delayed(sampled, self.delay_samples)

    def late(self, law: StateSpace) -> StateSpace:
        """A continuous law with the loop's mean delay as a second-order Pade all-pass on every
        input (two states each).
        """
        passes = append(*[pade(self.lag, _PADE_ORDER, name, name) for name in law.inputs])
        return series(passes, law)

    def __str__(self) -> str:
        delay = "1 sample" if self.delay_samples == 1 else f"{self.delay_samples} samples"
        return f"sampled at {self.rate:.6g} Hz, {delay} late ({self.source})"


DEFAULT = Timing(1e-4, 1, "assumed: nothing says it")  # where a rate is needed and nobody knows one
STATE_RATE = "state the rate that it runs at, sample_time in [controller] or --rate-hz"


def machine_timing(machine: Machine | None) -> Timing | None:
    """What the machine file says: [controller] sample_time and delay (None: what the elements of
    [[chain]] take together, one sample without any); None where it states no rate.

    A fraction of a sample, as identification may find it, is rounded up: outputs are set when a
    sample is taken.
    """
    settings = None if machine is None else machine.controller
    if settings is None or settings.sample_time is None:
        return None
    seconds = settings.delay
    if seconds is None and machine is not None and machine.chain:
        seconds = sum(element.dead_time for element in machine.chain)
    delay = 1.0 if seconds is None else seconds / settings.sample_time
    whole = math.ceil(delay - SAME_CLOCK * max(delay, 1.0))
    rounded = (
        f", {delay:.3g} rounded up" if abs(delay - whole) > SAME_CLOCK * max(delay, 1.0) else ""
    )
    return Timing(settings.sample_time, whole, f"machine file{rounded}")


def timing_of(
    machine: Machine | None,
    law: LawLike | None = None,
    rate: float | None = None,
    delay_samples: int | None = None,
) -> Timing | None:
    """When a controller acts on a machine, None where nothing says it.

    law: what controls, such as a Synthesis, or None. rate [Hz], delay_samples: given by the caller,
    who is heard first; then the sample time of a sampled law, then the rate that it was designed
    for, then the machine file. A delay that is not given is that of the same source, else the
    machine's, else one sample. Raises InvalidInput.
    """
    of_machine = machine_timing(machine)
    timing = of_machine
    if rate is None and law is not None:
        timing = _timing_of_law(law_of(law), of_machine)
    elif rate is not None:
        program = None if law is None else law_of(law).program
        delay = _delay(of_machine) if program is None else program.delay
        timing = Timing(1 / check_positive(rate, "rate", "give the sample rate in Hz"), delay)
    if delay_samples is None:
        return timing
    if timing is None:
        raise invalid(
            "delay_samples",
            delay_samples,
            "given with a rate",
            "say at which rate [Hz] the controller runs",
        )
    overridden = delay_samples != timing.delay_samples and timing.source != "given"
    return Timing(
        timing.sample_time,
        delay_samples,
        f"{timing.source}, delay given" if overridden else timing.source,
    )


def _timing_of_law(law: Law, of_machine: Timing | None) -> Timing | None:
    """What a law says of itself, else what the machine file says."""
    delay = _delay(of_machine) if law.program is None else law.program.delay
    delay = delay if law.delay_samples is None else law.delay_samples
    if law.sample_time is not None:
        return Timing(float(law.sample_time), delay, "the controller's own")
    if law.rate:
        return Timing(1 / law.rate, delay, "what it was designed for")
    return of_machine


def _delay(of_machine: Timing | None) -> int:
    return 1 if of_machine is None else of_machine.delay_samples


def check_clock(dt: float, timing: Timing, what: str) -> None:
    """Refuses records whose sample time dt [s] is not that of the loop; what: which records. Raises
    InvalidInput.
    """
    if same_clock(dt, timing.sample_time):
        return
    slower = dt > timing.sample_time
    remedy = "record every sample, or give" if slower else "give"
    raise invalid(
        f"the sample rate of {what}",
        f"{1 / dt:g} Hz",
        f"the controller's, {timing.rate:g} Hz",
        f"{remedy} the controller that ran, or its sample_time in [controller]",
    )
