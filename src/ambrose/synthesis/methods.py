"""The methods of design: a class each, with the options that it has."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

from ambrose.options import AsItRuns, Rules, count, option, percent, positive
from ambrose.registry import registered, resolve

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.core.statespace import StateSpace
    from ambrose.judge.result import Synthesis
    from ambrose.law.design_problem import Weights
    from ambrose.law.law import LawLike
    from ambrose.law.loop import Timing
    from ambrose.machine.machine import Machine
    from ambrose.model.plant import Plant
    from ambrose.record.response import Response
    from ambrose.synthesis.fixed_order.job import Law
    from ambrose.synthesis.hinf import Iterates


# What every method of design has: a name, when the loop runs, and a controller for a plant.


Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Method(AsItRuns, ABC):
    """One way to a controller; each of its options is a field.

    rate [Hz]: the loop runs sampled; delay_samples: from measured errors to currents set (None: as
    the machine file says, else one; where nothing states a rate, the controller is designed without
    delay). Raises InvalidInput for an option that cannot be.
    """

    name: ClassVar[str]
    title: ClassVar[str]  # for people
    begins_as: ClassVar[str | None] = None  # the method whose controller it goes on from

    @classmethod
    @abstractmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether a machine file states what the method needs."""

    def evidence(self) -> dict[str, object]:
        """What the files hold that options name, by option: [name, SHA-256]."""
        return {}

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
        from ambrose.law.loop import machine_timing, timing_of

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


# What H-infinity, mu and polished mu share: the machine's weights, and a reduced design model.


SCALING_ORDER = 1  # d(s) I of first order for mu: 20 -> 24 states on the seal rig, as in P5


