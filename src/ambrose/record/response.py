"""``Response``: measured frequency responses of a loop, path by path, as an analyser leaves them.

Loop and signs are those of core/lft.py, u = K (r - y); of square matrices
S = (I + G K)^-1, T = I - S at the sensors, S = (I + K G)^-1 at the commands, L = 1/S_aa - 1 of an
axis, the other loops closed.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented
from ambrose.machine.description import OperatingPoint
from ambrose.machine.units import DIMENSIONS, in_si
from ambrose.record.record import POINT_KEYS, Record, check_operating_point, check_rate

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
SCATTER_DOF = 20  # of a variance that the lines' own scatter tells
VALID = 0.1, np.radians(10.0)  # relative in magnitude, and in phase: a model agrees
_RADIUS = 1.73  # of a complex value's deviation: sqrt(-ln 0.05), the circle that holds 95 %
_LIMIT, _LIMIT_LINES = 0.3, 5  # S or T this near 1 is at its limit of high or low frequency
_SCALE, _SCALE_OF_PLANT = 1.15, 1.7  # factors that are mistakes; of G and L K_i may make less
_FLOOR = 0.05  # of a path's median size, below which noise falls no further
_SMOOTH = 9  # lines whose mean is looked at
_NEARER = 3.0  # a correction brings a path so much nearer


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


_SAME_RATE = 1e-3  # relative, between the rate of a loop and that of what was measured in it
_FASTEST = 1e8  # rad/s; frequencies of machine files end at 1 MHz


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
        if self.omega[-1] > _FASTEST:
            raise InvalidInput(
                f"the last frequency is {self.omega[-1] / (2 * np.pi):.3g} Hz, more than any loop "
                "of a bearing has; correct its unit, or leave that line out"
            )
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

    def at(self, lines: np.ndarray) -> Response:
        """The lines that a mask (w,) has."""
        paths = tuple(
            replace(
                path,
                values=path.values[lines],
                variance=None if path.variance is None else path.variance[lines],
            )
            for path in self.paths
        )
        return replace(self, omega=self.omega[lines], paths=paths)

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


# of any quantity in SI, far beyond those of machines, and far within what doubles can square
_BEYOND = 1e30


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
        if (largest := float(np.abs(numbers).max())) > _BEYOND:
            raise InvalidInput(
                f"one of the {what} of {path.name} is {largest:.3g} in SI units, more than any "
                "machine has; correct its unit, or leave that line out"
            )
    if path.variance is not None and not (path.variance > 0).all():
        raise InvalidInput(f"a variance of {path.name} is not positive; leave the column out")
    if not path.values.all() or np.ptp(np.abs(path.values)) == np.ptp(np.angle(path.values)) == 0:
        raise InvalidInput(f"{path.name} is zero or never changes: a dead channel; leave it out")


Measured = Record | Response | str | File  # what was measured, or its file


def digest_of(response: Response, number: int) -> tuple[str, str]:
    """A name of responses that are of no file, and the SHA-256 of what was measured."""
    digest = hashlib.sha256(repr(response.attributes).encode())
    for path in response.paths:
        digest.update(path.name.encode() + np.ascontiguousarray(path.values).tobytes())
    return f"responses {number}", digest.hexdigest()


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
    rate = response.sample_rate_hz
    if dt is not None and rate is not None and abs(rate * dt - 1) > _SAME_RATE:
        raise InvalidInput(
            f"the responses are of a loop that runs at {rate:g} Hz, and this one runs at "
            f"{1 / dt:g} Hz: the hold and the controller that ran are others; take {rate:g} Hz "
            "(--rate-hz), or correct sample_rate_hz of the responses"
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
    if path.quantity == "motion":
        return Y[:, i, j], dY[:, :, i, j]
    if path.quantity == "K":
        return K[:, i, j], np.zeros_like(dY[:, :, i, j])

    # one entry of a product is a row times a column: of K Y at the current, of Y K at the sensor
    def row_of_K(column: np.ndarray) -> np.ndarray:
        return np.asarray((K[:, i] * column).sum(axis=-1))

    if path.quantity in {"S", "T", "L"}:
        if path.at == CURRENT:
            T, dT = row_of_K(Y[..., j]), row_of_K(dY[..., j])
        else:
            T, dT = ((rows[..., i, :] * K[:, :, j]).sum(axis=-1) for rows in (Y, dY))
        if path.quantity == "T":
            return T, dT
        S, dS = float(i == j) - T, -dT
        return (S, dS) if path.quantity == "S" else (1 / S - 1, -dS / S**2)
    if every:  # G = Y (I - K Y)^-1, dG = (dY + G K dY) (I - K Y)^-1
        inverse = np.linalg.inv(np.eye(len(axes)) - K @ Y)
        row = (Y[:, i, None] @ inverse)[:, 0]
        moved = (dY @ inverse[:, :, j, None])[..., 0]
        through = (row[:, None] @ K)[:, 0]
        return row[:, j], moved[..., i] + (through * moved).sum(axis=-1)
    s, ds = 1 - row_of_K(Y[..., i]), -row_of_K(dY[..., i])
    return Y[:, i, i] / s, dY[:, :, i, i] / s - Y[:, i, i] * ds / s**2


def distance(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Between measured and modelled (w,) of paths that belong together, 0 to 1: the median line's,
    in which each path weighs by its size.
    """
    apart = np.sum([np.abs(x - v) for x, v in pairs], axis=0)
    size = np.sum([np.abs(x) + np.abs(v) for x, v in pairs], axis=0)
    return float(np.median(apart / np.maximum(size, 1e-300)))


