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

    bending_modes: how many the design model keeps per plane (None: as many as the full plant shows
    to matter, ``synthesis.design_modes``). match_reference: scale the control weight until the
    direct gains below 200 Hz match the reference controller's, so that controllers are comparable
    (P5); None: where the machine has a reference controller and a constant control weight, and the
    gains can be matched by a controller that holds the full plant as the loop runs. Where a rate is
    known the design model has its delay, and poles beyond half of it are residualised.
    """

    uncertain: ClassVar[bool]  # whether it is designed over the machine's tolerances

    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the design model; default: those without which a design does "
        "not hold the full plant.",
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
        from ambrose.law.weights import machine_weights
        from ambrose.machine.criteria import SENSITIVITY, demand
        from ambrose.synthesis.design_modes import modes_that_matter

        machine = plant.machine
        weights = machine_weights(machine)
        if self.bending_modes is None:
            modes = modes_that_matter(plant, weights, self.timing(), progress)
            return replace(self, bending_modes=modes).design(plant, progress)
        matched = self._matched(machine)
        result, peak = self._designed(plant, weights, matched, progress)
        quantity = "maximum singular value of a sensitivity"
        limit = demand(quantity, machine.requirements).limit or SENSITIVITY.limits[0].value
        if not matched or self.match_reference or peak <= limit:
            return result

        # comparable gains were nobody's wish: the file's own weights, where they do better
        progress("the reference's direct gains do not hold it: the file's own control weight")
        own, reached = self._designed(plant, weights, False, progress)
        if not reached < peak or (reached > limit and peak < float("inf")):
            return result
        words = "unstable" if peak == float("inf") else f"at sigma_max(S_o) {peak:.3g}"
        note = f"with the reference's direct gains it would be {words}: the file's control weight"
        return replace(own, notes=(*own.notes, note))

    def _designed(
        self, plant: Plant, weights: Weights, matched: bool, progress: Progress
    ) -> tuple[Synthesis, float]:
        """The controller with so many modes in its model, judged on the full plant; its
        sigma_max(S_o) there as the loop runs, inf where it is unstable.
        """
        from ambrose.judge.as_it_runs import sampled_margins, without_fast_poles
        from ambrose.judge.certificate import certify_on_full_plant
        from ambrose.law.design_problem import design_plant
        from ambrose.law.pid import pid_controller
        from ambrose.model.reduce import reduce
        from ambrose.synthesis.weight_tuning import direct_gain_mismatch

        machine, timing = plant.machine, self.timing()
        model, uncertain = self.design_model(plant)
        reference = pid_controller(machine.reference, machine) if machine.reference else None
        margins = _left_out(machine, progress) if self.uncertain else {}
        if self.bending_modes:
            margins["bending_modes"] = float(self.bending_modes)
        if matched:
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
        result = certify_on_full_plant(plant, replace(result, weights=weights), margins)
        found = sampled_margins(plant, result, timing)
        full = result.certificate.margins["full_sensitivity_peak"]
        return result, float(found.get("sampled_sensitivity_peak", full))

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
