"""Gain, phase, delay and disk margins, each loop opened in turn with the others closed.

The loop seen at one axis with the others closed is L_i = 1/S_ii - 1, because (I + L)^-1_ii = 1/(1 +
L_i) (Schur complement). Disk margins: Seiler, Packard & Gahinet, "An introduction to disk margins",
IEEE Control Systems 40(5), 2020, with skew 0: alpha = 1 / max |S - 1/2|, gain factor (1 +
alpha/2)/(1 - alpha/2), phase 2 arctan(alpha/2).

| check | what | unit |
|---|---|---|
| margin.gain.<where>.<axis> | smallest factor on the gain, or its inverse, before instability | - |
| margin.phase.<where>.<axis> | smallest phase that may be added or taken | rad |
| margin.delay.<where>.<axis> | smallest delay that may be added | s |
| margin.disk.<where> | gain factor all channels bear together, with any phase (a guarantee) | - |

<where> is "output" (loop opened at the sensors) or "input" (at the currents). Each loop is also a
curve: margin.loop.output.
"""

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import largest_gain
from ambrose.judge.checks import Check, Curve, information, judge
from ambrose.judge.loop_response import Evaluator, LoopResponse, peaks_of
from ambrose.machine.criteria import TWO_PI, demand
from ambrose.machine.description import Requirements

SIDES = ("output", "input")
_ITERATIONS = 30  # of the false position, at most
_TOLERANCE = 1e-11  # relative, of a crossing's frequency and value


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """One loop's margins.

    gain_up > 1 and gain_down < 1: factors on the loop gain at which it becomes unstable (inf and 0
    where there is none in the range); phase [rad]; delay [s]; each with its frequency [rad/s] (nan
    without a crossing).
    """

    gain_up: float
    gain_up_at: float
    gain_down: float
    gain_down_at: float
    phase: float
    phase_at: float
    delay: float
    delay_at: float

    @property
    def gain(self) -> float:
        """The smaller of the factors by which the gain may be multiplied or divided."""
        return min(self.gain_up, 1 / self.gain_down if self.gain_down > 0 else np.inf)


def opened_loops(response: LoopResponse, where: str) -> np.ndarray:
    """L_i = 1/S_ii - 1 of every axis, (w, a) complex; where: "output" or "input"."""
    S = response.output_sensitivity() if where == "output" else response.input_sensitivity()
    return 1 / np.einsum("wii->wi", S) - 1


def loop_margins(
    response: LoopResponse, evaluator: Evaluator
) -> dict[str, tuple[LoopMargins, ...]]:
    """The margins of every axis with the loop opened at the "output" and at the "input".

    Crossings are bracketed on the response's grid and then solved for; a pair that falls between
    two neighbouring grid points is missed: use a grid packed around the poles.
    """
    loops = {where: opened_loops(response, where) for where in SIDES}
    crossings = [
        c
        for where in SIDES
        for kind in ("phase", "gain")
        for c in _bracketed(loops[where], where, kind, response)
    ]
    _solve(crossings, evaluator)
    static = _static_loops(evaluator)
    results = {}
    for where in SIDES:
        rows = []
        for axis in range(len(response.axes)):
            mine = [c for c in crossings if c.where == where and c.axis == axis]
            at = {
                kind: np.array([c.high for c in mine if c.kind == kind])
                for kind in ("phase", "gain")
            }
            value = {
                kind: np.array([c.value for c in mine if c.kind == kind], complex)
                for kind in ("phase", "gain")
            }
            if static is not None:
                at["phase"], value["phase"] = (
                    np.append(at["phase"], 0.0),
                    np.append(value["phase"], static[where][axis]),
                )
            rows.append(_margins(at["phase"], value["phase"], at["gain"], value["gain"]))
        results[where] = tuple(rows)
    return results


def _margins(
    at: np.ndarray, value: np.ndarray, gain_at: np.ndarray, gain_value: np.ndarray
) -> LoopMargins:
    # k L = -1 where L is on the negative real axis (1e-6: and was really found there)
    left = (value.real < 0) & (np.abs(value.imag) <= 1e-6 * np.abs(value))
    at, factor = at[left], -1 / value.real[left]
    up, down = factor > 1, factor <= 1

    # turns at |L| = 1
    angle = np.angle(-gain_value)  # 0 at the critical point
    phase = np.abs(angle)
    lag = np.mod(angle, TWO_PI)  # a delay turns clockwise, from this angle down to 0
    with np.errstate(divide="ignore"):
        delay = lag / gain_at

    def smallest(values: np.ndarray, where: np.ndarray) -> tuple[float, float]:
        k = int(np.argmin(values)) if values.size else -1
        return (float(values[k]), float(where[k])) if k >= 0 else (np.inf, np.nan)

    # of the factors below one the largest is the nearest
    fall, fall_at = smallest(-factor[down], at[down])
    return LoopMargins(
        *smallest(factor[up], at[up]),
        -fall if np.isfinite(fall) else 0.0,
        fall_at,
        *smallest(phase, gain_at),
        *smallest(delay, gain_at),
    )


@dataclass(slots=True)
class _Crossing:
    """A sign change of Im L ("phase") or |L| - 1 ("gain") between low and high [rad/s]; value: L at
    ``high``, once solved.
    """

    where: str
    kind: str
    axis: int
    low: float
    high: float
    f_low: float
    f_high: float
    value: complex

    def measure(self, value: complex) -> float:
        return float(value.imag if self.kind == "phase" else abs(value) - 1)