def scale_error(path: Path, values: np.ndarray, near_one: np.ndarray | None = None) -> float | None:
    """The factor by which a path is larger than modelled values (w,), where one factor brings it
    much nearer; None: none does. near_one (w,): where the closed loop is near 1 (None: told by S
    and T themselves), so that what is measured is known whatever K_i is.
    """
    x, v = path.values, values
    if near_one is None:
        near_one = np.abs(v - 1) < _LIMIT if path.quantity in "ST" else np.zeros(len(v), bool)
    known = path.quantity == "K"
    if near_one.sum() >= _LIMIT_LINES:
        x, v, known = x[near_one], v[near_one], True
    if not v.all():
        return None
    factor = float(np.exp(np.median(np.log(np.abs(x / v)))))
    if abs(np.log(factor)) < np.log(_SCALE if known else _SCALE_OF_PLANT):
        return None
    return factor if _NEARER * distance([(x / factor, v)]) < distance([(x, v)]) else None


# What a file may say wrongly of its numbers: what it is, and what to write; the values meant.

OTHER = "it is the other of S and T: exchange S and T"
CORRECTIONS: Mapping[str, Callable[[Path], np.ndarray]] = {
    "its sign is turned: add sign = -1 to the path, or turn the channel": lambda p: -p.values,
    OTHER: lambda p: float(p.read == p.injected) - p.values,
    "a lag is positive: turn the sign of the phase": lambda p: p.values.conj(),
    "the gain is absolute, not in dB: state gain in abs": lambda p: (
        20 * np.log10(np.abs(p.values)) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is in dB, not absolute: state gain in dB": lambda p: (
        10 ** np.minimum(np.abs(p.values) / 20, 20) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is in dB and below 1, not absolute: state gain in dB": lambda p: (
        -(10 ** (-np.abs(p.values) / 20)) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is 10 log10: double it": lambda p: p.values * np.abs(p.values),
    "the gain is 40 log10: halve it": lambda p: p.values / np.sqrt(np.abs(p.values)),
    "the phase is in radians, not degrees: state phase in rad": lambda p: (
        np.abs(p.values) * np.exp(1j * np.degrees(np.angle(p.values)))
    ),
}


def readings(items: Sequence[tuple[Path, np.ndarray]]) -> list[tuple[float, str]]:
    """How far paths of one quantity are from modelled values (w,) as each of ``CORRECTIONS`` reads
    them, by ``distance``.
    """
    quantity = items[0][0].quantity
    return [
        (distance([(change(path), values) for path, values in items]), words)
        for words, change in CORRECTIONS.items()
        if quantity in "ST" or words != OTHER
    ]


# What the lines themselves tell of their noise, and up to where a model agrees with them.


def cubic(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Lagrange's weights (w, 4) at x (w,) of nodes (w, 4)."""
    weights = np.ones(nodes.shape)
    for i in range(4):
        for m in range(4):
            if m != i:
                weights[:, i] *= (x - nodes[:, m]) / (nodes[:, i] - nodes[:, m])
    return weights


def scatter(omega: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Variance (w,) of values (w,), at least five: the median over twenty lines of what each is off
    the cubic through its four neighbours, which a resonance that few lines show does not move.
    """
    x, n = np.log(omega), len(omega)
    first = np.clip(np.arange(n) - 2, 0, n - 5)
    window = first[:, None] + np.arange(5)
    others = window[window != np.arange(n)[:, None]].reshape(n, 4)
    weights = cubic(x, x[others])
    miss = np.abs(values - np.einsum("wk,wk->w", weights, values[others])) ** 2
    miss /= 1 + (weights**2).sum(axis=1)
    half = min(SCATTER_DOF // 2, n // 2)
    middle = np.clip(np.arange(n), half, n - 1 - half)
    around = np.clip(middle[:, None] + np.arange(-half, half + 1), 0, n - 1)
    floor = (1e-9 * np.abs(values).max()) ** 2
    return np.asarray(np.median(miss[around], axis=1) / np.log(2) + floor)


def noise_beside(omega: np.ndarray, path: Path, values: np.ndarray) -> np.ndarray:
    """Variance (w,) of a path: as stated, else by what its difference from a model's values (w,),
    over the path's size, scatters from line to line; none of fewer than five lines.
    """
    if path.variance is not None:
        return path.variance
    if len(omega) < _LIMIT_LINES:
        return np.zeros(len(omega))
    size = np.hypot(np.abs(path.values), _FLOOR * np.median(np.abs(path.values)))
    return scatter(omega, (path.values - values) / size) * size**2


@dataclass(frozen=True, slots=True)
class Agreement:
    """Up to which frequency [rad/s] a model agrees within VALID, 0 from the first line; told: the
    share of values below that are not hidden by noise; first: path, frequency [rad/s] and model
    over measurement where it differs (None: nowhere); whole: whether the reach is the last line.
    """

    reach: float
    told: float
    first: tuple[str, float, complex] | None
    whole: bool

    def __str__(self) -> str:
        what = "model and measurement"
        away = ""
        if self.first is not None:
            name, omega, ratio = self.first
            turn = abs(np.degrees(np.angle(ratio)))
            size = f"{abs(abs(ratio) - 1):.0%}, {turn:.0f} degrees"
            away = f"at {omega / _CYCLE:.4g} Hz {name} is {size} off"
        if not self.reach:
            hidden = f"noise hides whether {what} agree within 10 % and 10 degrees; average longer"
            return f"{what} do not agree within 10 % and 10 degrees: {away}" if away else hidden
        text = f"{what} agree within 10 % and 10 degrees up to {self.reach / _CYCLE:.4g} Hz"
        if self.told < 0.995:
            text += f" (told by {self.told:.0%} of the values, noise hides the others)"
        if away:
            return f"{text}; {away}"
        return text if self.whole else f"{text}; above, noise hides it"


def agreement(items: Sequence[tuple[np.ndarray, Path, np.ndarray]]) -> Agreement:
    """Of paths at omega (w,) with a model's values (w,), and their noise by ``noise_beside``, which
    is never what both are apart.

    Measured over modelled, line by line and as a mean over nine: differs where it is outside the
    tolerance by more than all values' noise may make, agrees where it is inside by 95 %.
    """
    count = sum(len(omega) for omega, _, _ in items)
    radius = np.sqrt(np.log(count / 0.05))  # of a complex value, all together: exp(-r^2)
    found = []
    for omega, path, values in items:
        quotient = path.values / np.where(values == 0, 1e-300, values)
        noise = noise_beside(omega, path, values) / np.maximum(np.abs(values), 1e-300) ** 2
        off, agrees = np.zeros(len(omega), bool), np.ones(len(omega), bool)
        shown = quotient
        for width in (1, _SMOOTH):
            ones = np.ones(min(width, len(omega)))
            lines = np.convolve(np.ones(len(omega)), ones, "same")
            mean = np.convolve(quotient, ones, "same") / lines
            sigma = np.sqrt(np.convolve(noise, ones, "same")) / lines
            told = _RADIUS * sigma <= VALID[0]
            away = _outside(mean, radius * sigma)
            shown = np.where(away & ~off, mean, shown)
            off |= away
            agrees &= ~told | ~_outside(mean, _RADIUS * sigma)
        found.append((omega, path.name, 1 / shown, agrees & told & ~off, off))
    differs = [
        (float(omega[int(np.argmax(off))]), name, complex(ratio[int(np.argmax(off))]))
        for omega, name, ratio, _, off in found
        if off.any()
    ]
    first = min(differs, key=lambda item: item[0], default=None)
    below = np.inf if first is None else first[0]
    reach = min(
        float(omega[good & (omega < below)].max(initial=0.0)) for omega, _, _, good, _ in found
    )
    inside = np.concatenate([good[omega <= reach] for omega, _, _, good, _ in found])
    share = float(inside.mean()) if inside.size else 0.0
    whole = reach == max(float(omega[-1]) for omega, *_ in found)
    where = None if first is None else (first[1], first[0], first[2])
    return Agreement(reach, share, where, whole)


def _outside(quotient: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Whether measured over modelled (w,) is off by more than VALID and its radius."""
    size = np.abs(quotient)
    far = np.abs(size - 1) > VALID[0] + radius
    turn = np.where(radius < size, np.arcsin(np.minimum(radius / size, 1.0)), np.pi)
    return np.asarray(far | (np.abs(np.angle(quotient)) > VALID[1] + turn))
