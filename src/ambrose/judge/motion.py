"""What moves while the machine runs, and who proves a loop along it: proofs are registered by the
annexes that hold them (``ambrose.registry``, kind "moving_proof"), the judge knows none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, cast

from ambrose.core.checks import InvalidInput, check_finite, check_positive
from ambrose.judge.checks import Checks
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine
from ambrose.registry import registered, resolve

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Motion:
    """How fast a machine may move between its operating points.

    pressure_rate [Pa/s]: the fastest change of the seal pressure (None: the machine file's; without
    one nothing is proved for a pressure that changes). pressure_error [Pa]: how far off what a
    controller scheduled over the pressure is told may be. speed_rate [rad/s^2]: the fastest run-up
    (None: nothing is proved for a speed that changes).
    """

    pressure_rate: float | None = None
    pressure_error: float = 0.0
    speed_rate: float | None = None

    def __post_init__(self) -> None:
        rates = (("pressure_rate", "Pa/s"), ("speed_rate", "rad/s^2"))
        for name, unit in rates:
            if getattr(self, name) is not None:
                remedy = f"give the fastest change in {unit}, or leave it out"
                check_positive(getattr(self, name), name, remedy)
        check_finite(self.pressure_error, "pressure_error [Pa]")


class MovingProof(Protocol):
    """A registered proof: a module or object with these three."""

    def refuse(self, machine: Machine, law: Law, motion: Motion) -> None:
        """Raises InvalidInput where the motion that is asked for cannot be examined."""

    def prove(
        self,
        machine: Machine,
        law: Law,
        points: Sequence[Checks],
        timing: Timing | None,
        motion: Motion,
        *,
        tolerances: bool,
        progress: Progress,
    ) -> tuple[Checks, ...]:
        """The checks along the motion; ``points``: those at the operating points."""

    def unproved(self, machine: Machine, motion: Motion) -> str | None:
        """Of what could move and is not proved, a sentence for people; None where there is none."""


def moving_proofs() -> tuple[MovingProof, ...]:
    """The proofs of this installation."""
    return tuple(cast(MovingProof, resolve(place)) for place in registered("moving_proof").values())


def refuse_motion(machine: Machine, law: LawLike, motion: Motion) -> None:
    """Raises InvalidInput, before anything is computed, where a motion cannot be examined."""
    proofs = moving_proofs()
    if not proofs and (motion.pressure_rate or motion.speed_rate or motion.pressure_error):
        raise InvalidInput(
            "this installation holds no proof for a speed or pressure that changes; leave the "
            "rates out, or install the annex of schedules"
        )
    for proof in proofs:
        proof.refuse(machine, law_of(law), motion)
