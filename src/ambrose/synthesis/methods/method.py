"""What every method of design has: a name, when the loop runs, and a controller for a plant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from ambrose.options import Options, count, option, percent, positive

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.law.timing import Timing
    from ambrose.machine.machine import Machine
    from ambrose.model.plant import Plant

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Method(Options, ABC):
    """One way to a controller; each of its options is a field.

    rate [Hz]: the loop runs sampled; delay_samples: from measured errors to currents set (None: as
    the machine file says, else one; where nothing states a rate, the controller is designed without
    delay). Raises InvalidInput for an option that cannot be.
    """

    name: ClassVar[str]
    title: ClassVar[str]  # for people
    begins_as: ClassVar[str | None] = None  # the method whose controller it goes on from

    rate: float | None = option(
        None,
        "Sample rate; default: the controller's or the machine file's.",
        flag="--rate-hz",
        check=positive("10000 Hz is usual"),
    )
    delay_samples: int | None = option(
        None,
        "From measured errors to currents set; default: the controller's, the machine file's, or "
        "1.",
        check=count("1 is usual", "the computing delay"),
    )

    @classmethod
    @abstractmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether a machine file states what the method needs."""

    @abstractmethod
    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        """The controller of the method for a full plant, as ``synthesis.design.design`` goes on
        with it. Its rate and delay are those of ``on``. Raises InvalidInput, NumericalFailure.
        """

    def on(self, machine: Machine) -> Self:
        """The method with the rate and the delay that hold on a machine. Raises InvalidInput."""
        timing = self.timing(machine)
        if timing is None:
            return replace(self, delay_samples=1)
        return replace(self, rate=timing.rate, delay_samples=timing.delay_samples)

    def timing(self, machine: Machine | None = None) -> Timing | None:
        """When the controller will act; None where no rate is known."""
        from ambrose.law.timing import machine_timing, timing_of

        stated = self.rate is not None or machine_timing(machine) is not None
        return timing_of(machine, None, self.rate, self.delay_samples if stated else None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lowered(Method):
    """A method whose controller may be lowered in order after its design.

    loss [-]: the order is reduced until the worst sampled sensitivity has risen by this share
    (0.05: 5 %; None: it stays). It needs a rate.
    """

    loss: float | None = option(
        None,
        "With a rate: lower the order until the worst sensitivity rises by so many percent.",
        convert=percent,
        check=positive("5 % is usual", zero_allowed=True),
    )

    def on(self, machine: Machine) -> Self:
        """As of every method. Raises InvalidInput also for a loss without a rate."""
        from ambrose.core.checks import invalid

        if self.loss is not None and self.timing(machine) is None:
            remedy = "say at which rate [Hz] the controller will run, --rate-hz"
            raise invalid("rate", None, "given with a loss", remedy)
        return Method.on(self, machine)
