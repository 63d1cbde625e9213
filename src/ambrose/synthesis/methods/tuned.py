"""Method "tuned": one controller of fixed order for the whole envelope, to the requirements."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from ambrose.options import count, option
from ambrose.synthesis.methods.method import Method, Progress

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.law.timing import Timing
    from ambrose.machine.machine import Machine
    from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned(Method):
    """Tuned to the machine's requirements at every operating point, with the worst members of the
    tolerances around each, from its PID or a first guess.

    order: states (None: three per axis; of "filters" six). structure: "free", "plane" (zeta and eta
    kept apart where the bearings stand at one angle), "axis" (each alone), or a filter bank: "pid"
    (per channel a PID and a low pass), "filters" (and notches). bending_modes: per plane in the
    models that it is tuned on (None: all below the frequency up to which sensitivity is judged, and
    one more). match_reference: the direct gains below 200 Hz stay near those of the reference
    controller.
    """

    name: ClassVar[str] = "tuned"
    title: ClassVar[str] = "tuned"

    order: int | None = option(
        None, "States; default: three per axis, of filters six.", check=count("leave the default")
    )
    structure: str = option(
        "free",
        "Which axes share a part of the controller, or a filter bank per channel.",
        choices=("free", "plane", "axis", "pid", "filters"),
    )
    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the design model; default: all that matter.",
        check=count("0 designs for the rigid rotor"),
    )
    match_reference: bool | None = option(
        None,
        "Keep the direct gains near the reference PID's.",
        flag="--match-reference/--own-gain",
        choices=(True, False),
    )

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Always."""
        return True

    def without_bank(self) -> Self:
        """The method itself, for what tunes a controller step by step. Raises InvalidInput for a
        filter bank.
        """
        from ambrose.core.checks import invalid

        if self.structure in {"pid", "filters"}:
            remedy = "a bank is tuned by the design itself"
            raise invalid("structure", self.structure, "free, plane or axis", remedy)
        return self

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.judge.certificate import full_plant_margins
        from ambrose.judge.envelope import envelope_of
        from ambrose.law.pid import first_settings, pid_controller
        from ambrose.synthesis.fixed_order.tuning import tune_controller
        from ambrose.synthesis.weight_tuning import direct_gain_mismatch

        machine = plant.machine
        start = machine.reference or first_settings(machine)
        reference = pid_controller(start, machine)
        result = tune_controller(
            envelope_of(plant),
            start,
            self.timing(),
            order=self.order,
            structure=self.structure,
            bending_modes=self.bending_modes,
            reference=reference if self.match_reference else None,
            progress=progress,
        )
        _, margins, _ = full_plant_margins(plant, result.controller)
        if machine.reference is not None:
            margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
        certificate = replace(result.certificate, margins={**result.certificate.margins, **margins})
        return with_capacity(replace(result, certificate=certificate), machine, self.timing())


def with_capacity(result: Synthesis, machine: Machine, timing: Timing | None) -> Synthesis:
    """A synthesis, with what residual unbalance and loads of the file take of the magnets among its
    ratios, as ``size`` counts it.
    """
    from ambrose.judge.capacity import capacity_margin
    from ambrose.machine.axial import AxialMachine

    if isinstance(machine, AxialMachine) or not result.certificate.stable:
        return result
    margin, words = capacity_margin(machine, result.controller, timing)
    if not words:
        return result
    ratio = 1 / margin if margin > 0 else math.inf
    margins = {**result.certificate.margins, "ratio_load_capacity": ratio}
    notes = result.notes
    if ratio > 1:
        notes = (*notes, f"load capacity is exceeded ({ratio:.3f}): {words}; enlarge the magnets")
    certificate = replace(result.certificate, margins=margins)
    return replace(result, gamma=max(result.gamma, ratio), certificate=certificate, notes=notes)
