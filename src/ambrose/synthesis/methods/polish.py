"""Method "polish": the mu controller at a fixed lower order, refined for the worst case."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ambrose.options import count, option
from ambrose.synthesis.methods.method import Progress
from ambrose.synthesis.methods.mu import Mu, mu_controller
from ambrose.synthesis.methods.weighted import Weighted

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.judge.result import Synthesis
    from ambrose.law.weights import Weights
    from ambrose.model.plant import Plant

ROUNDS = 6  # where no sampled loop judges them


@dataclass(frozen=True, slots=True, kw_only=True)
class Polish(Weighted):
    """The mu controller reduced, then refined for the worst case over the tolerances; with a rate
    judged round by round by the worst sampled sensitivity.

    order: states (None: half of what mu needs, the delay's apart).
    """

    name: ClassVar[str] = "polish"
    title: ClassVar[str] = "mu, polished"
    uncertain: ClassVar[bool] = True
    begins_as: ClassVar[str | None] = Mu.name

    order: int | None = option(
        None, "States; default: half of what mu needs.", check=count("leave the default")
    )

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """As of mu."""
        return Mu.suits(plant)

    def minimise(self, problem: GeneralizedPlant) -> Synthesis:
        return mu_controller(problem)

    def refine(
        self,
        start: Synthesis,
        model: GeneralizedPlant,
        weights: Weights,
        plant: Plant,
        progress: Progress,
    ) -> Synthesis:
        from ambrose.law.design_problem import design_plant
        from ambrose.model.reduce import reduce
        from ambrose.synthesis.fixed_order.polish import JUDGED_ROUNDS, polish_synthesis
        from ambrose.synthesis.order_selection import sampled_sensitivity

        timing = self.timing()
        judge = None
        delay_states = 0
        if timing is not None:
            # one bending mode more than the design model has, so that spillover counts
            judge = sampled_sensitivity(reduce(plant, (self.bending_modes or 0) + 1), timing)
            delay_states = len(plant.machine.axes)
        half = (start.controller.n_states - delay_states) // 2
        result = polish_synthesis(
            design_plant(model, weights),
            start.controller,
            order=half if self.order is None else self.order,
            rounds=ROUNDS if judge is None else JUDGED_ROUNDS,
            judge=judge,
            progress=progress,
        )
        # that of the start as well, or polishing would hide it
        of_start = start.stopped_early and f"its start, by mu: {start.stopped_early}"
        early = "; ".join(filter(None, [result.stopped_early, of_start]))
        return replace(result, stopped_early=early or None)
