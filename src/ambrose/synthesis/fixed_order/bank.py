"""A filter bank that is tuned: its unknowns are the logarithms of the gains, times, frequencies and
dampings of every chain.

Theta of the whole bank (law/pid.py) is a product of small matrices, analytic in the
parameters. The slope goes back through the products, and each section's own derivative is a complex
step, exact to rounding (Squire & Trapp 1998). Poles that would run to infinity, and dampings, end
softly at limits: value = least + 1/(1/(limit - least) + exp(-x)).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.statespace import StateSpace
from ambrose.law.pid import (
    DERIVATIVE_FILTER,
    bank,
    chain,
    channel_chains,
    channel_names,
    embedded,
    first_settings,
    mixings,
    section_matrix,
    section_text,
    theta_system,
)
from ambrose.machine.machine import Machine
from ambrose.machine.part import SECTIONS, Channel, PidSettings, Section
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.static_load import magnet_coefficients

_STEP = 1e-30  # of a complex derivative
_FAR = 40.0  # of a logarithm: farther steps of a search stay finite
_EDGE = 1e-9  # of a limit: values are that far within
_INSIDE = 0.9  # of a limit: where a start that is beyond it is put
# damping of poles, from and to: below, a resonance that nobody asked for; above 1 one of them is
# faster than its frequency says
_DAMPED = {"low-pass": (0.5, 1.0), "notch": (0.1, 1.0), "phase-bump": (0.1, 1.0)}
_PHASE = 3.0  # rad; more than a phase bump can turn
_SLOWEST = 1.0  # s; longest integral time, without which the integrals are tuned away
_DAMPING = 0.5  # of a notch that does nothing yet
# damping of a notch's zeros: a deeper one needs the mode's frequency to better than a percent
_LEAST = 0.01
_AT = 0.02  # of the room between limits: so near one a value is at it
_SAME = 0.05  # coefficients of two axes that differ by less are alike
_EXTRA = 1  # notch per channel with structure "filters"
BANKS = ("pid", "filters")


@dataclass(frozen=True, slots=True)
class _Unknown:
    """One unknown: a section's key or "gain", between limits; a phase is 3 tanh(x), a PID's filter
    its corner 1/(eps T_d).

    channels: those that share it (``_alike``).
    """

    channels: tuple[int, ...]
    section: int
    key: str
    limit: float = np.inf
    least: float = 0.0

    def start(self, section: Section, gain: float) -> float:
        if self.key == "gain":
            return float(np.log(gain))
        if self.key == "phase":
            return float(np.arctanh(np.clip((section.phase or 0.0) / _PHASE, _EDGE - 1, 1 - _EDGE)))
        value = getattr(section, self.key)
        if self.key == "derivative_filter":
            value = 1 / (value * (section.derivative_time or 0.0))
        return self.unknown(value)

    def unknown(self, value: float) -> float:
        """x of a value; at a limit, and beyond, just within."""
        room = self.limit - self.least
        return float(-np.log(1 / np.clip(value - self.least, _EDGE, (1 - _EDGE) * room) - 1 / room))

    def value(self, x: Any) -> Any:
        return (
            _PHASE * np.tanh(x)
            if self.key == "phase"
            else self.least + 1 / (1 / (self.limit - self.least) + np.exp(-x))
        )


@dataclass(frozen=True, slots=True, eq=False)
class FilterBank:
    """base: settings with a chain for every channel, whose numbers the unknowns replace; as
    ``Structure`` for the descent.
    """

    base: PidSettings
    axes: tuple[str, ...]
    mixing: tuple[np.ndarray, np.ndarray]
    unknowns: tuple[_Unknown, ...]

    def theta(self, x: np.ndarray) -> np.ndarray:
        """Theta (m+n, p+n) of the unknowns x (k,)."""
        chains = [
            chain(item.gain, [section_matrix(section) for section in item.sections])
            for item in self.settings(x).channels
        ]
        return bank(chains, *self.mixing)

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C and D of the unknowns."""
        T, m = self.theta(x), len(self.axes)
        return T[m:, m:], T[m:, :m], T[:m, m:], T[:m, :m]

    def controller(self, x: np.ndarray) -> StateSpace:
        """The controller of the unknowns."""
        return theta_system(self.theta(x), self.axes)

    def settings(self, x: np.ndarray) -> PidSettings:
        """The [controller] of the unknowns."""
        found: list[dict[Any, dict[str, float]]] = [{} for _ in self.base.channels]
        for item, value in zip(self.unknowns, x, strict=True):
            for c in item.channels:
                found[c].setdefault(item.section, {})[item.key] = float(
                    item.value(max(-_FAR, min(value, _FAR)))
                )
        return replace(
            self.base,
            channels=tuple(
                replace(
                    channel,
                    gain=numbers[-1]["gain"],
                    sections=tuple(
                        replace(part, **_own(numbers.get(i, {})))
                        for i, part in enumerate(channel.sections)
                    ),
                )
                for channel, numbers in zip(self.base.channels, found, strict=True)
            ),
        )

    law = settings  # what is tuned

    def gradient(self, x: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """df/dx (k,) from df/dTheta (m+n, p+n)."""
        settings = self.settings(x)
        m = len(self.axes)
        result = np.zeros(len(x))
        start = 0
        into, out = self.mixing
        mine = [
            [k for k, item in enumerate(self.unknowns) if c in item.channels]
            for c in range(len(settings.channels))
        ]
        for c, channel in enumerate(settings.channels):
            # The chain T = diag(gain, I) P_k .. P_1 in the order (signal, states), the sections P_i
            # embedded.
            parts = embedded([section_matrix(section) for section in channel.sections])
            size = len(parts[0]) if parts else 1
            states = slice(m + start, m + start + size - 1)

            # df/dT from Theta = [[out D into, out C], [B into, A]]
            back = np.empty((size, size))
            back[0, 0] = out[:, c] @ slope[:m, :m] @ into[c]
            back[0, 1:], back[1:, 0] = out[:, c] @ slope[:m, states], slope[states, :m] @ into[c]
            back[1:, 1:] = slope[states, states]
            start += size - 1

            # before[i] = P_i .. P_1
            before = [np.eye(size)]
            for part in parts:
                before.append(part @ before[-1])

            # dT/d ln gain = the first row of T, the gain times that of P_k .. P_1
            for k in mine[c]:
                if self.unknowns[k].key == "gain":
                    result[k] += channel.gain * (back[0] @ before[-1][0])

            # df/d(P_k .. P_1); then from the last section to the first, back = df/d(P_i .. P_1),
            # df/dP_i = back (P_i-1 .. P_1)^T.
            back[0] *= channel.gain
            end = size
            for i in range(len(parts) - 1, -1, -1):
                share = back @ before[i].T
                # its own entries: the signal, and its states, the last section's at the end
                order = len(section_matrix(channel.sections[i])) - 1
                at = [0, *range(end - order, end)]
                end -= order
                for k in (k for k in mine[c] if self.unknowns[k].section == i):
                    result[k] += float(
                        (
                            share[np.ix_(at, at)]
                            * self._derivative(x, k, mine[c], channel.sections[i])
                        ).sum()
                    )
                back = parts[i].T @ back
        return result

    def _derivative(
        self, x: np.ndarray, k: int, mine: Sequence[int], section: Section
    ) -> np.ndarray:
        """dTheta of one section by the unknown k."""
        numbers = {
            self.unknowns[j].key: self.unknowns[j].value(
                max(-_FAR, min(x[j], _FAR)) + 1j * _STEP * (j == k)
            )
            for j in mine
            if self.unknowns[j].section == self.unknowns[k].section
        }
        return np.asarray(section_matrix(section, _own(numbers)).imag / _STEP)


def at_limits(settings: PidSettings, machine: Machine, fastest: float) -> list[str]:
    """The numbers of a tuned bank that ended at a limit of the search, each with its limit and the
    channels where it did.
    """
    found, x = filter_bank(settings, machine, fastest)
    where: dict[str, list[str]] = {}
    for item, at in zip(found.unknowns, x, strict=True):
        value, channel = float(item.value(at)), settings.channels[item.channels[0]]
        names = [name for c in item.channels for name in settings.channels[c].names]
        room = item.limit - item.least if np.isfinite(item.limit) else item.least
        ends = [
            end
            for end in (item.least, item.limit)
            if 0 < end < np.inf and abs(value - end) <= _AT * room
        ]
        for end in ends if item.key != "phase" else ():
            section = channel.sections[item.section]
            corner = item.key == "derivative_filter"
            words = (
                f"filter frequency {end / (2 * np.pi):.4g} Hz"
                if corner
                else section_text(section, {item.key: end})
            )
            where.setdefault(f"{section.kind} {words}", []).extend(names)
    return [f"{text} ({', '.join(dict.fromkeys(names))})" for text, names in where.items()]


def advice(structure: str) -> str:
    """How a structure that is not enough can be given more: a PID has one order only."""
    return "choose structure 'filters' or 'free'" if structure == "pid" else "allow a higher order"


def _own(numbers: dict[str, Any]) -> dict[str, Any]:
    """A section's own keys: eps from the corner of the derivative's filter."""
    if "derivative_filter" in numbers:
        return {
            **numbers,
            "derivative_filter": 1 / (numbers["derivative_filter"] * numbers["derivative_time"]),
        }
    return numbers


def filter_bank(
    settings: PidSettings, machine: Machine, fastest: float
) -> tuple[FilterBank, np.ndarray]:
    """The structure of settings with a chain for every channel, and its unknowns; fastest [rad/s]:
    limit of its poles.

    The two channels of a bearing or a rigid mode share theirs where nothing tells them apart
    (``_alike``).
    """
    unknowns, x = [], []
    for group in _alike(settings, machine):
        channel = settings.channels[group[0]]
        found = [_Unknown(group, -1, "gain")]
        for i, section in enumerate(channel.sections):
            for key in SECTIONS[section.kind]:
                if section.kind == "sos" or getattr(section, key) is None:
                    continue
                if key == "derivative_filter" and section.derivative_time is None:
                    continue  # of a term that is not there
                fast = key in {"derivative_filter", "pole_frequency"} or section.kind == "low-pass"
                limits = (
                    _DAMPED[section.kind]
                    if key in {"damping", "pole_damping"}
                    else (0.0, fastest if fast else np.inf)
                )
                if key == "zero_damping":
                    limits = _LEAST, np.inf
                if key == "integral_time":
                    limits = 0.0, max(_SLOWEST, getattr(section, key))
                found.append(_Unknown(group, i, key, limits[1], limits[0]))
        unknowns += found
        x += [
            item.start(
                channel.sections[item.section] if item.section >= 0 else Section(""), channel.gain
            )
            for item in found
        ]
    return FilterBank(
        settings, machine.axes, mixings(settings, machine), tuple(unknowns)
    ), np.array(x)


def _alike(settings: PidSettings, machine: Machine) -> list[tuple[int, ...]]:
    """Which channels are one to the search: both of a bearing (of a mode: everywhere) that start
    alike, on magnets alike.
    """
    if len(machine.axes) == 1:
        return [(0,)]
    # k_i, k_s; bearing; axis
    pairs = np.reshape(magnet_coefficients(machine, machine.operation.design), (2, -1, 2))
    same = (np.abs(pairs[..., 0] - pairs[..., 1]) <= _SAME * np.abs(pairs).max(axis=2)).all(axis=0)
    groups: list[tuple[int, ...]] = []
    for c, channel in enumerate(settings.channels):
        before = settings.channels[c - 1]
        twin = same.all() if settings.coordinates != "axes" else same[c // 2]
        if c % 2 and twin and (before.gain, before.sections) == (channel.gain, channel.sections):
            groups[-1] = (c - 1, c)
        else:
            groups.append((c,))
    return groups


def first_bank(
    settings: PidSettings, machine: Machine, structure: str, order: int | None, fastest: float
) -> PidSettings:
    """The chains that tuning starts from: for every channel the PID of ``settings`` completed, and
    a low pass.

    structure "filters" adds notches that do nothing yet, at the bending modes, until the order is
    reached (None: one per channel). Sections that the settings have besides stay. Raises
    InvalidInput for an order that the structure does not have.
    """
    names = channel_names(settings, machine.axes)
    whole = [
        _completed(sections, machine, fastest)
        for _, sections in channel_chains(settings, machine.axes)
    ]
    gains = [gain for gain, _ in channel_chains(settings, machine.axes)]
    if len(settings.gain) > 1 and settings.coordinates != "axes":  # of the axes: no bank has them
        gains = [float(np.mean(settings.gain)) * gain for gain in gains]
    states = sum(
        len(chain(1.0, [section_matrix(item) for item in sections])) - 1 for sections in whole
    )
    extra = 0 if structure == "pid" else _EXTRA
    if order is not None:
        extra, rest = divmod(order - states, 2 * len(names))
        if extra < 0 or rest or (structure == "pid" and extra):
            wanted = (
                f"{states}"
                if structure == "pid"
                else f"{states}, or {2 * len(names)}, {4 * len(names)} ... more"
            )
            raise invalid("order", order, f"{wanted} with structure {structure!r}", "leave it out")

    # Notches at the bending modes: beyond the four rigid ones, one of each pair of planes. Zeros
    # and poles coincide, so that they do nothing yet.
    bending = free_modes(finite_element_rotor(machine), max(extra, 1)).frequencies[4::2]
    places = [min(float(bending[min(i, len(bending) - 1)]), 0.5 * fastest) for i in range(extra)]
    notches = tuple(
        Section(
            "notch",
            zero_frequency=w,
            zero_damping=_DAMPING,
            pole_frequency=w,
            pole_damping=_DAMPING,
        )
        for w in places
    )
    channels = (
        Channel((name,), gain, (*sections, *notches))
        for name, gain, sections in zip(names, gains, whole, strict=True)
    )
    kept = {key: getattr(settings, key) for key in ("coordinates", "sample_time", "delay")}
    found, x = filter_bank(PidSettings(channels=tuple(channels), **kept), machine, fastest)

    # The start is kept off the limits.
    most = [
        item.unknown(_INSIDE * item.limit) if np.isfinite(item.limit) else np.inf
        for item in found.unknowns
    ]
    least = [
        item.unknown(1.5 * _LEAST) if item.key == "zero_damping" else -np.inf
        for item in found.unknowns
    ]
    # what starts at a limit would not leave it again
    return found.settings(np.clip(x, least, most))


def _completed(
    sections: tuple[Section, ...], machine: Machine, fastest: float
) -> tuple[Section, ...]:
    """The chain with all three terms of a PID, those that lack as in ``first_settings``, and a low
    pass.
    """
    given = next((item for item in sections if item.kind == "pid"), Section("pid"))
    pid = replace(given, derivative_filter=given.derivative_filter or DERIVATIVE_FILTER)
    rest = tuple(item for item in sections if item is not given)
    if pid.integral_time is None or pid.derivative_time is None:
        first = first_settings(machine)
        pid = replace(
            pid,
            integral_time=pid.integral_time or first.integral_time,
            derivative_time=pid.derivative_time or first.derivative_time,
        )
    if not any(item.kind == "low-pass" for item in rest):
        rest += (Section("low-pass", frequency=0.5 * fastest, damping=float(np.sqrt(0.5))),)
    return (pid, *rest)
