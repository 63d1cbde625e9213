"""Method "mu": D-K iteration over the machine's tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ambrose.synthesis.methods.weighted import SCALING_ORDER, Spanning

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.judge.result import Synthesis
    from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class Mu(Spanning):
    """D-K iteration over the machine's tolerances, and over the envelope where that is asked."""

    name: ClassVar[str] = "mu"
    title: ClassVar[str] = "mu"
    uncertain: ClassVar[bool] = True

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether the machine file has [weights] and a [[tolerance]]."""
        return plant.machine.weights is not None and bool(plant.machine.tolerances)

    def minimise(self, problem: GeneralizedPlant) -> Synthesis:
        return mu_controller(problem)


def mu_controller(problem: GeneralizedPlant) -> Synthesis:
    """The controller of a design problem by D-K iteration; of one that was solved before in this
    run, the same again: a polished controller begins as the mu controller beside it.
    """
    from ambrose.core.memory import recalled
    from ambrose.synthesis.mu.synthesis import mu_synthesis

    matrices = tuple(getattr(problem.system, letter).tobytes() for letter in "ABCD")
    key = (matrices, problem.w, problem.u, problem.z, problem.y, problem.blocks)
    return recalled("mu", key, lambda: mu_synthesis(problem, order=SCALING_ORDER))
