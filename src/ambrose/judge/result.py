"""What every synthesis returns: a controller, and the certificate that was recomputed for it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any, ClassVar

from ambrose.core.checks import invalid
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.law import FixedLaw, Law, LawLike, ScheduledLaw, law_of
from ambrose.law.scheduling import Scheduling
from ambrose.law.weights import Weights
from ambrose.machine.controller import PidSettings
from ambrose.machine.description import OperatingPoint
from ambrose.machine.synchronous import Synchronous
from ambrose.version import __version__


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
    unbalance's signal, beside the controller. By default, a controller from elsewhere that nothing
    was shown of.

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

    def __post_init__(self) -> None:
        if self.status not in list(Status):
            raise invalid("status", repr(self.status), ", ".join(Status), "take a member of Status")
        object.__setattr__(self, "status", Status(self.status))
        if self.status is Status.VERIFIED and not self.certificate.stable:
            found = "'verified' with a certificate that does not say stable"
            raise invalid("status", found, "one that says it", "design the controller again")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Synthesis):
            return NotImplemented
        return {**self.to_dict(), "provenance": None} == {**other.to_dict(), "provenance": None}

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
        content["provenance"] |= {"date": "", "digest": None}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def named(self) -> str:
        """Its method and digest."""
        return f"{self.method}, SHA-256 {self.digest}"

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