@dataclass(frozen=True, slots=True, kw_only=True)
class Weighted(Lowered):
    """A method that minimises a norm of the loop with the machine's weights.

    bending_modes: how many the design model keeps per plane (None: as many as the full plant shows
    to matter, ``synthesis.order_selection``). match_reference: scale the control weight until the
    direct gains below 200 Hz match the reference controller's, so that controllers are comparable
    (P5); None: where the machine has a reference controller and a constant control weight, and the
    gains can be matched by a controller that holds the full plant as the loop runs. Where a rate is
    known the design model has its delay, and poles beyond half of it are residualised.
    """

    uncertain: ClassVar[bool]  # whether it is designed over the machine's tolerances

    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the design model; default: those without which a design "
        "does not stabilise the full plant.",
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
    def minimise(self, problem: GeneralizedPlant, progress: Progress) -> Iterates:
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
        from ambrose.model.uncertainty import reduce

        tolerances = design_tolerances(plant.machine) if self.uncertain else None
        small = reduce(plant, self.bending_modes or 0)
        return apply_delay(open_model(small, tolerances, self.uncertain), self.lag), self.uncertain

    @property
    def lag(self) -> float:
        """By how much the currents are late on average [s]."""
        timing = self.timing()
        return 0.0 if timing is None else timing.lag

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.law.design_problem import machine_weights
        from ambrose.machine.criteria import SENSITIVITY, demand
        from ambrose.synthesis.order_selection import modes_that_matter

        machine = plant.machine
        weights = machine_weights(machine)
        if self.bending_modes is None:
            modes = modes_that_matter(plant, weights, self.timing(), progress)
            return replace(self, bending_modes=modes).design(plant, progress)
        matched = self._matched(machine)
        result, peak = self._designed(plant, weights, matched, progress)
        quantity = "maximum singular value of a sensitivity"
        limit = demand(quantity, machine.requirements).limit or SENSITIVITY.limits[0].value
        if not matched or self.match_reference or peak <= limit or result.interrupted:
            return result

        # comparable gains were nobody's wish: the file's own weights, where they do better
        progress("the reference's direct gains are unstable on it: the file's own control weight")
        by_file, reached = self._designed(plant, weights, False, progress)
        if not reached < peak or (reached > limit and peak < float("inf")):
            return result
        words = "unstable" if peak == float("inf") else f"at sigma_max(S_o) {peak:.3g}"
        note = f"with the reference's direct gains it would be {words}: the file's control weight"
        return replace(by_file, notes=(*by_file.notes, note))

    def _designed(
        self, plant: Plant, weights: Weights, matched: bool, progress: Progress
    ) -> tuple[Synthesis, float]:
        """The controller with so many modes in its model, judged on the full plant; its
        sigma_max(S_o) there as the loop runs, inf where it is unstable.
        """
        from ambrose.judge.result import certify_on_full_plant, sampled_margins, without_fast_poles
        from ambrose.law.design_problem import design_plant
        from ambrose.law.pid import pid_controller
        from ambrose.model.uncertainty import reduce
        from ambrose.synthesis.hinf import direct_gain_mismatch

        machine, timing = plant.machine, self.timing()
        model, uncertain = self.design_model(plant)
        reference = pid_controller(machine.reference, machine) if machine.reference else None
        margins = _left_out(machine, progress) if self.uncertain else {}
        if self.bending_modes:
            margins["bending_modes"] = float(self.bending_modes)
        if matched:
            result, weights = _as_strong(model, weights, reference, self, uncertain, progress)
        else:
            problem = design_plant(model, weights, uncertain=uncertain)
            result = self.minimise(problem, progress).certified
        result = self.refine(result, model, weights, plant, progress)
        if timing is not None:
            nominal = design_plant(reduce(plant, self.bending_modes or 0), weights, uncertain=False)
            result = without_fast_poles(result, timing, nominal)
        if reference is not None:  # of the controller that is returned: polishing moves it
            margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
        result = certify_on_full_plant(plant, replace(result, weights=weights), margins)
        sampled = sampled_margins(plant, result, timing)
        full = result.certificate.margins["full_sensitivity_peak"]
        return result, float(sampled.get("sampled_sensitivity_peak", full))

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
        from ambrose.judge.plants import envelope_of
        from ambrose.law.design_problem import apply_delay, design_tolerances
        from ambrose.model.uncertainty import free_mode_reduction
        from ambrose.synthesis.order_selection import envelope_model

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
    method: Weighted,
    uncertain: bool,
    progress: Progress,
) -> tuple[Synthesis, Weights]:
    """The controller whose direct gains are the reference's, and its weights: the file's with the
    control weight scaled. Raises InvalidInput without a reference.
    """
    from ambrose.core.checks import invalid
    from ambrose.synthesis.hinf import tune_control_weight

    if reference is None:
        raise invalid(
            "match_reference",
            True,
            "False without a [controller] table",
            "add the reference controller",
        )
    tuned = tune_control_weight(
        model,
        weights,
        reference,
        lambda problem: method.minimise(problem, progress),
        uncertain=uncertain,
    )
    progress(
        f"control weight times {tuned.factor:.3g}: direct gains {100 * tuned.mismatch:+.1f} % "
        "of the reference's"
    )
    return tuned.synthesis, tuned.weights


# Method "hinf": H-infinity for the nominal plant.


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

    def minimise(self, problem: GeneralizedPlant, progress: Progress) -> Iterates:
        from ambrose.synthesis.hinf import hinf_synthesis

        return mu_controller(problem, progress) if self.envelope else hinf_synthesis(problem)


# Method "mu": D-K iteration over the machine's tolerances.


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

    def minimise(self, problem: GeneralizedPlant, progress: Progress) -> Iterates:
        return mu_controller(problem, progress)


def mu_controller(problem: GeneralizedPlant, progress: Progress) -> Iterates:
    """The controller of a design problem by D-K iteration; of one that was solved before in this
    run, the same again: a polished controller begins as the mu controller beside it.
    """
    from ambrose.core.processes import recalled
    from ambrose.synthesis.mu import mu_iterates

    matrices = tuple(getattr(problem.system, letter).tobytes() for letter in "ABCD")
    key = (matrices, problem.w, problem.u, problem.z, problem.y, problem.blocks)
    return recalled("mu", key, lambda: mu_iterates(problem, order=SCALING_ORDER, progress=progress))


