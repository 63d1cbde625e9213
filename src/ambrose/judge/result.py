"""What every synthesis returns: a controller, and the certificate that was recomputed for it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, invalid, named_failure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.norms import hinf_norm
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.realisation import modal_form
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    as_statespace,
    feedback,
    match_signals,
    poles,
    select,
    series,
    spectral_abscissa,
    static_gain,
)
from ambrose.judge.loop_response import LoopResponse, half_order_share
from ambrose.judge.plants import judge_stability, loop_abscissa
from ambrose.law.design_problem import Weights
from ambrose.law.law import FixedLaw, Law, LawLike, ScheduledLaw, Scheduling, law_of
from ambrose.law.loop import Timing, machine_timing, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import PidSettings, Synchronous
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.version import __version__

# The certificate: what is recomputed for a finished controller on the plant it was made for, before
# it is returned.


_SAME = 1e-5  # relative; margins recomputed elsewhere differ by rounding
# said by a design that was interrupted before it certifies the best that it has
CERTIFYING = "interrupted: certifying the best so far; Ctrl-C again ends at once, without it"
INTERRUPTED = "interrupted"  # how ``stopped_early`` of such a design ends


@named_failure("the certificate")
def certify(plant: Plant | StateSpace, controller: LawLike, margins: bool = True) -> Certificate:
    """Stability, output sensitivity and margins of the loop of core/lft.py, recomputed from plant
    and controller.

    plant: a Plant, or a StateSpace from currents u [A] to displacements y [m] (its signals matched
    to the controller's by place). A sampled controller closes the loop around the plant sampled
    with a zero-order hold; everything then holds at the samples. ``closed_loop_norm`` is the
    H-infinity norm of S_o, of a thrust axis with solid cores times ``half_order_share``. The
    margins:

    - ``sensitivity_peak``, ``complementary_peak`` [-]: H-infinity norms of S_o and T_o;
    - ``disk_gain_margin``, ``disk_gain_reduction`` [-], ``disk_phase_margin_rad``: what every axis
      at once may change, each by its own factor, the better of the bounds M_S/(M_S-1), M_S/(M_S+1),
      2 asin(1/2M_S) and 1+1/M_T, 1-1/M_T, 2 asin(1/2M_T) (Lehtomaki, Sandell & Athans 1981).
      Margins of single axes: judge/margins.py. Without ``margins`` they are left out, and
      the norm of T_o, which takes as long as that of S_o, is not computed.

    An unstable loop is a verdict: stable False, closed_loop_norm inf, no margins. Raises
    InvalidInput when sizes do not fit.
    """
    loop, law = _open_loop(plant, controller)
    identity = np.eye(len(loop.outputs))
    abscissa = loop_abscissa(loop)
    fastest = fastest_pole(law)
    label = _label(plant)
    if not abscissa < 0:
        return Certificate(False, abscissa, float("inf"), fastest, {}, label)
    loop = continuous_equivalent(loop)  # margins and norms do not change under the bilinear map

    factor, words = half_order_share(plant, controller)
    peak = factor * float(hinf_norm(feedback(static_gain(identity), loop)).value)
    figures = {"sensitivity_peak": peak}
    label += words
    if margins:
        factor, _ = half_order_share(plant, controller, LoopResponse.complementary)
        complementary = factor * float(hinf_norm(feedback(loop, static_gain(identity))).value)
        figures |= {"complementary_peak": complementary, **disk_margins(peak, complementary)}
    return Certificate(True, abscissa, peak, fastest, figures, label)


def certify_envelope(
    plants: Sequence[Plant], result: Synthesis, timing: Timing | None
) -> Synthesis:
    """The synthesis whose certificate tells the spectral abscissa at every one of the full
    ``plants``, as the loop runs.

    Plants that a schedule is not meant for are left out.
    """
    envelope = {
        plant.point.label: judge_stability(plant, result, timing).abscissa
        for plant in plants
        if result.covers(plant)
    }
    certificate = replace(result.certificate, envelope=envelope)
    return replace(result, certificate=certificate)


@named_failure("the certificate")
def generalized_certificate(plant: GeneralizedPlant, controller: ControllerLike) -> Certificate:
    """Stability and norm of z = F_l(P, K) w, recomputed from a generalized plant and its controller
    u = K y.

    controller: its signals matched to y and u by place. ``closed_loop_norm`` is the H-infinity norm
    from all w to all z; an unstable or marginal loop is a verdict: stable False, closed_loop_norm
    inf. Raises InvalidInput when sizes do not fit, NumericalFailure for an algebraic loop.
    """
    system = as_statespace(controller)
    loop = lft(plant, system)
    abscissa = spectral_abscissa(loop)
    norm = float("inf")
    if abscissa < 0:
        with contextlib.suppress(UnstableSystem):
            norm = hinf_norm(loop).value
    label = f"generalized plant with {plant.system.n_states} states"
    return Certificate(norm < np.inf, abscissa, norm, fastest_pole(system), {}, label)


def full_plant_margins(plant: Plant, law: LawLike) -> tuple[bool, dict[str, float], str]:
    """Whether a law holds a full plant, a schedule at every point of its grid; the margins that say
    so; on what.

    "full_spectral_abscissa" [rad/s] and "full_sensitivity_peak" [-], the worst over the grid, and
    "worst_speed" [rad/s] and "worst_pressure" [Pa], of what it is scheduled over, where that is.
    """
    law = law_of(law)
    along = law.scheduled_over
    if along is None or law.schedule is None:
        certificate = certify(plant, law, margins=False)
        margins = {
            "full_spectral_abscissa": certificate.spectral_abscissa,
            "full_sensitivity_peak": certificate.closed_loop_norm,
        }
        return certificate.stable, margins, certificate.plant
    machine, points = plant.machine, law.points(plant.point)
    results = [certify(assemble(machine, point), law.at(point), False) for point in points]
    worst = int(np.argmax([item.closed_loop_norm for item in results]))
    margins = {
        "full_spectral_abscissa": max(item.spectral_abscissa for item in results),
        "full_sensitivity_peak": results[worst].closed_loop_norm,
        **{
            f"worst_{one.name}": float(at)
            for one, at in zip(along.each, np.atleast_1d(along.of(points[worst])), strict=True)
        },
    }
    label = f"{machine.name}, full plant at {len(points)} of these {along.plural}"
    return all(item.stable for item in results), margins, label


def certify_on_full_plant(
    plant: Plant, result: Synthesis, margins: Mapping[str, float] | None = None
) -> Synthesis:
    """The synthesis with ``margins`` and those of ``full_plant_margins`` added; "unstable" where it
    does not hold ``plant``.
    """
    before = result.certificate
    holds, full, label = full_plant_margins(plant, result)
    stable = before.stable and holds
    margins = {**before.margins, **(margins or {}), **full}
    certificate = replace(before, stable=stable, margins=margins, plant=f"{before.plant}; {label}")
    return replace(
        result, certificate=certificate, status=result.status if stable else Status.UNSTABLE
    )


def contradiction(plant: Plant, result: Synthesis, sampled: Mapping[str, float]) -> str:
    """Which margin, recomputed on the full plant, is not what the certificate says; "" where all
    are.

    sampled: those of the loop as it runs, recomputed as well (``as_it_runs.sampled_margins``).
    """
    certificate = result.certificate
    margins = {
        "full_spectral_abscissa": certificate.spectral_abscissa,
        "full_sensitivity_peak": certificate.closed_loop_norm,
        **certificate.margins,
    }
    for name, value in {**full_plant_margins(plant, result)[1], **sampled}.items():
        said_of_it = margins.get(name, np.nan)
        if not (value == said_of_it or abs(value - said_of_it) <= _SAME * abs(value)):
            return f"{name} is {value:.6g}, but its certificate says {said_of_it:.6g}"
    return ""


def _open_loop(plant: Plant | StateSpace, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """Controller, then plant, as one system; and the controller."""
    open_plant, law = _loop_parts(plant, controller)
    return series(law, open_plant), law


def _loop_parts(plant: Plant | StateSpace, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """The plant from u to y (sampled like the controller), and the controller."""
    if isinstance(plant, Plant):
        system = select(plant.system, plant.named("u"), plant.named("y"))
        law = match_controller(controller, plant)
    else:
        system, fixed = as_statespace(plant), law_of(controller).fixed
        if fixed is None:
            raise InvalidInput(
                "a plant that is a system alone has no operating point; give the Plant, or the "
                "law at one point"
            )
        law = fixed
        if law.D.shape != system.D.shape[::-1] or system.D.shape[0] != system.D.shape[1]:
            raise invalid(
                "the controller's size (outputs, inputs)",
                law.D.shape,
                f"{system.D.shape[::-1]} and square",
                "select() the plant's currents and displacements",
            )
        errors, currents = (
            [f"{to}_{name.removeprefix(prefix)}" for name in names]
            for to, prefix, names in (
                ("err", "y_", system.outputs),
                ("u", "u_", system.inputs),
            )
        )
        law = match_signals(law, errors, currents)
    if law.dt is not None and system.dt is None:
        system = c2d(system, law.dt)
    if law.dt != system.dt and law.n_states:
        raise invalid(
            "the controller's sample time",
            law.dt,
            f"the plant's {system.dt}",
            "resample one of them",
        )
    return system, law


def _label(plant: Plant | StateSpace) -> str:
    if not isinstance(plant, Plant):
        return f"{plant.n_states} states"
    point = plant.point.label or f"{plant.point.speed:g} rad/s, {plant.point.seal_pressure:g} Pa"
    return f"{plant.machine.name}, {point}, {plant.system.n_states} states"


def disk_margins(sensitivity_peak: float, complementary_peak: float) -> dict[str, float]:
    """Gain and phase changes that all axes tolerate at once, from the peaks M_S, M_T >= 0 [-] of
    S_o and T_o.
    """
    s, t = sensitivity_peak, complementary_peak
    increase = [s / (s - 1) if s > 1 else np.inf, 1 + 1 / t if t > 0 else np.inf]
    reduction = [s / (s + 1), 1 - 1 / t if t > 1 else 0.0]
    phase = [2 * np.arcsin(min(1.0, 1 / (2 * m))) if m > 0 else np.pi for m in (s, t)]
    return {
        "disk_gain_margin": float(max(increase)),
        "disk_gain_reduction": float(min(reduction)),
        "disk_phase_margin_rad": float(max(phase)),
    }


def fastest_pole(controller: ControllerLike) -> float:
    """Largest modulus among the controller's poles [rad/s]; of a sampled one |ln z|/dt, pure delays
    (z = 0) left out.
    """
    system = as_statespace(controller)
    values = poles(system)
    if system.dt is not None:
        values = np.log(values[np.abs(values) > 1e-9].astype(complex)) / system.dt
    return float(np.abs(values).max(initial=0.0))


def continuous_equivalent(system: StateSpace) -> StateSpace:
    """A sampled system carried to continuous time by z = (1 + s)/(1 - s); a continuous one
    unchanged.

    Stability, norms, real gains and phases at which a loop closes on -1 are kept; frequencies are
    not. Raises InvalidInput for a pole at z = -1.
    """
    if system.dt is None:
        return system
    n = system.n_states
    E = system.A + np.eye(n)
    if n and np.linalg.cond(E) > 1 / np.finfo(float).eps:
        raise InvalidInput(
            "the sampled loop has a pole at z = -1 (an alternating signal); change the sample time"
        )
    A, B = np.linalg.solve(E, system.A - np.eye(n)), np.linalg.solve(E, system.B)
    C = np.linalg.solve(E.T, system.C.T).T
    return StateSpace(
        A, np.sqrt(2) * B, np.sqrt(2) * C, system.D - C @ system.B, system.inputs, system.outputs
    )


OF_MACHINE = "pid of the machine file"  # the method of a law that stands in for one not given


class Status(StrEnum):
    """What was shown of a controller's loop: it is stable; it is not (a verdict on a controller, no
    failure); nothing.
    """

    VERIFIED = "verified"
    UNSTABLE = "unstable"
    UNCERTIFIED = "uncertified"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Presented):
    """Facts recomputed on the original plant after the synthesis; by default nothing is shown.

    stable: the closed loop was shown to be; closed_loop_norm [-]: H-infinity norm that the method
    minimises (for PID: the output sensitivity's); spectral_abscissa [rad/s] of the closed loop,
    negative when stable; fastest_pole [rad/s]: largest modulus among the controller's poles;
    margins: named numbers such as {"sensitivity_peak": ..., "disk_gain_margin": ...}; plant: what
    it was verified on; envelope: {operating point: spectral abscissa [rad/s]} of the loop on the
    full plant, as it runs, at every operating point of the machine that the controller is meant for
    (empty: not asked). Raises InvalidInput for a claim that its own pole contradicts.
    """

    _FACTS: ClassVar = ("stable", "spectral_abscissa", "closed_loop_norm", "fastest_pole", "plant")

    stable: bool = False
    spectral_abscissa: float = math.nan
    closed_loop_norm: float = math.nan
    fastest_pole: float = math.nan
    margins: Mapping[str, float] = field(default_factory=dict)
    plant: str = ""
    envelope: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # the claim follows from the pole that was computed, never beside it
        if self.stable and not self.spectral_abscissa < 0:
            found = f"stable with spectral abscissa {self.spectral_abscissa:g} rad/s"
            raise invalid("certificate", found, "stable with one below 0", "certify it again")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a controller comes from: package version; name and hash of the machine (None: not
    given); date in UTC (ISO 8601, "" until it is written); settings: what ``design`` was asked for,
    as plain data (None: it comes from elsewhere); digest: what ``Synthesis.digest`` was when its
    file was written (None: it was not).
    """

    package_version: str = __version__
    machine: str | None = None
    machine_hash: str | None = None
    date: str = ""
    settings: Mapping[str, Any] | None = None
    digest: str | None = None

    @property
    def key(self) -> dict[str, Any]:
        """All that decides which controller comes out, by name; equal keys, equal controllers."""
        return {
            "package version": self.package_version,
            "machine": self.machine_hash,
            **(self.settings or {"design": None}),
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data."""
        return {
            "package": "ambrose",
            **{item.name: to_plain(getattr(self, item.name)) for item in fields(self)},
        }


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Synthesis(Presented, Law):
    """A law with what was shown of it.

    controller: StateSpace from sensor error ("err_A_zeta" [m]) to current ("u_A_zeta" [A]).

    gamma: the norm the method reached (NaN where it has none); history: one mapping per iteration;
    notes: what the reader must know of how it was reached (a regularisation, a wider back-off), a
    sentence each. scheduled: the controller over a range of speeds or pressures, ``controller`` is
    that of the plant's own (method "lpv"; None for the others). stopped_early: why the iteration
    ended before its end, with the best verified controller so far (None: it did not). weights: of
    the design problem (None where there is none). filters: the [controller] that gives the same
    controller by method "pid" (None: none does). synchronous: the blocks that reject the
    unbalance's signal, beside the controller. thrust: the same of the thrust axis, of a machine
    that has both groups of axes. file: the name of the file that it was read from ("": of none).
    By default, a controller from elsewhere that nothing was shown of.

    Two are equal when all they say is equal, whatever file they come from. Raises InvalidInput for
    an unknown status, or for "verified" without a certificate that says stable.
    """

    controller: StateSpace
    method: str = "given"
    gamma: float = math.nan
    status: Status = Status.UNCERTIFIED
    certificate: Certificate = Certificate()
    history: tuple[Mapping[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    scheduled: ScheduledSystem | None = None
    stopped_early: str | None = None
    weights: Weights | None = None
    provenance: Provenance = Provenance()
    filters: PidSettings | None = None
    synchronous: tuple[Synchronous, ...] = ()
    thrust: Synthesis | None = None
    file: str = ""

    def __post_init__(self) -> None:
        if self.status not in list(Status):
            raise invalid("status", repr(self.status), ", ".join(Status), "take a member of Status")
        object.__setattr__(self, "status", Status(self.status))
        if self.status is Status.VERIFIED and not self.certificate.stable:
            found = "'verified' with a certificate that does not say stable"
            raise invalid("status", found, "one that says it", "design the controller again")

    @property
    def interrupted(self) -> bool:
        """Whether its design was ended by Ctrl-C, and is not gone on with."""
        return (self.stopped_early or "").endswith(INTERRUPTED)

    @property
    def certified(self) -> Synthesis:
        """Itself: what is compared before its certificate is made has one, too."""
        return self

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Synthesis):
            return NotImplemented
        one, two = (
            {**item.to_dict(), "provenance": None, "thrust": None} for item in (self, other)
        )
        return one == two and self.thrust == other.thrust

    __hash__ = None  # type: ignore[assignment]

    @property
    def law(self) -> StateSpace | ScheduledSystem:
        """What runs: the schedule where there is one, else the controller."""
        return self.controller if self.scheduled is None else self.scheduled

    @property
    def kind(self) -> FixedLaw | ScheduledLaw:
        """What runs, as a law of its kind."""
        schedule = self.scheduled
        return FixedLaw(self.controller) if schedule is None else ScheduledLaw(schedule)

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.kind.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.kind.outputs

    @property
    def sample_time(self) -> float | None:
        return self.kind.sample_time

    @property
    def rate(self) -> float | None:
        rate = (self.provenance.settings or {}).get("rate")
        return float(rate) if rate else None

    @property
    def delay_samples(self) -> int | None:
        stated = (self.provenance.settings or {}).get("delay_samples")
        return None if stated is None else int(stated)

    @property
    def scheduled_over(self) -> Scheduling | None:
        return self.kind.scheduled_over

    @property
    def fixed(self) -> StateSpace | None:
        return self.kind.fixed

    @property
    def nominal(self) -> StateSpace:
        return self.controller

    @property
    def schedule(self) -> ScheduledSystem | None:
        return self.scheduled

    @property
    def range(self) -> tuple[Any, Any] | None:
        return self.kind.range

    def at(self, point: OperatingPoint) -> StateSpace:
        return self.kind.at(point)

    @property
    def digest(self) -> str:
        """SHA-256 (64 hexadecimal digits) of all that is said here but the date: matrices,
        certificate, history, origin.
        """
        content = self.to_dict()
        for part in (content, content.get("thrust", content)):
            part["provenance"] |= {"date": "", "digest": None}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def named(self) -> str:
        """Its file, method and digest: what the head of every page calls it."""
        return ", ".join(filter(None, (self.file, self.method, f"SHA-256 {self.digest}")))

    def to_control(self) -> Any:
        """The controller as a python-control system."""
        return self.controller.to_control()

    @property
    def missed(self) -> bool:
        """Whether a requirement that it was designed for is not met, or a check of ``verify`` at
        the operating points.
        """
        margins = self.certificate.margins
        beyond = margins.get("corner_sensitivity", 0.0) > margins.get(
            "corner_sensitivity_limit", math.inf
        )
        unmet = margins.get("unmet_checks", 0.0) > 0
        too_large = self.method == "tuned" and self.gamma > 1
        if too_large and self.ratios:  # gamma counts guards, which are no requirements
            too_large = any(value > 1 for value in self.ratios.values())
        return beyond or unmet or too_large or self.lost_as_assumed

    @property
    def undecided(self) -> bool:
        """Whether all that is missed is what measured responses do not tell."""
        margins = dict(self.certificate.margins)
        count = margins.pop("undecided_checks", 0.0)
        margins["unmet_checks"] = margins.get("unmet_checks", 0.0) - count
        certificate = replace(self.certificate, margins=margins)
        return count > 0 and not replace(self, certificate=certificate).missed

    @property
    def ratios(self) -> dict[str, float]:
        """Each requirement over its limit, of a tuned controller; guards of the search are none."""
        margins = self.certificate.margins.items()
        found = {n.removeprefix("ratio_"): v for n, v in margins if n.startswith("ratio_")}
        return {name: value for name, value in found.items() if name not in self.guards}

    @property
    def guards(self) -> dict[str, float]:
        """What a search was kept from beyond the requirements, each over its limit."""
        margins = self.certificate.margins.items()
        return {n.removeprefix("guard_"): v for n, v in margins if n.startswith("guard_")}

    @property
    def lost_as_assumed(self) -> bool:
        """Whether nobody states the rate, and the loop would be unstable at the one that virtual
        rig and export assume.
        """
        return self.certificate.margins.get("assumed_abscissa", -1.0) >= 0

    @property
    def lost_elsewhere(self) -> bool:
        """Whether ``lost_as_assumed`` is said of other points alone than that of the design, where
        all else is met.
        """
        own = self.certificate.margins.get("assumed_abscissa_of_design", -1.0)
        others = {k: v for k, v in self.certificate.margins.items() if k != "assumed_abscissa"}
        rest = replace(self, certificate=replace(self.certificate, margins=others))
        return self.lost_as_assumed and own < 0 and not rest.missed

    @property
    def lost(self) -> tuple[str, ...]:
        """The operating points of the machine that it does not hold, by label."""
        envelope = self.certificate.envelope
        return tuple(label for label, abscissa in envelope.items() if not abscissa < 0)

    @property
    def verdict(self) -> str:
        """The status in words: at which operating points, and with an early end."""
        envelope = self.certificate.envelope
        lost = self.lost
        # nothing else was claimed
        only_stable = self.status is Status.VERIFIED and (self.missed or self.method == "pid")
        words = "certified as stable" if only_stable else str(self.status)
        if self.status is Status.VERIFIED and lost:
            words += (
                f" at {len(envelope) - len(lost)} of {len(envelope)} operating points, unstable at "
                f"{', '.join(lost)}"
            )
        elif self.status is Status.VERIFIED and len(envelope) > 1:
            words += f" at all {len(envelope)} operating points"
        if self.lost_as_assumed:
            elsewhere = " at other operating points" if self.lost_elsewhere else ""
            words += f", but only as a continuous loop{elsewhere}"
        elif self.missed:
            words += ", but not every requirement is met"
        elif beyond := [name for name, value in self.guards.items() if value > 1]:
            words += f", beyond a guard of the search that no requirement asks for: {beyond[0]}"
        return (
            words
            if self.stopped_early is None
            else f"{words}, but stopped early: {self.stopped_early}"
        )

    def facts(self) -> Mapping[str, Any]:
        known: dict[str, Any] = {
            "method": self.method,
            "status": self.verdict,
            "states": self.controller.n_states,
        }
        if not math.isnan(self.gamma):
            known["gamma"] = float(self.gamma)
        if self.scheduled is not None:
            known["scheduled_over"] = self.scheduled.words()
        return {**known, "certified_on": self.certificate.plant or "nothing"}

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON-ready data; numbers that are not finite become strings ("inf")."""
        schedule = self.scheduled
        return {
            "method": self.method,
            "status": str(self.status),
            "stopped_early": self.stopped_early,
            "gamma": to_plain(float(self.gamma)),
            "inputs": list(self.controller.inputs),
            "outputs": list(self.controller.outputs),
            "sample_time": self.controller.dt,
            **matrices(self.controller),
            "scheduling": None
            if schedule is None
            else schedule.scheduling() | {"points": [*map(matrices, schedule.systems)]},
            "certificate": None
            if self.status is Status.UNCERTIFIED
            else self.certificate.to_dict(),
            "weights": None if self.weights is None else self.weights.to_dict(),
            "history": to_plain(self.history),
            "notes": list(self.notes),
            "provenance": self.provenance.to_dict(),
            **({} if self.filters is None else {"filters": self.filters.to_dict()}),
            **(
                {"synchronous": [block.to_dict() for block in self.synchronous]}
                if self.synchronous
                else {}
            ),
            **({} if self.thrust is None else {"thrust": self.thrust.to_dict()}),
        }

    def to_frame(self) -> Any:
        """The history as a pandas DataFrame, a row for each iteration. Raises InvalidInput without
        pandas.
        """
        names = dict.fromkeys(name for row in self.history for name in row)
        return data_frame(
            {name: [row.get(name, math.nan) for row in self.history] for name in names}
        )


def matrices(system: StateSpace) -> dict[str, Any]:
    """A, B, C and D as nested lists."""
    return {letter: getattr(system, letter).tolist() for letter in "ABCD"}


def synthesis_of(given: LawLike) -> Synthesis:
    """A law with what is known of it: a Synthesis as it is, else one that nothing was shown of.

    Raises InvalidInput for a law that has no matrices to be written down, such as a program.
    """
    law = law_of(given)
    if isinstance(law, Synthesis):
        return law
    schedule, fixed = law.schedule, law.fixed
    if schedule is not None:
        return Synthesis(schedule.at(schedule.range[0]), scheduled=schedule)
    if fixed is None:
        raise invalid(
            "the controller",
            "a program or a function",
            "a Synthesis or a system with A, B, C, D",
            "design() or read_controller()",
        )
    return Synthesis(fixed)


# What a finished controller is as it runs: sampled, late; and without poles that its sample rate
# cannot show.


_MARGINAL = 1e-9  # of the largest pole; integrators are meant to be on the boundary


def certify_as_it_runs(plant: Plant, result: Synthesis, timing: Timing | None) -> Synthesis:
    """The synthesis with the margins of its sampled loop on ``plant``; "unstable" where that is.
    None: unchanged.

    A controller that is unstable by itself gets a note: it may hold its loop, but runs away
    whenever the loop is open. So does one with a pole beyond half the rate, which export refuses.
    """
    if timing is None:
        return result
    margins = sampled_margins(plant, result, timing)
    stable = result.certificate.stable and margins["sampled_spectral_abscissa"] < 0
    old = result.certificate
    certificate = replace(
        old, stable=stable, margins={**old.margins, **margins}, plant=f"{old.plant}; {timing}"
    )
    notes, pole = result.notes, spectral_abscissa(result.controller)
    if pole > _MARGINAL * max(old.fastest_pole, 1.0):
        away = (
            f"the controller itself is unstable (a pole at {pole:+.4g} rad/s): it runs away "
            "whenever the loop is open"
        )
        notes += (
            f"{away}, and is not exported unless that is wanted (force); another control weight "
            "may give a stable one",
        )
    if result.controller.dt is None and old.fastest_pole * timing.sample_time > np.pi:
        need = (
            f"sample at {old.fastest_pole / np.pi:.4g} Hz or more, or roll it off below "
            f"{np.pi * timing.rate:.4g} rad/s"
        )
        notes += (
            f"a pole at {old.fastest_pole:.4g} rad/s is beyond half the sample rate, and export "
            f"refuses it; {need}",
        )
    return replace(
        result,
        certificate=certificate,
        notes=notes,
        status=result.status if stable else Status.UNSTABLE,
    )


def sampled_margins(plant: Plant, law: LawLike, timing: Timing | None) -> dict[str, float]:
    """ "sampled_spectral_abscissa" [rad/s] and "sampled_sensitivity_peak" [-] of the loop as it
    runs; empty without a timing.

    Of a schedule the worst over its grid, frozen.
    """
    if timing is None:
        return {}
    law = law_of(law)
    margins = []
    for point in law.points(plant.point):
        place = plant if point == plant.point else assemble(plant.machine, point)
        margins.append(certify(place, timing.in_loop(law.at(point)), margins=False))
    return {
        "sampled_spectral_abscissa": max(item.spectral_abscissa for item in margins),
        "sampled_sensitivity_peak": max(item.closed_loop_norm for item in margins),
    }


def without_fast_poles(result: Synthesis, timing: Timing, problem: GeneralizedPlant) -> Synthesis:
    """The synthesis with its controller's stable poles beyond half the sample rate replaced by
    their static gain.

    Sampled code cannot show them, and export refuses them. problem: the design problem without
    uncertainty, on which what is left is certified anew; the norm that the method reached holds no
    longer (NaN). Without such poles: unchanged.
    """
    limit, form = np.pi / timing.sample_time, modal_form(result.controller)
    K, fast = form.system, np.zeros(form.system.n_states, bool)
    for start, size in zip(form.starts, form.sizes, strict=True):
        block = slice(start, start + size)
        values = np.linalg.eigvals(K.A[block, block])
        fast[block] = bool((np.abs(values) > limit).any() and (values.real < 0).all())
    if not fast.any():
        return result
    D = K.D - K.C[:, fast] @ np.linalg.solve(K.A[np.ix_(fast, fast)], K.B[fast])
    slow = ~fast
    controller = StateSpace(
        K.A[np.ix_(slow, slow)], K.B[slow], K.C[:, slow], D, K.inputs, K.outputs
    )
    certificate = generalized_certificate(problem, controller)
    note = (
        f"{int(fast.sum())} states beyond half the sample rate ({limit:.4g} rad/s) replaced by "
        "their static gain"
    )
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    notes = (*result.notes, note)
    return replace(
        result,
        controller=controller,
        certificate=certificate,
        status=status,
        gamma=np.nan,
        notes=notes,
    )


# The machine file's own PID as a synthesis: certified on a plant, and as it runs.


def pid_synthesis(
    plant: Plant, settings: PidSettings | None = None, timing: Timing | None = None
) -> Synthesis:
    """The PID controller of the settings (None: of the plant's machine), certified on the plant.

    The controller returned is continuous. With a timing (None: that of the settings) the sampled
    and delayed one is certified as well (``certify_as_it_runs``), and both must be stable for the
    status "verified"; otherwise it is "unstable", which is a verdict and raises nothing. Raises
    InvalidInput for settings that describe no controller.
    """
    result = continuous_pid(plant, settings)
    machine = replace(plant.machine, controller=result.filters)
    return certify_as_it_runs(plant, result, timing or machine_timing(machine))


def machine_pid(machine: Machine) -> Synthesis:
    """The PID of the machine file as it stands there, nothing shown of it. Raises InvalidInput
    where it states none.
    """
    settings = machine.reference
    if settings is None:
        remedy = machine.in_file("add a [controller] with its gain")
        raise InvalidInput(f"{machine.name} has no PID of its own; give a controller, or {remedy}")
    return Synthesis(pid_controller(settings, machine), OF_MACHINE, filters=settings)


@named_failure("the PID controller")
def continuous_pid(plant: Plant, settings: PidSettings | None = None) -> Synthesis:
    """``pid_synthesis`` without the loop as it runs. Raises InvalidInput."""
    settings = plant.machine.reference if settings is None else settings
    if settings is None:
        remedy = plant.machine.in_file("add a [controller] with its gain or pass PidSettings")
        raise InvalidInput(f"machine {plant.machine.name!r} has no reference controller; {remedy}")
    law = pid_controller(settings, plant.machine)
    certificate = certify(plant, law)
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    return Synthesis(law, "pid", float("nan"), status, certificate, filters=settings)
