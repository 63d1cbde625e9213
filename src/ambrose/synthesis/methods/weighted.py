"""What H-infinity, mu and polished mu share: the machine's weights, and a reduced design model."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ambrose.options import count, option
from ambrose.synthesis.methods.method import Lowered, Progress

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.core.statespace import StateSpace
    from ambrose.judge.result import Synthesis
    from ambrose.law.weights import Weights
    from ambrose.machine.machine import Machine
    from ambrose.model.plant import Plant

SCALING_ORDER = 1  # d(s) I of first order for mu: 20 -> 24 states on the seal rig, as in P5


@dataclass(frozen=True, slots=True, kw_only=True)
class Weighted(Lowered):
    """A method that minimises a norm of the loop with the machine's weights.

    bending_modes: how many the design model keeps per plane (None: none). match_reference: scale
    the control weight until the direct gains below 200 Hz match the reference controller's, so that
    controllers are comparable (P5); None: where the machine has a reference controller and a
    constant control weight. Where a rate is known the design model has its delay, and poles beyond
    half of it are residualised.
    """

    uncertain: ClassVar[bool]  # whether it is designed over the machine's tolerances

    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the design model; default: none.",
        check=count("0 designs for the rigid rotor"),
    )
    match_reference: bool | None = option(
        None,
        "Scale the control weight until the direct gains match the reference PID's; default: with "
        "a constant weight.",
        flag="--match-reference/--own-gain",
        choices=(True, False),
    )

    @abstractmethod
    def minimise(self, problem: GeneralizedPlant) -> Synthesis:
        """The controller of a design problem."""

    def refine(
        self,
        start: Synthesis,
        model: GeneralizedPlant,
        weights: Weights,
        plant: Plant,
        progress: Progress,
    ) -> Synthesis:
        """What becomes of the controller of a design model, at its final weights."""
        return start

    def design_model(self, plant: Plant) -> tuple[GeneralizedPlant, bool]:
        """The reduced plant, late, and whether it holds uncertain parameters."""
        from ambrose.law.design_problem import apply_delay, design_tolerances, open_model
        from ambrose.model.reduce import reduce

        tolerances = design_tolerances(plant.machine) if self.uncertain else None
        small = reduce(plant, self.bending_modes or 0)
        return apply_delay(open_model(small, tolerances, self.uncertain), self.lag), self.uncertain

    @property
    def lag(self) -> float:
        """By how much the currents are late on average [s]."""
        timing = self.timing()
        return 0.0 if timing is None else timing.lag

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.judge.as_it_runs import without_fast_poles
        from ambrose.judge.certificate import certify_on_full_plant
        from ambrose.law.design_problem import design_plant
        from ambrose.law.weights import machine_weights
        from ambrose.model.reduce import reduce
        from ambrose.synthesis.pid import pid_controller
        from ambrose.synthesis.weight_tuning import direct_gain_mismatch

        machine, weights, timing = plant.machine, machine_weights(plant.machine), self.timing()
        model, uncertain = self.design_model(plant)
        reference = pid_controller(machine.reference, machine) if machine.reference else None
        margins = _left_out(machine, progress) if self.uncertain else {}
        if self._matched(machine):
            result, weights = _as_strong(
                model, weights, reference, self.minimise, uncertain, progress
            )
        else:
            result = self.minimise(design_plant(model, weights, uncertain=uncertain))
        result = self.refine(result, model, weights, plant, progress)
        if timing is not None:
            nominal = design_plant(reduce(plant, self.bending_modes or 0), weights, uncertain=False)
            result = without_fast_poles(result, timing, nominal)
        if reference is not None:  # of the controller that is returned: polishing moves it
            margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
        return certify_on_full_plant(plant, replace(result, weights=weights), margins)

    def _matched(self, machine: Machine) -> bool:
        if self.match_reference is not None:
            return self.match_reference
        weights = machine.weights
        return (
            machine.reference is not None
            and weights is not None
            and weights.control_crossover is None
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Spanning(Weighted):
    """A weighted method that can be designed for all operating points at once.

    envelope: what changes between the points are real parameters of the design model, beside the
    tolerances where the method has them.
    """

    envelope: bool = option(False, "For all operating points at once.")

    def design_model(self, plant: Plant) -> tuple[GeneralizedPlant, bool]:
        """The reduced plant or the whole envelope, late, and whether it is uncertain."""
        if not self.envelope:
            return Weighted.design_model(self, plant)
        from ambrose.judge.envelope import envelope_of
        from ambrose.law.design_problem import apply_delay, design_tolerances
        from ambrose.model.reduce import free_mode_reduction
        from ambrose.synthesis.envelope_model import envelope_model

        modes = self.bending_modes or 0
        points = [free_mode_reduction(item, modes) for item in envelope_of(plant)]
        tolerances = design_tolerances(plant.machine) if self.uncertain else None
        return apply_delay(envelope_model(points, tolerances), self.lag), True


def _left_out(machine: Machine, progress: Progress) -> dict[str, float]:
    """The margin that says how many tolerances were designed over; empty where all were."""
    from ambrose.law.design_problem import LEAST_TOLERANCE, design_tolerances

    wide = design_tolerances(machine)
    if len(wide) == len(machine.tolerances):
        return {}
    names = ", ".join(item.parameter for item in wide)
    progress(
        f"designing for {names}; tolerances below {LEAST_TOLERANCE:.0%} are left to verification"
    )
    return {"design_tolerances": float(len(wide))}


def _as_strong(
    model: GeneralizedPlant,
    weights: Weights,
    reference: StateSpace | None,
    minimise: Callable[[GeneralizedPlant], Synthesis],
    uncertain: bool,
    progress: Progress,
) -> tuple[Synthesis, Weights]:
    """The controller whose direct gains are the reference's, and its weights."""
    from ambrose.core.checks import invalid
    from ambrose.synthesis.weight_tuning import tune_control_weight

    if reference is None:
        raise invalid(
            "match_reference",
            True,
            "False without a [controller] table",
            "add the reference controller",
        )
    tuned = tune_control_weight(model, weights, reference, minimise, uncertain=uncertain)
    progress(
        f"control weight times {tuned.factor:.3g}: direct gains {100 * tuned.mismatch:+.1f} % "
        "of the reference's"
    )
    return tuned.synthesis, tuned.weights