# Method "pid": the machine's own reference controller.


@dataclass(frozen=True, slots=True, kw_only=True)
class Pid(Lowered):
    """The reference controller of the machine file, decentralised PID or filter bank, certified on
    the plant. It is no design: a delay is in the verdict, in no model.
    """

    name: ClassVar[str] = "pid"
    title: ClassVar[str] = "PID"

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether the machine file has a [controller] with gains."""
        return plant.machine.reference is not None

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.judge.result import continuous_pid

        return continuous_pid(plant)


# Method "polish": the mu controller at a fixed lower order, refined for the worst case.


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

    def minimise(self, problem: GeneralizedPlant, progress: Progress) -> Iterates:
        return mu_controller(problem, progress)

    def refine(
        self,
        start: Synthesis,
        model: GeneralizedPlant,
        weights: Weights,
        plant: Plant,
        progress: Progress,
    ) -> Synthesis:
        from ambrose.law.design_problem import design_plant
        from ambrose.model.uncertainty import reduce
        from ambrose.synthesis.fixed_order.polish import JUDGED_ROUNDS, polish_synthesis
        from ambrose.synthesis.order_selection import sampled_sensitivity

        if start.interrupted:
            return replace(start, notes=(*start.notes, "not polished: it was interrupted before"))
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


# Method "tuned": one controller of fixed order for the whole envelope, to the requirements.


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned(Method):
    """Tuned to the machine's requirements at every operating point, with the worst members of the
    tolerances around each, from its PID or a first guess.

    order: states (None: three per axis; of "filters" six). structure: "free", "plane" (zeta and eta
    kept apart where the bearings stand at one angle), "axis" (each alone), or a filter bank: "pid"
    (per channel a PID and a low pass), "filters" (and notches). bending_modes: per plane in the
    models that it is tuned on (None: all below the frequency up to which sensitivity is judged, and
    one more). match_reference: the direct gains below 200 Hz stay near those of the reference
    controller. measured: files of frequency responses, all axes of one operating point each, whose
    plant is tuned on and judged beside the model's; running: the controller that ran then.
    """

    name: ClassVar[str] = "tuned"
    title: ClassVar[str] = "tuned"
    rules: ClassVar[Rules] = (
        (("running",), "measured", True, "add what was measured while it ran, {}"),
    )

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

    measured: Sequence[str] = option(
        (),
        "Frequency responses of all axes at one operating point, a file each (repeatable): the "
        "controller is tuned on the measured plant, too.",
        many=True,
        metavar="PATH",
    )
    running: str | None = option(
        None,
        "The controller that ran while they were measured (*.json); default: none, they are of "
        "the plant alone.",
        metavar="PATH",
    )

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Always."""
        return True

    def evidence(self) -> dict[str, object]:
        """The responses and the controller that ran. Raises InvalidInput for files that cannot be
        read.
        """
        from hashlib import sha256

        from ambrose.machine.ordinary_file import check_source

        def known(name: str, what: str) -> list[str]:
            file = check_source(Path(name), what)
            return [file.name, sha256(file.read_bytes()).hexdigest()]

        running = None if self.running is None else known(self.running, "controller")
        return {
            "measured": [known(name, "responses") for name in self.measured],
            "running": running,
        }

    def without_bank(self) -> Self:
        """The method itself, for what tunes a controller step by step. Raises InvalidInput for a
        filter bank.
        """
        from ambrose.core.checks import invalid
        from ambrose.synthesis.fixed_order.bank import BANKS

        if self.structure in BANKS:
            remedy = "a bank is tuned by the design itself"
            raise invalid("structure", self.structure, "free, plane or axis", remedy)
        return self

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.core.statespace import StateSpace
        from ambrose.judge.controller_file import read_controller
        from ambrose.judge.measured import measured_plant, placed
        from ambrose.judge.plants import envelope_of
        from ambrose.judge.result import full_plant_margins
        from ambrose.law.law import law_of
        from ambrose.law.loop import laws_of
        from ambrose.law.pid import first_settings, pid_controller
        from ambrose.synthesis.fixed_order.bank import BANKS
        from ambrose.synthesis.fixed_order.tuning import tune_controller
        from ambrose.synthesis.hinf import direct_gain_mismatch

        machine = plant.machine
        settings = machine.reference or first_settings(machine)
        reference = pid_controller(settings, machine)
        plants, timing = envelope_of(plant), self.timing()
        start: Law = settings
        running = None
        if self.running is not None:
            law = law_of(read_controller(self.running, machine))
            running = laws_of(machine, law)[machine.group][1]
            if machine.reference is None and self.structure not in BANKS:
                # known to hold, where the file has no [controller]
                start = running if isinstance(running, StateSpace) and not running.dt else start
        # number of an operating point -> the responses that were measured there
        places = placed(plants, self.measured, running)
        result = tune_controller(
            plants,
            start,
            timing,
            order=self.order,
            structure=self.structure,
            bending_modes=self.bending_modes,
            reference=reference if self.match_reference else None,
            progress=progress,
            measured=[
                (k, *measured_plant(plants[k], one, running, timing)) for k, one in places.items()
            ],
        )
        for k, one in places.items():
            result = as_measured(result, plants[k], one, running, timing)
        _, margins, _ = full_plant_margins(plant, result.controller)
        if machine.reference is not None:
            margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
        certificate = replace(result.certificate, margins={**result.certificate.margins, **margins})
        return with_capacity(replace(result, certificate=certificate), machine, self.timing())


