"""What stands between the displacement and the current, as the machine file has it: [[chain]]."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from ambrose.machine.kinds import Choice, Count, Name, Rate, Time
from ambrose.machine.part import Part

CHAIN_KINDS = ("demodulation", "anti-alias", "adc", "computation", "pwm")


@dataclass(frozen=True, slots=True, repr=False)
class ChainElement(Part):
    """One element of the signal chain: a dead time, or a Butterworth filter that counts in the loop
    by its delay at low frequencies.

    Together they are what the loop's delay is made of (``law.timing``); lags of sensors and
    amplifiers stand in their own tables.
    """

    name: Annotated[Name, "name, different from the other elements'"]
    kind: Annotated[str, Choice(CHAIN_KINDS), "what it is"] = field(metadata={"required": True})
    delay: Annotated[Time | None, "its dead time; or give a corner"] = None
    corner: Annotated[Rate | None, "corner frequency of a filter; or give a delay"] = None
    order: Annotated[int, Count(), "order of the filter (Butterworth)"] = 2

    @property
    def dead_time(self) -> float:
        """Its delay at low frequencies [s].

        The poles of a Butterworth filter give tau(0) = sum of -1/p = 1/(w_c sin(pi/(2 n))).
        """
        if self.corner is None:
            return self.delay or 0.0
        return 1 / (self.corner * math.sin(math.pi / (2 * self.order)))

    def phase(self, omega: float) -> float:
        """Its phase [rad] at omega [rad/s], as it is; negative: late."""
        if self.corner is None:
            return -omega * (self.delay or 0.0)
        # poles p = w_c e^{j theta}, theta = pi/2 + pi (2 k - 1)/(2 n): arg(-p/(j w - p)), summed
        total = 0.0
        for k in range(1, self.order + 1):
            angle = math.pi / 2 + math.pi * (2 * k - 1) / (2 * self.order)
            real = -self.corner * math.cos(angle)
            total -= math.atan2(omega - self.corner * math.sin(angle), real)
        return total
