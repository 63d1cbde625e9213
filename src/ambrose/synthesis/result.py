"""What every synthesis returns: a controller, and the certificate that was recomputed for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from ambrose.core.presentation import to_plain
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """Facts recomputed on the original plant after the synthesis.

    closed_loop_norm [-]: H-infinity norm that the method minimises (for PID: the output sensitivity's); spectral_abscissa
    [rad/s] of the closed loop, negative when stable; fastest_pole [rad/s]: largest modulus among the controller's poles;
    margins: named numbers such as {"sensitivity_peak": ..., "disk_gain_margin": ...}; plant: what it was verified on.
    """

    stable: bool
    spectral_abscissa: float
    closed_loop_norm: float
    fastest_pole: float
    margins: Mapping[str, float] = field(default_factory=dict)
    plant: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data; numbers that are not finite become strings ("inf")."""
        return {item.name: to_plain(getattr(self, item.name)) for item in fields(self)}


@dataclass(frozen=True, slots=True, eq=False)
class Synthesis:
    """controller: StateSpace from sensor error ("err_A_zeta" [m]) to current ("u_A_zeta" [A]).

    gamma: the norm the method reached (NaN where it has none); status: "verified", or "unstable" (a reference controller
    that does not hold this plant: a verdict, not a failure); history: one mapping per iteration; notes: what the reader must
    know of how it was reached (a regularisation, a wider back-off), a sentence each. scheduled: the controller over a range
    of speeds, of which ``controller`` is the one at the nominal speed (method "lpv"; None for the others).
    """

    controller: StateSpace
    method: str
    gamma: float
    status: str
    certificate: Certificate
    history: tuple[Mapping[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    scheduled: ScheduledSystem | None = None

    @property
    def law(self) -> StateSpace | ScheduledSystem:
        """What runs: the schedule where there is one, else the controller."""
        return self.controller if self.scheduled is None else self.scheduled


def is_verified(status: str) -> bool:
    """Whether a synthesis' status says verified, perhaps of an iteration that was stopped early ("verified, but ...")."""
    return status.partition(",")[0].partition(";")[0] == "verified"