def as_measured(
    result: Synthesis,
    plant: Plant,
    response: Response,
    running: LawLike | None,
    timing: Timing | None,
) -> Synthesis:
    """A synthesis judged on the plant that was measured at an operating point as well: what fails
    there, or is not told, counts as missed, with a note each; unstable there is unstable.
    """
    from ambrose.core.checks import InvalidInput
    from ambrose.judge.measured import MEASURED, UNDECIDED, check_measured
    from ambrose.judge.result import Status

    margins, notes = dict(result.certificate.margins), list(result.notes)
    try:
        checks = check_measured(plant, response, result.controller, running, timing)
    except InvalidInput as error:  # they told the loop that ran, and not this one
        for count in ("unmet_checks", "undecided_checks"):
            margins[count] = margins.get(count, 0.0) + 1
        notes.append(f"{plant.point.label}{MEASURED}: {error}")
        certificate = replace(result.certificate, margins=margins)
        return replace(result, certificate=certificate, notes=tuple(notes))
    status = result.status if checks.stable else Status.UNSTABLE
    for check in checks.checks:
        if check.name == "sensitivity.output.max":
            margins["measured_sensitivity_peak"] = max(
                check.value, margins.get("measured_sensitivity_peak", 0.0)
            )
    failed = list(checks.failed)
    if failed:
        margins["unmet_checks"] = margins.get("unmet_checks", 0.0) + len(failed)
        untold = sum(UNDECIDED in check.detail for check in failed)
        margins["undecided_checks"] = margins.get("undecided_checks", 0.0) + untold
    for check in failed:
        limit = "" if check.limit is None else f", not {check.relation} {check.limit:.4g}"
        notes.append(f"{checks.label}: {check.title} {check.value:.4g}{limit}; {check.detail}")
    certificate = replace(result.certificate, margins=margins)
    return replace(result, status=status, certificate=certificate, notes=tuple(notes))


def with_capacity(result: Synthesis, machine: Machine, timing: Timing | None) -> Synthesis:
    """A synthesis, with what residual unbalance and loads of the file take of the magnets among its
    ratios, as ``size`` counts it.
    """
    from ambrose.judge.unbalance import capacity_margin

    if not machine.bearings or not result.certificate.stable:
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


# The methods of this installation by their names.


@cache
def methods() -> Mapping[str, type[Method]]:
    """{name: its class}, those of the annexes last."""
    kinds = [Tuned, Pid, Hinf, Mu, Polish, *map(resolve, registered("method").values())]
    return {kind.name: kind for kind in kinds}
