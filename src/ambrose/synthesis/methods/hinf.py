"""Method "hinf": H-infinity for the nominal plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ambrose.synthesis.methods.weighted import SCALING_ORDER, Spanning

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.judge.result import Synthesis
    from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class Hinf(Spanning):
    """H-infinity for the nominal plant; over the envelope, D-K iteration over what changes between
    the operating points.
    """

    name: ClassVar[str] = "hinf"
    title: ClassVar[str] = "H-infinity"
    uncertain: ClassVar[bool] = False

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether the machine file has [weights]."""
        return plant.machine.weights is not None

    def minimise(self, problem: GeneralizedPlant) -> Synthesis:
        from ambrose.synthesis.hinf.synthesis import hinf_synthesis
        from ambrose.synthesis.mu.synthesis import mu_synthesis

        if self.envelope:
            return mu_synthesis(problem, order=SCALING_ORDER)
        return hinf_synthesis(problem)
