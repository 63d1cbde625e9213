"""``Response``: measured frequency responses of a loop, path by path, as an analyser leaves them.

Loop and signs are those of core/lft.py, u = K (r - y); of square matrices
S = (I + G K)^-1, T = I - S at the sensors, S = (I + K G)^-1 at the commands, L = 1/S_aa - 1 of an
axis, the other loops closed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented
from ambrose.machine.description import OperatingPoint
from ambrose.machine.units import DIMENSIONS, in_si
from ambrose.record.record import POINT_KEYS, check_operating_point, check_rate

# quantity -> in words, and its SI unit over and under the line
QUANTITIES: Mapping[str, tuple[str, str, str]] = {
    "S": ("sensitivity", "", ""),
    "T": ("closed loop", "", ""),
    "L": ("open loop, the other loops closed", "", ""),
    "G": ("plant, current to displacement", "m", "A"),
    "K": ("controller, error to current", "A", "m"),
    "motion": ("excitation current to displacement", "m", "A"),
}
SENSOR, CURRENT = "sensor", "current"  # where an analyser injects
_KINDS = {"m": "length", "A": "current"}
_FEW = 3  # frequencies at least
_CYCLE = 2 * np.pi  # [rad]
_SAME = 1e-6  # S + T - 1 of columns of which one was computed from the other


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """One measured quotient: values (w,) in SI, variance (w,) E|error|^2 (None: not known).

    quantity: a key of QUANTITIES; read, injected: axes; at: "sensor" or "current", where it was
    injected (S and T of a matrix loop differ by it).
    """

    quantity: str
    read: str
    injected: str
    values: np.ndarray
    variance: np.ndarray | None = None
    at: str = SENSOR

    @property
    def name(self) -> str:
        """As columns are named: "S A_zeta", "T A_eta/A_zeta current"."""
        axes = self.read if self.read == self.injected else f"{self.read}/{self.injected}"
        return f"{self.quantity} {axes}" + (f" {CURRENT}" if self.at == CURRENT else "")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Response(Presented):
    """Frequency responses measured at one operating point.

    machine: its name. omega (w,) [rad/s], rising; paths: at least one, of w values each. date: ISO,
    or empty. sample_rate_hz: of the controller that ran, where the file says it. Raises
    InvalidInput for NaN, repeated or unsorted frequencies, repeated paths.
    """

    machine: str
    omega: np.ndarray
    paths: tuple[Path, ...]
    point: OperatingPoint
    date: str = ""
    sample_rate_hz: float | None = None

    def __post_init__(self) -> None:
        lines = len(self.omega)
        if lines < _FEW or not self.paths:
            raise invalid(
                "the responses",
                f"{len(self.paths)} paths at {lines} frequencies",
                f"at least one at {_FEW}",
                "export more of the sweep",
            )
        if not (np.isfinite(self.omega).all() and self.omega[0] > 0):
            raise InvalidInput("a frequency is zero or no number; leave that line out")
        steps = np.diff(self.omega)
        if not (steps > 0).all():
            k = int(np.argmin(steps > 0)) + 1
            raise InvalidInput(
                f"frequency {k + 1} ({self.omega[k] / (2 * np.pi):g} Hz) does not lie above the "
                "one before it; sort the lines, and leave repeated ones out"
            )
        check_operating_point(self.point)
        if self.sample_rate_hz is not None:
            check_rate(self.sample_rate_hz)
        for name, times in Counter(path.name for path in self.paths).items():
            if times > 1:
                raise InvalidInput(f"{name} is there {times} times; leave out all but one")
        for path in self.paths:
            _check(path, lines, self.omega)

    def kind(self, quantity: str) -> tuple[Path, ...]:
        """The paths of one quantity."""
        return tuple(path for path in self.paths if path.quantity == quantity)

    @property
    def attributes(self) -> dict[str, Any]:
        """All but the numbers, as files have it."""
        point = {key: getattr(self.point, name) for key, name in POINT_KEYS.items()}
        known = {"date": self.date, "sample_rate_hz": self.sample_rate_hz, **point}
        known = {key: value for key, value in known.items() if value not in {None, ""}}
        return {"machine": self.machine, **known}

    def facts(self) -> Mapping[str, Any]:
        return {
            "machine": self.machine,
            "paths": [path.name for path in self.paths],
            "frequencies": len(self.omega),
            "from_hz": float(self.omega[0] / (2 * np.pi)),
            "to_hz": float(self.omega[-1] / (2 * np.pi)),
        }


def _check(path: Path, lines: int, omega: np.ndarray) -> None:
    if path.quantity not in QUANTITIES or path.at not in {SENSOR, CURRENT}:
        raise invalid(
            "the quantity of a path",
            f"{path.quantity!r} at {path.at!r}",
            f"one of {', '.join(QUANTITIES)}, at {SENSOR} or {CURRENT}",
            "correct it",
        )
    for what, numbers in (("values", path.values), ("variances", path.variance)):
        if numbers is None:
            continue
        if numbers.shape != (lines,):
            raise invalid(
                f"the number of {what} of {path.name}",
                numbers.size,
                f"{lines}, as frequencies",
                "export them together",
            )
        finite = np.isfinite(numbers)
        if not finite.all():
            at = omega[int(np.argmin(finite))] / (2 * np.pi)
            raise InvalidInput(
                f"{path.name} at {at:g} Hz is not finite; leave that line out, or measure it again"
            )
    if path.variance is not None and not (path.variance > 0).all():
        raise InvalidInput(f"a variance of {path.name} is not positive; leave the column out")
    if not path.values.all() or np.ptp(np.abs(path.values)) == np.ptp(np.angle(path.values)) == 0:
        raise InvalidInput(f"{path.name} is zero or never changes: a dead channel; leave it out")


def unit_factor(quantity: str, unit: str) -> float:
    """SI per ``unit`` ("um/A", "1/1", "%") of a quantity. Raises InvalidInput."""
    over, under = QUANTITIES[quantity][1:]
    if unit in {"", "-", "1"}:
        return 1.0
    try:
        if not over:
            above, _, below = unit.partition("/")
            if unit == "%" or above == below:
                return 0.01 if unit == "%" else 1.0
            raise ValueError(f"has the unit {unit!r}, but is a plain number")
        above, slash, below = unit.partition("/")
        if not slash:
            raise ValueError(f"has the unit {unit!r}, but is in {over}/{under}")
        factors = [
            in_si(1.0, text.strip(), DIMENSIONS[_KINDS[kind]])
            for text, kind in ((above, over), (below, under))
        ]
        return factors[0] / factors[1]
    except ValueError as error:
        raise InvalidInput(
            f"{quantity} ({QUANTITIES[quantity][0]}) {error}; correct its unit"
        ) from None


def usable(response: Response, axes: Sequence[str], dt: float | None) -> Response:
    """Without the paths that repeat others; raises InvalidInput for what a loop of these axes,
    sampled every ``dt`` (None: continuous), does not have.
    """
    if dt is not None and response.omega[-1] * dt > np.pi * (1 + 1e-9):
        raise InvalidInput(
            f"the highest frequency, {response.omega[-1] / _CYCLE:g} Hz, lies beyond half the "
            f"controller's {1 / dt:g} Hz; state the frequencies' unit (are they in rad/s, not Hz?),"
            " or leave lines out"
        )
    for path in response.paths:
        for axis in (path.read, path.injected):
            if axis not in axes:
                raise InvalidInput(
                    f"{path.name}: there is no axis {axis!r}, the machine has {', '.join(axes)}; "
                    "correct it"
                )
        if path.quantity == "L" and path.read != path.injected:
            raise InvalidInput(f"{path.name}: an open loop is that of one axis; leave it out")
    if not whole(response, axes) and any(p.read != p.injected for p in response.kind("G")):
        raise InvalidInput(
            "the plant is there between different axes, but not between all of them; give all "
            f"{len(axes) ** 2} paths, or the diagonal alone"
        )
    sensitivities = {(p.read, p.injected, p.at): p for p in response.kind("S")}

    def again(path: Path) -> bool:
        other = sensitivities.get((path.read, path.injected, path.at))
        if other is None or path.quantity not in {"T", "L"}:
            return False
        own = float(path.read == path.injected)
        sum_ = other.values + path.values - own
        left = sum_ if path.quantity == "T" else other.values * (1 + path.values) - 1
        return bool(np.abs(left).max() < _SAME)

    return replace(response, paths=tuple(path for path in response.paths if not again(path)))


def whole(response: Response, axes: Sequence[str]) -> bool:
    """Whether the plant between all axes is there."""
    return len(response.kind("G")) == len(axes) ** 2 > 1


def predicted(
    path: Path, axes: Sequence[str], Y: np.ndarray, dY: np.ndarray, K: np.ndarray, every: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A path's values (w,) and derivatives (q, w) from those of Y. every: G of all axes is there,
    then G is the plant's, else that with the other loops closed.
    """
    i, j = axes.index(path.read), axes.index(path.injected)
    T, dT = (K @ Y, K @ dY) if path.at == CURRENT else (Y @ K, dY @ K)
    if path.quantity == "motion":
        return Y[:, i, j], dY[:, :, i, j]
    if path.quantity == "K":
        return K[:, i, j], np.zeros_like(dY[:, :, i, j])
    if path.quantity == "T":
        return T[:, i, j], dT[:, :, i, j]
    S, dS = float(i == j) - T[:, i, j], -dT[:, :, i, j]
    if path.quantity == "S":
        return S, dS
    if path.quantity == "L":
        return 1 / S - 1, -dS / S**2
    KY, dKY = K @ Y, K @ dY
    if every:  # dG = (dY + G K dY) (I - K Y)^-1
        inverse = np.linalg.inv(np.eye(len(axes)) - KY)
        G = Y @ inverse
        return G[:, i, j], ((dY + G @ dKY) @ inverse)[:, :, i, j]
    s, ds = 1 - KY[:, i, i], -dKY[:, :, i, i]
    return Y[:, i, i] / s, dY[:, :, i, i] / s - Y[:, i, i] * ds / s**2


def distance(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Between measured and modelled (w,) of paths that belong together, 0 to 1: the median line's,
    in which each path weighs by its size.
    """
    apart = np.sum([np.abs(x - v) for x, v in pairs], axis=0)
    size = np.sum([np.abs(x) + np.abs(v) for x, v in pairs], axis=0)
    return float(np.median(apart / np.maximum(size, 1e-300)))