def _bracketed(L: np.ndarray, where: str, kind: str, response: LoopResponse) -> list[_Crossing]:
    f = L.imag if kind == "phase" else np.abs(L) - 1
    positive = f >= 0
    change = positive[:-1] != positive[1:]
    if kind == "phase":  # right of the origin it is no margin
        change &= (L.real[:-1] < 0) | (L.real[1:] < 0)
    omega = response.omega
    return [
        _Crossing(
            where, kind, int(k), omega[i], omega[i + 1], f[i, k], f[i + 1, k], complex(L[i + 1, k])
        )
        for i, k in np.argwhere(change)
    ]


def _solve(crossings: list[_Crossing], evaluator: Evaluator) -> None:
    """Illinois' variant of the false position for all crossings together; ends with ``high`` as the
    best point.
    """
    active = list(crossings)
    for _ in range(_ITERATIONS):
        if not active:
            return
        # false position: the chord's zero
        points = np.array(
            [c.high - c.f_high * (c.high - c.low) / (c.f_high - c.f_low) for c in active]
        )

        response = evaluator(points)
        loops = {where: opened_loops(response, where) for where in SIDES}
        for i, c in enumerate(active):
            value = complex(loops[c.where][i, c.axis])
            f = c.measure(value)
            # the sign changed: the last point is the other end; if not, halve the far end's value
            if (f >= 0) != (c.f_high >= 0):
                c.low, c.f_low = c.high, c.f_high
            else:
                c.f_low *= 0.5
            c.high = float(points[i])
            c.f_high = f
            c.value = value
        active = [
            c
            for c in active
            if abs(c.f_high) > _TOLERANCE * abs(c.value)
            and abs(c.high - c.low) > _TOLERANCE * c.high
        ]


def _static_loops(evaluator: Evaluator) -> dict[str, np.ndarray] | None:
    """L_i at zero frequency (a,); None with an integrator, where the loop gain is unlimited."""
    try:
        response = evaluator(np.zeros(1))
        loops = {where: opened_loops(response, where)[0] for where in SIDES}
    except (InvalidInput, NumericalFailure, np.linalg.LinAlgError):
        return None
    return loops if all(np.isfinite(value).all() for value in loops.values()) else None


def margin_checks(
    response: LoopResponse,
    evaluator: Evaluator,
    requirements: Requirements,
) -> tuple[list[Check], list[Curve]]:
    """The checks of this file's table, and the opened loops' moduli as curves."""
    checks: list[Check] = []
    curves: list[Curve] = []
    margins = loop_margins(response, evaluator)
    disks = peaks_of(
        [lambda r: _disk(r.output_sensitivity()), lambda r: _disk(r.input_sensitivity())],
        response,
        evaluator,
    )
    for where, (disk,) in zip(SIDES, disks, strict=True):
        for axis, m in zip(response.axes, margins[where], strict=True):
            suffix = f"{where}.{axis}"
            checks += [
                judge(
                    f"margin.gain.{suffix}",
                    f"Gain margin at {where} {axis}",
                    m.gain,
                    "-",
                    demand("gain margin", requirements),
                    _gain_detail(m),
                ),
                judge(
                    f"margin.phase.{suffix}",
                    f"Phase margin at {where} {axis}",
                    m.phase,
                    "rad",
                    demand("phase margin", requirements),
                    _at(m.phase_at, "no crossing of unit gain in the range"),
                ),
                information(
                    f"margin.delay.{suffix}",
                    f"Delay margin at {where} {axis}",
                    m.delay,
                    "s",
                    _at(m.delay_at, "no crossing of unit gain in the range"),
                    ">=",
                ),
            ]
        alpha = 1 / disk.value
        factor = (1 + alpha / 2) / (1 - alpha / 2) if alpha < 2 else np.inf
        detail = (
            f"phase {2 * np.degrees(np.arctan(alpha / 2)):.3g} degrees, alpha {alpha:.3g}, "
            f"{_at(disk.frequency)}"
        )
        checks.append(
            information(
                f"margin.disk.{where}",
                f"Disk margin, all {where}s together",
                factor,
                "-",
                detail,
                ">=",
            )
        )
        L = np.abs(opened_loops(response, where)).T
        title = f"Loop gain, opened at each {where}"
        curves.append(
            Curve(
                f"margin.loop.{where}",
                title,
                "frequency",
                response.omega,
                L,
                response.axes,
                "rad/s",
                "-",
                (("unity", 1.0),),
            )
        )
    return checks, curves


def _disk(S: np.ndarray) -> np.ndarray:
    """Largest singular value of S - I/2, (1, w)."""
    return largest_gain(S - 0.5 * np.eye(S.shape[1]))[None, :]


def _gain_detail(m: LoopMargins) -> str:
    up = "any growth" if np.isinf(m.gain_up) else f"x {m.gain_up:.4g} ({_at(m.gain_up_at)})"
    down = "any reduction" if m.gain_down == 0 else f"x {m.gain_down:.4g} ({_at(m.gain_down_at)})"
    return f"tolerates up to {up}, down to {down}"


def _at(frequency: float, otherwise: str = "") -> str:
    return otherwise if np.isnan(frequency) else f"at {frequency / TWO_PI:.4g} Hz"
