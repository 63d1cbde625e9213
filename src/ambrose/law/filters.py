"""Filter banks: sections of a controller as matrices, chained per channel, channels mixed with the
bearing axes.

Every part is Theta = [[D, C], [B, A]], so that (output, x') = Theta (input, x): sections in series
are a product of such matrices, each the identity on the others' states. All formulas are analytic
in their parameters and take complex ones: derivatives are exact by a complex step
(fixed_order/bank.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_finite
from ambrose.machine.controller import SECTIONS, PidSettings, Section
from ambrose.machine.validation.controller import section_problems

DERIVATIVE_FILTER = 0.1  # time constant over the derivative's, where none is stated
_UNITS = {"time": (1e3, "ms"), "frequency": (0.5 / np.pi, "Hz"), "phase": (180 / np.pi, "deg")}


def pid(
    integral_time: Any = None, derivative_time: Any = None, derivative_filter: Any = None
) -> np.ndarray:
    """1 + 1/(T_i s) + T_d s/(eps T_d s + 1), parallel form (Lauridsen 2017, paper P5, eq. 6); times
    [s], None: no such term.
    """
    D = 1.0
    C = list[Any]()
    B = list[Any]()
    A = list[Any]()
    if integral_time is not None:
        A = [0.0]
        B = [1 / integral_time]
        C = [1.0]
    if derivative_time is not None:
        eps = DERIVATIVE_FILTER if derivative_filter is None else derivative_filter
        # T_d s/(eps T_d s + 1) = (1 - corner/(s + corner))/eps
        corner = 1 / (eps * derivative_time)
        A = [*A, -corner]
        B = [*B, corner]
        C = [*C, -1 / eps]
        D = D + 1 / eps
    return (
        np.block([[np.array([[D]]), np.array([C])], [np.array([B]).T, np.diag(A)]])
        if A
        else np.array([[D]])
    )


def notch(
    zero_frequency: Any, zero_damping: Any, pole_frequency: Any, pole_damping: Any
) -> np.ndarray:
    """(s^2/w_z^2 + 2 d_z s/w_z + 1)/(s^2/w_p^2 + 2 d_p s/w_p + 1): 1 at DC, far off (w_p/w_z)^2;
    frequencies [rad/s].
    """
    w, ratio = pole_frequency, pole_frequency / zero_frequency
    # x1' = w x2, x2' = -w x1 - 2 d_p w x2 + w u: both states have the size of the input.
    C = 1 - ratio**2, 2 * ratio * (zero_damping - ratio * pole_damping)
    return np.array([[ratio**2, *C], [0, 0, w], [w, -w, -2 * pole_damping * w]])


def phase_bump(frequency: Any, phase: Any, damping: Any) -> np.ndarray:
    """A notch of one damping d, zeros at w/r and poles at w r, that turns w by ``phase`` [rad]: r -
    1/r = 2 d tan(phase/2).
    """
    # r - 1/r = 2 t with t = d tan(phase/2): r = t + sqrt(1 + t^2)
    turn = damping * np.tan(phase / 2)
    ratio = turn + np.sqrt(1 + turn**2)
    return notch(frequency / ratio, damping, frequency * ratio, damping)


def lead_lag(zero_frequency: Any, pole_frequency: Any) -> np.ndarray:
    """(s/w_z + 1)/(s/w_p + 1): a lead where the zero is slower than the pole [rad/s], else a
    lag.
    """
    # w_p/w_z + (1 - w_p/w_z) w_p/(s + w_p)
    ratio = pole_frequency / zero_frequency
    return np.array([[ratio, 1 - ratio], [pole_frequency, -pole_frequency]])


def low_pass(frequency: Any, damping: Any) -> np.ndarray:
    """w^2/(s^2 + 2 d w s + w^2): unit gain at DC, 1/(2 d) at the frequency w [rad/s]."""
    # x1' = w x2, x2' = -w x1 - 2 d w x2 + w u, output x1
    w = frequency
    return np.array([[0, 1, 0], [0, 0, w], [w, -w, -2 * damping * w]])


def sos(numerator: Sequence[float], denominator: Sequence[float]) -> np.ndarray:
    """(b2 s^2 + b1 s + b0)/(a2 s^2 + a1 s + a0), or with fewer coefficients of lower order."""
    b, a = (
        np.concatenate([np.zeros(3 - len(values)), np.asarray(values, float)])
        for values in (numerator, denominator)
    )

    # leading coefficient of the denominator 1:   b0 + (b - b0 a)/a
    degree = 2 - int(np.flatnonzero(a)[0])
    b, a = b[2 - degree :] / a[2 - degree], a[2 - degree :] / a[2 - degree]
    rest = b[1:] - b[0] * a[1:]

    if degree == 0:
        return np.array([[b[0]]])
    if degree == 1:
        return np.array([[b[0], rest[0]], [1.0, -a[1]]])

    # x1' = w x2, x2' = -(a2/w) x1 - a1 x2 + w u:   x1 = w^2 u/a, x2 = w s u/a.
    # w = sqrt|a2| makes the states the size of the input; a pole at zero leaves |a1| or 1
    w = float(np.sqrt(abs(a[2]))) or abs(a[1]) or 1.0
    return np.array([[b[0], rest[1] / w**2, rest[0] / w], [0, 0, w], [w, -a[2] / w, -a[1]]])


_FORMS: Mapping[str, Callable[..., np.ndarray]] = {
    "pid": pid,
    "notch": notch,
    "phase-bump": phase_bump,
    "lead-lag": lead_lag,
    "low-pass": low_pass,
    "sos": sos,
}


def section_matrix(section: Section, values: Mapping[str, Any] | None = None) -> np.ndarray:
    """Theta of a section, by its own numbers or by ``values`` under some of its keys."""
    numbers = {key: getattr(section, key) for key in SECTIONS[section.kind]}
    return _FORMS[section.kind](**{**numbers, **(values or {})})


def filter_rows(settings: PidSettings) -> list[tuple[str, str, str]]:
    """Channels, kind and parameters of every section of the chains, in everyday units, for a
    table.
    """
    rows = []
    for channel in settings.channels:
        rows.append((", ".join(channel.names), "gain", f"{channel.gain / 1e3:.4g} A/mm"))
        for section in channel.sections:
            rows.append(("", section.kind, section_text(section)))
    return rows


def section_text(section: Section, numbers: Mapping[str, Any] | None = None) -> str:
    """The parameters of a section, or the numbers given under some of its keys, in everyday
    units.
    """
    numbers = (
        {key: getattr(section, key) for key in SECTIONS[section.kind]}
        if numbers is None
        else numbers
    )
    return ", ".join(_told(key, value) for key, value in numbers.items() if value is not None)


def _told(key: str, value: Any) -> str:
    """A parameter with its unit: times in ms, frequencies in Hz, phases in degrees."""
    scale, unit = next((pair for part, pair in _UNITS.items() if part in key), (1.0, ""))
    numbers = value if isinstance(value, tuple) else [value]
    values = " ".join(f"{scale * number:.4g}" for number in numbers)
    return f"{key.replace('_', ' ')} {values} {unit}".rstrip()


def check_sections(sections: Sequence[Section]) -> None:
    """Raises InvalidInput for the first section that describes no filter."""
    for i, section in enumerate(sections, 1):
        for key, value in section.to_dict().items():
            if key != "kind":
                check_finite(value, f"{key} of a section ({section.kind})")
        for problem in section_problems(f"section {i}", section):
            raise InvalidInput(problem)


def chain(gain: Any, parts: Sequence[np.ndarray]) -> np.ndarray:
    """Theta of sections in series, the first one next to the input, times a gain."""
    result = np.eye(1 + sum(len(part) - 1 for part in parts))
    start = 1
    for part in parts:
        # (signal, x_i') = Theta_i (signal, x_i): row 0 carries the signal to the next section
        at = [0, *range(start, start + len(part) - 1)]
        result[at] = part @ result[at]
        start += len(part) - 1
    result[0] *= gain
    return result


def embedded(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The sections of a chain as matrices of the signal and all states, each the identity on the
    others' states.
    """
    size = 1 + sum(len(part) - 1 for part in parts)
    start = 1
    matrices = []
    for part in parts:
        whole = np.eye(size, dtype=part.dtype)
        at = [0, *range(start, start + len(part) - 1)]
        whole[np.ix_(at, at)] = part
        matrices.append(whole)
        start += len(part) - 1
    return matrices


def bank(chains: Sequence[np.ndarray], into: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Theta of chains side by side between two mixings: into (channels, axes), out (axes,
    channels).
    """
    # chains side by side, block diagonal; u = out (D into e + C x), x' = B into e + A x
    D = np.diag([part[0, 0] for part in chains])
    C, B = (
        sla.block_diag(*rows)
        for rows in ([part[:1, 1:] for part in chains], [part[1:, :1] for part in chains])
    )
    A = sla.block_diag(*[part[1:, 1:] for part in chains])
    return np.block([[out @ D @ into, out @ C], [B @ into, A]])
