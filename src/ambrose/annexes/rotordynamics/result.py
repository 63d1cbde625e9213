"""The lateral analysis as data: what ``lateral.json`` holds and the page is made of."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ambrose.annexes.rotordynamics.capacity import AxisCapacity
from ambrose.annexes.rotordynamics.critical_map import CriticalMap
from ambrose.annexes.rotordynamics.levels import LevelOne, Share
from ambrose.annexes.rotordynamics.loop import PhaseBudget
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.annexes.rotordynamics.response import (
    Critical,
    Separation,
    UnbalanceResponse,
    criticals,
)
from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.core.presentation import Presented, data_frame
from ambrose.judge.campbell import Modes
from ambrose.machine.machine import Machine

SCHEMA = 1  # version of lateral.json
RECALLED = "recalled"
OWN = "own"


@dataclass(frozen=True, slots=True)
class Item:
    """One row of the summary: a clause, what it asks for and what the machine has.

    name: of the quantity, as in lateral.json; unit: "um p-p", "um 0-p", "%", "N/m" ...: amplitudes
    say which. basis: "checked" (a source that quotes the clause was at hand), "recalled", or "own"
    (no clause: what Ambrose adds). limit None and passed None: for information, or not covered.
    left_out: a reviewer looks for it, and it was not checked, as the note explains; such a row, and
    one whose value is not finite, never passes. bound ">": the value is more than the one given,
    which is as far as was looked.
    """

    name: str
    title: str
    standard: str
    clause: str
    basis: str
    value: float | None
    unit: str
    relation: str = "<="
    limit: float | None = None
    passed: bool | None = None
    note: str = ""
    bound: str = ""
    left_out: bool = False

    def __post_init__(self) -> None:
        if self.passed is not None:  # of NumPy's numbers it is no False that "is False" sees
            object.__setattr__(self, "passed", bool(self.passed))
        if self.passed and self.value is not None and not np.isfinite(self.value):
            object.__setattr__(self, "left_out", True)
            said = "; ".join(text for text in (self.note, "value not known, not checked") if text)
            object.__setattr__(self, "note", said)
        if self.passed and self.left_out:
            object.__setattr__(self, "passed", None)

    @property
    def unjudged(self) -> bool:
        """Whether a limit stands without a verdict, which does not pass."""
        return self.passed is None and self.limit is not None

    def to_dict(self) -> dict[str, Any]:
        """Plain data; infinite values as text."""
        row = {name: getattr(self, name) for name in self.__slots__}
        return {
            key: (str(value) if isinstance(value, float) and not np.isfinite(value) else value)
            for key, value in row.items()
        }


def not_finite(value: float) -> str:
    """A value that is no number, in words."""
    return "not known" if np.isnan(value) else "infinite"


@dataclass(frozen=True, slots=True, eq=False)
class ModeRow:
    """A mode of the machine as it runs, the shares of its log decrement, and the least value found
    over the tolerances (None: none were looked at), with the member that has it.
    """

    mode: ShaftMode
    shares: tuple[Share, ...]
    least: float | None = None
    member: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Rub:
    """Motion at a clearance: peak to peak, scaled, with its case and speed [rad/s].

    motion [m] peak to peak, offset [m] by which the rotor hangs there at rest, allowed [m] for both
    sides of both.
    """

    name: str
    kind: str
    position: float
    diametral: float
    motion: float
    offset: float
    allowed: float
    speed: float
    case: str

    @property
    def share(self) -> float:
        """Of the diametral clearance that motion and offset take."""
        return (self.motion + 2 * self.offset) / self.diametral

    @property
    def passed(self) -> bool:
        return self.motion + 2 * self.offset <= self.allowed


@dataclass(frozen=True, slots=True, eq=False)
class Control:
    """The controller as it runs, with delay and hold.

    states; sample_time [s], None: continuous; omega (w,) [rad/s] and gain (w, a) [A/m]: from the
    displacement that the sensors of an axis read to its current, current = -gain displacement.
    """

    axes: tuple[str, ...]
    states: int
    sample_time: float | None
    omega: np.ndarray
    gain: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        return {
            "states": self.states,
            "sample_time_s": self.sample_time,
            "frequencies_rad_per_s": self.omega.tolist(),
            "gain_A_per_m": {
                axis: np.abs(row).tolist() for axis, row in zip(self.axes, self.gain.T, strict=True)
            },
            "phase_deg": {
                axis: np.degrees(np.angle(row)).tolist()
                for axis, row in zip(self.axes, self.gain.T, strict=True)
            },
        }


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Lateral(Presented):
    """A machine's lateral analysis.

    speeds: lowest and highest running speed and trip speed [rad/s]. items: the summary's rows.
    critical_speeds: the tightest reading of each, with its probe and the placement. response
    None: the loop is unstable, and only ``items`` and modes are there. density: mean gas density
    [kg/m^3] that was given, None: none. modes_to [rad/s]: up to where modes are listed; limits are
    for those up to the highest running speed. along: speeds [rad/s] with the modes there.
    """

    _FACTS: ClassVar = ("machine=machine_name", "passed", "failed")

    machine: Machine
    controller: str
    timing: str
    point: str
    speeds: tuple[float, float, float]
    layout: Layout
    items: tuple[Item, ...] = ()
    modes: tuple[ModeRow, ...] = ()
    rubs: tuple[Rub, ...] = ()
    response: UnbalanceResponse | None = None
    level_one: LevelOne | None = None
    capacities: tuple[AxisCapacity, ...] = ()
    scale: tuple[float, float] = (1.0, 1.0)
    notes: tuple[str, ...] = ()
    critical_speeds: tuple[tuple[Separation, str, str], ...] = ()
    phase_budgets: tuple[PhaseBudget, ...] = ()
    critical_map: CriticalMap | None = None
    density: float | None = None
    control: Control | None = None
    modes_to: float = 0.0
    along: tuple[tuple[float, Modes], ...] = ()

    @property
    def machine_name(self) -> str:
        return self.machine.name

    @property
    def passed(self) -> bool:
        """Whether every row with a limit was judged, and none fails."""
        return not self.failed and not any(item.unjudged for item in self.items)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the rows that fail, or could not be done."""
        return tuple(item.name for item in self.items if item.passed is False)

    def to_dict(self) -> Mapping[str, Any]:  # type: ignore[override]
        """``lateral.json``: schema 1. Speeds [rad/s], lengths [m]; amplitudes say 0-p or p-p."""
        low, high, trip = self.speeds
        data: dict[str, Any] = {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "controller": self.controller,
            "timing": self.timing,
            "operating_point": self.point,
            "passed": self.passed,
            "speeds_rad_per_s": {"lowest": low, "highest": high, "trip": trip},
            "mean_gas_density_kg_per_m3": self.density,
            "scale_factor": {"capped": self.scale[0], "uncapped": _plain(self.scale[1])},
            "items": [item.to_dict() for item in self.items],
            "modes_up_to_rad_per_s": self.modes_to,
            "modes": [
                {
                    "frequency_rad_per_s": row.mode.frequency,
                    "log_decrement": row.mode.log_decrement,
                    "judged": row.mode.frequency <= high,
                    "whirl": row.mode.whirl,
                    "shares": {s.component: s.log_decrement for s in row.shares},
                    "least_over_tolerances_found": row.least,
                    "at": row.member,
                }
                for row in self.modes
            ],
            "clearances": [
                {
                    "name": rub.name,
                    "kind": rub.kind,
                    "position_m": rub.position,
                    "diametral_m": rub.diametral,
                    "motion_m_pp": rub.motion,
                    "offset_m": rub.offset,
                    "allowed_m_pp": rub.allowed,
                    "at_rad_per_s": rub.speed,
                    "case": rub.case,
                    "passed": rub.passed,
                }
                for rub in self.rubs
            ],
            "phase_budget": [
                {
                    "axes": list(budget.axes),
                    "frequencies_rad_per_s": budget.frequencies.tolist(),
                    "elements_deg": {
                        name: np.degrees(row).tolist()
                        for name, row in zip(budget.elements, budget.phases, strict=True)
                    },
                    "total_deg": np.degrees(budget.total).tolist(),
                    "notes": list(budget.notes),
                }
                for budget in self.phase_budgets
            ],
            "capacity": [_capacity(axis) for axis in self.capacities],
            "notes": list(self.notes),
        }
        if self.control is not None:
            data["signal_chain"] = {
                "sensors": [
                    {
                        "bearing": item.bearing,
                        "position_m": item.position,
                        "angle_rad": item.angle,
                        "weight": item.weight,
                        "bandwidth_rad_per_s": item.bandwidth,
                    }
                    for item in self.machine.sensor_pairs
                ],
                "amplifier": self.machine.amplifier.to_dict(),
                "controller": self.control.to_dict(),
            }
        if self.critical_map is not None:
            data["critical_speed_map"] = _map(self.critical_map)
        if self.level_one is not None:
            one = self.level_one
            data["level_one"] = {
                "anticipated_N_per_m": one.anticipated,
                "border_N_per_m": one.border if np.isfinite(one.border) else f"> {one.end:.6g}",
                "log_decrement_at_anticipated": one.at_anticipated,
                "critical_speed_ratio": one.speed_ratio,
                "level_two_asked_for": None
                if one.screening is None
                else list(one.screening.reasons),
                "cross_coupling_N_per_m": one.cross_coupling.tolist(),
                "modes": [
                    {
                        "frequency_rad_per_s": branch.mode.frequency,
                        "log_decrement": branch.log_decrement.tolist(),
                    }
                    for branch in one.branches
                ],
            }
        if self.response is not None:
            data["unbalance"] = [
                {
                    "case": case.name,
                    "why": case.why,
                    "weights": [
                        {
                            "position_m": float(self.layout.positions[w.station]),
                            "amount_kg_m": w.amount,
                            "angle_rad": w.angle,
                            "carried_kg": w.carried,
                        }
                        for w in case.weights
                    ],
                }
                for case in self.response.cases
            ]
            data["critical_speeds"] = [
                _peak(item.critical)
                | {
                    "margin_percent": item.margin,
                    "required_percent": item.required,
                    "reading": probe,
                    "case": case,
                }
                for item, probe, case in self.critical_speeds
            ]
            data["response"] = _curves(self.response)
        return data

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each item of the summary."""
        rows = [item.to_dict() for item in self.items]
        return data_frame({key: [row[key] for row in rows] for key in rows[0]} if rows else {})


def _capacity(axis: AxisCapacity) -> dict[str, Any]:
    """Force over the frequency, what lasts and every load of one axis."""
    return {
        "axis": axis.axis,
        "frequencies_rad_per_s": axis.omega.tolist(),
        "force_N_0p": axis.force.tolist(),
        "other_side_force_N_0p": axis.other.tolist(),
        "limited_by": list(axis.limited_by),
        "static_N": dict(axis.static),
        "static_current_A": axis.limits.static,
        "demands": [
            {
                "load": item.name,
                "kind": item.kind,
                "frequency_rad_per_s": item.frequency,
                "force_N_0p": item.force,
                "current_A_0p": item.current,
                "voltage_V_0p": item.voltage,
                "margin_alone": _plain(axis.limits.margin(item).value),
            }
            for item in axis.demands
        ],
        "margins": [
            {"margin": _plain(item.value), "of": item.of, "limited_by": item.limited_by}
            for item in axis.margins
        ],
    }


def _map(found: CriticalMap) -> dict[str, Any]:
    """Undamped critical speeds over the stiffness, and the bearings' own."""
    return {
        "support_stiffness_N_per_m": found.stiffness.tolist(),
        "forward_rad_per_s": found.speeds.tolist(),
        "on_rigid_supports_rad_per_s": found.rigid.tolist(),
        "supports": [
            {
                "axes": list(item.axes),
                "kind": "magnet" if item.magnetic else "film",
                "speeds_rad_per_s": item.speeds.tolist(),
                "stiffness_abs_N_per_m": np.abs(item.stiffness).tolist(),
                "stiffness_real_N_per_m": item.stiffness.real.tolist(),
            }
            for item in found.supports
        ],
        "crossings": [
            {
                "axes": item.support,
                "critical_speed": item.number,
                "speed_rad_per_s": item.speed,
                "stiffness_N_per_m": item.stiffness,
            }
            for item in found.crossings
        ],
    }


def _curves(response: UnbalanceResponse) -> dict[str, Any]:
    """Amplitudes and phases of all readings at the computed speeds, and their peaks by
    interpolation.
    """
    rows = []
    for k, case in enumerate(response.cases):
        for reading in response.all_readings:
            fine = response.read(reading, k)
            lag = response.phase_lag(reading, k, response.speeds)
            rows.append(
                {
                    "reading": reading.name,
                    "case": case.name,
                    "amplitude_m_pp": (2 * response.read(reading, k, response.speeds)).tolist(),
                    "phase_lag_deg": np.degrees(lag).tolist(),
                    "peaks": [_peak(peak) for peak in criticals(response.fine, fine)],
                }
            )
    return {"speeds_rad_per_s": response.speeds.tolist(), "curves": rows}


def _peak(peak: Critical) -> dict[str, Any]:
    """A critical speed as data; the amplification factor is text where no flank shows it."""
    return {
        "speed_rad_per_s": peak.speed,
        "amplitude_m_pp": 2 * peak.amplitude,
        "amplification_factor": _plain(peak.amplification),
    }


def _plain(value: float) -> float | str:
    return value if np.isfinite(value) else str(value)
