"""``Response``: measured frequency responses of a loop, path by path, as an analyser leaves them.

Loop and signs are those of core/lft.py, u = K (r - y); of square matrices
S = (I + G K)^-1, T = I - S at the sensors, S = (I + K G)^-1 at the commands, L = 1/S_aa - 1 of an
axis, the other loops closed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.machine.description import OperatingPoint
from ambrose.machine.units import DIMENSIONS, in_si
from ambrose.record.record import POINT_KEYS

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
        if self.sample_rate_hz is not None:
            check_positive(self.sample_rate_hz, "sample_rate_hz", "give the controller's, in Hz")
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
