"""A seal's coefficients pressure by pressure, beside the identification of all else: into the
machine, as data, in words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, half_width, update_machine
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter, settled
from ambrose.machine.part import Seal, SealTable
from ambrose.model.assemble import seal_coefficients

# A straight line through points with known uncertainties: where the line is, and where the next
# point will be.


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """y = intercept + slope x, weighted least squares through n points.

    covariance (2, 2) of (intercept, slope). scatter: sd of a point of unit weight about the line,
    over what its own sd says (1: as stated; larger: the points scatter more than they claim, and
    every band is widened by it). point_deviation: sd of a further point, its own noise included.
    freedom: n - 2, or n - 1 for a line through the origin. r_squared [-]. apart (n,): how far each
    point is from the line through all others, in stated standard deviations of that difference.
    """

    intercept: float
    slope: float
    covariance: np.ndarray
    scatter: float
    point_deviation: float
    freedom: int
    r_squared: float
    apart: np.ndarray

    def at(self, x: ArrayLike) -> np.ndarray:
        """The line at x."""
        return self.intercept + self.slope * np.asarray(x, dtype=float)

    def deviation(self, x: ArrayLike) -> np.ndarray:
        """Standard deviation of the line at x."""
        x = np.asarray(x, dtype=float)
        S = self.covariance
        return np.sqrt(np.maximum(S[0, 0] + 2 * S[0, 1] * x + S[1, 1] * x**2, 0.0))

    def confidence(self, x: ArrayLike, level: float = 0.95) -> np.ndarray:
        """Half-width of the band that holds the true line at x."""
        return _student(self.freedom, level) * self.deviation(x)

    def prediction(self, x: ArrayLike, level: float = 0.95) -> np.ndarray:
        """Half-width of the band that holds the next measured point at x."""
        return _student(self.freedom, level) * np.sqrt(
            self.deviation(x) ** 2 + self.point_deviation**2
        )

    @property
    def slope_probability(self) -> float:
        """Probability of a slope at least as large, either sign, where there is none (small: the
        slope is real).
        """
        from scipy.special import stdtr

        deviation = float(np.sqrt(self.covariance[1, 1]))
        return (
            2 * float(stdtr(self.freedom, -abs(self.slope) / deviation)) if deviation > 0 else 0.0
        )


def fit_line(
    x: ArrayLike, y: ArrayLike, deviations: ArrayLike | None = None, *, through_origin: bool = False
) -> Line:
    """The line through points x (n,), y (n,) with standard deviations (n,) (None: equal, unknown).

    Where deviations are given, bands follow them, and are widened (never narrowed) when the points
    scatter more: the square root of chi squared over freedom, Birge (1932). Raises InvalidInput for
    fewer points than a line with a scatter needs. Draper & Smith (1998), ch. 1-3.
    """
    x = check_shape(x, "x", "(n)").astype(float)
    n = len(x)
    y = check_shape(y, "y", "(n)", n=n).astype(float)
    least = 2 if through_origin else 3
    if n < least or np.ptp(x) == 0:
        raise invalid(
            "the points of a line",
            f"{n} at {len(np.unique(x))} places",
            f"at least {least}, apart",
            "measure more",
        )
    known = deviations is not None
    sd = (
        check_shape(deviations, "deviations", "(n)", n=n).astype(float)
        if deviations is not None
        else np.ones(n)
    )
    if not (sd > 0).all():
        raise invalid(
            "the smallest standard deviation of a point",
            sd.min(),
            "positive",
            "leave deviations out, or correct it",
        )
    size = np.array([1.0, float(np.abs(x).max())])
    X = np.column_stack([np.ones(n), x / size[1]])[:, 1 if through_origin else 0 :] / sd[:, None]
    inverse = np.linalg.inv(X.T @ X)
    estimate = inverse @ X.T @ (y / sd)
    rest = y / sd - X @ estimate
    freedom = n - X.shape[1]
    birge = float(np.sqrt(rest @ rest / freedom))
    scatter = max(1.0, birge) if known else birge
    whole = np.zeros((2, 2))
    whole[-len(estimate) :, -len(estimate) :] = inverse * scatter**2
    coefficients = np.concatenate([np.zeros(2 - len(estimate)), estimate]) / size
    weight = 1 / sd**2
    spread = float(weight @ (y - weight @ y / weight.sum()) ** 2)
    share = 1 - float(rest @ rest) / spread if spread > 0 else 0.0
    typical = float(1 / np.sqrt(weight.mean()))
    # what of a point's own deviation is left beside the line
    free = 1 - np.einsum("ij,jk,ik->i", X, inverse, X)
    apart = rest / np.sqrt(np.maximum(free, 1e-300)) / (1.0 if known or not birge else birge)
    apart[free < 1e-9] = 0.0  # the others leave the line open there
    return Line(
        float(coefficients[0]),
        float(coefficients[1]),
        whole / size / size[:, None],
        scatter,
        scatter * typical,
        freedom,
        share,
        apart,
    )


def _student(freedom: int, level: float) -> float:
    from scipy.special import stdtrit

    if not 0 < level < 1:
        raise invalid("level", level, "between 0 and 1", "0.95 is usual")
    return float(stdtrit(freedom, (1 + level) / 2))


# Seal coefficients found at several pressures and frequencies, their averages and lines over
# pressure.


COEFFICIENTS = ("K", "k", "C", "c")
ENTRIES = ("K_xx", "k_xy", "k_yx", "K_yy", "C_xx", "c_xy", "c_yx", "C_yy")
_PER_ROW = (
    "pressure",
    "frequency",
    "values",
    "deviations",
    "entries",
    "entry_deviations",
    "cosine",
    "correlation",
    "systematic",
)


@dataclass(frozen=True, slots=True, eq=False)
class SealFit:
    """Coefficients of one seal, a row per pressure and frequency.

    pressure (n,) [Pa]; frequency (n,) [rad/s], NaN where all frequencies of a record were fitted at
    once. values (n, 4): K, k [N/m], C, c [N s/m] of the symmetric model; deviations (n, 4): their
    standard deviations. entries (n, 8): K_xx, k_xy, k_yx, K_yy, C_xx, c_xy, c_yx, C_yy of [[K_xx,
    k_xy], [-k_yx, K_yy]] and likewise C, NaN where the excitation had one direction;
    entry_deviations (n, 8). cosine (n, 4, 4): between the columns of the Jacobian for K, k, C, c
    (no correlation); correlation (n, 4, 4): of the parameters, from (J'J)^-1. systematic (n, 4):
    what was found without pressure beyond the machine's own and has been taken off; zero without a
    reference. method: in words. warnings: what makes a row doubtful.
    """

    machine: str
    seal: str
    pressure: np.ndarray
    frequency: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    entries: np.ndarray
    entry_deviations: np.ndarray
    cosine: np.ndarray
    correlation: np.ndarray
    systematic: np.ndarray
    method: str
    warnings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.pressure)

    @property
    def pressures(self) -> np.ndarray:
        """The different pressures [Pa], ascending."""
        return np.unique(self.pressure)

    def rows(self, kept: np.ndarray) -> SealFit:
        """The rows (n,) bool or indices only."""
        return replace(self, **{name: getattr(self, name)[kept] for name in _PER_ROW})

    def joined(self, *others: SealFit) -> SealFit:
        """The rows of all, by pressure, then frequency."""
        parts = {
            name: np.concatenate([getattr(one, name) for one in (self, *others)])
            for name in _PER_ROW
        }
        order = np.lexsort((parts["frequency"], parts["pressure"]))
        return replace(self, **{name: part[order] for name, part in parts.items()})  # type: ignore[arg-type]

    def at(self, pressure: float) -> SealFit:
        """The rows at one pressure [Pa]; raises InvalidInput listing the known ones."""
        kept = np.isclose(self.pressure, pressure, rtol=1e-6, atol=1.0)
        if not kept.any():
            known = ", ".join(f"{p:g}" for p in self.pressures)
            raise invalid(
                "the pressure",
                f"{pressure:g} Pa",
                f"one of {known}",
                "choose one that was measured",
            )
        return self.rows(kept)

    def column(self, coefficient: str) -> tuple[np.ndarray, np.ndarray]:
        """Values and standard deviations (n,) of "K", "k", "C", "c" or of one entry such as "K_xx".
        Raises InvalidInput.
        """
        if coefficient in COEFFICIENTS:
            i = COEFFICIENTS.index(coefficient)
            return self.values[:, i], self.deviations[:, i]
        if coefficient in ENTRIES:
            i = ENTRIES.index(coefficient)
            return self.entries[:, i], self.entry_deviations[:, i]
        known = ", ".join((*COEFFICIENTS, *ENTRIES))
        raise invalid("the coefficient", repr(coefficient), f"one of {known}", "correct its name")


def averaged(fit: SealFit, up_to: float = np.inf) -> SealFit:
    """One row per pressure: means over the frequencies up to ``up_to`` [rad/s], weighted by 1/sd^2.

    The deviations allow for scatter beyond the single ones, so a coefficient that depends on
    frequency gets a wide one. Raises InvalidInput where no row is left.
    """
    kept = fit.rows(np.isnan(fit.frequency) | (fit.frequency <= up_to * (1 + 1e-9)))
    if not len(kept):
        raise invalid(
            "up_to", f"{up_to:g} rad/s", f"at least {np.nanmin(fit.frequency):g}", "raise it"
        )
    parts = [_mean(kept.at(pressure)) for pressure in kept.pressures]
    stacked = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _PER_ROW}
    return replace(fit, **stacked, method=f"{fit.method}, mean over frequency")  # type: ignore[arg-type]


def _mean(fit: SealFit) -> SealFit:
    values, deviations = _weighted(fit.values, fit.deviations)
    entries, entry_deviations = _weighted(fit.entries, fit.entry_deviations)
    whole = {
        name: getattr(fit, name).mean(axis=0, keepdims=True)
        for name in ("cosine", "correlation", "systematic")
    }
    return replace(
        fit,
        pressure=fit.pressure[:1],
        frequency=np.array([np.nan]),
        values=values,
        deviations=deviations,
        entries=entries,
        entry_deviations=entry_deviations,
        **whole,
    )


def _weighted(values: np.ndarray, deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if len(values) == 1:
        return values, deviations
    weight = 1 / np.maximum(deviations, 1e-300) ** 2
    mean = (weight * values).sum(axis=0, keepdims=True) / weight.sum(axis=0, keepdims=True)
    birge = np.sqrt((weight * (values - mean) ** 2).sum(axis=0, keepdims=True) / (len(values) - 1))
    return mean, np.maximum(birge, 1.0) / np.sqrt(weight.sum(axis=0, keepdims=True))


def line(fit: SealFit, coefficient: str) -> Line:
    """The regression line of a coefficient over pressure [Pa]; a row per measurement, so repeats
    count. P5, Fig. 7.

    Frequencies are averaged first. Raises InvalidInput for fewer than three pressures.
    """
    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    values, deviations = rows.column(coefficient)
    if np.isnan(values).any():
        raise InvalidInput(
            f"{coefficient} was not identified; excite along both axes for single entries of the "
            "matrices"
        )
    return fit_line(rows.pressure, values, np.maximum(deviations, 1e-300))


# What was found about a seal, written into the machine: coefficients over pressure (or frequency)
# with their tolerances.


_LEVEL = 0.95  # of every tolerance
FORMS = ("line", "table", "frequency")


def update_seal(machine: Machine, fit: SealFit, form: str = "line") -> Machine:
    """The machine with the seal's coefficients as found, and an absolute tolerance for each.

    form "line": regression lines over pressure, as a table from zero to the highest pressure
    measured or operated at; half width of a tolerance: the widest prediction band there. "table":
    the measured pressures themselves, means over frequency, linear between; half width: the largest
    standard deviation times the two-sided normal quantile of 95 %. "frequency": every pressure and
    frequency measured, the lowest frequency down to zero (the seal's frequency_dependence decides
    how it is used). A tolerance that the machine states already and that is wider stays: it may be
    the range of operation. One of the pressure stays with lines, which it moves as one; the other
    forms widen every coefficient by its change over that range. Raises InvalidInput where the fit
    belongs to another machine, or operating points lie outside the table.
    """
    if fit.machine != machine.name:
        raise invalid(
            "the machine of the fit",
            repr(fit.machine),
            repr(machine.name),
            "take the machine it belongs to",
        )
    if form not in FORMS:
        raise invalid("form", repr(form), f"one of {', '.join(FORMS)}", "correct it")
    item = next((one for one in machine.seals if one.name == fit.seal), None)
    if item is None:
        raise invalid(
            "the seal of the fit",
            repr(fit.seal),
            "one of the machine",
            "take the machine it belongs to",
        )
    table, widths = {"line": _line, "table": _table, "frequency": _grid}[form](machine, fit)
    check_reach(machine, item.name, table.axes[0][1][0], table.axes[0][1][-1])
    still = tuple(x for x in item.scales_with_pressure if x == "M")
    dependence = item.frequency_dependence if form == "frequency" else "synchronous"
    zero: dict[str, Any] = dict.fromkeys(COEFFICIENTS, 0.0)
    changed = replace(
        item,
        **zero,
        table=table,
        geometry=None,
        frequency_dependence=dependence,
        scales_with_pressure=still,
    )
    tolerances = list(machine.tolerances)
    ranges = [
        one for one in tolerances if form != "line" and one.parameter == f"seal.{fit.seal}.pressure"
    ]
    for one in ranges:
        tolerances.remove(one)
        widths = widths + _change(machine, changed, one)
    for letter, width in zip(COEFFICIENTS, widths.tolist(), strict=True):
        # of both axes, or of single entries
        stated = [i for i, one in enumerate(tolerances) if _names(one, fit.seal, letter)]
        for i in stated:
            if (
                half_width(
                    tolerances[i],
                    getattr(seal_coefficients(changed, machine.operation.nominal), letter),
                )
                < width
            ):
                tolerances[i] = replace(tolerances[i], relative=None, absolute=width)
        if not stated:
            tolerances.append(Tolerance(f"seal.{fit.seal}.{letter}", absolute=width))
    seals = tuple(changed if one is item else one for one in machine.seals)
    updated = replace(machine, seals=seals, tolerances=tuple(tolerances))
    return replace(updated, assumed=settled(machine, updated))


_Made = tuple[SealTable, np.ndarray]


def _line(machine: Machine, fit: SealFit) -> _Made:
    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    top = max(
        float(rows.pressure.max()), *(point.seal_pressure for point in machine.operation.envelope)
    )
    ends = np.array([0.0, check_positive(top, "the highest pressure", "measure under pressure")])
    lines = [line(rows, letter) for letter in COEFFICIENTS]
    values = tuple(
        (letter, tuple(one.at(ends).tolist()))
        for letter, one in zip(COEFFICIENTS, lines, strict=True)
    )
    span = np.linspace(0.0, ends[1], 21)
    return SealTable((("pressure", tuple(ends.tolist())),), values), np.array(
        [o.prediction(span, _LEVEL).max() for o in lines]
    )


def _table(machine: Machine, fit: SealFit) -> _Made:
    rows = averaged(fit)
    values = tuple(
        (letter, tuple(rows.values[:, i].tolist())) for i, letter in enumerate(COEFFICIENTS)
    )
    widths = _quantile() * rows.deviations.max(axis=0)
    return SealTable((("pressure", tuple(rows.pressure.tolist())),), values), widths


def _grid(machine: Machine, fit: SealFit) -> _Made:
    kept = fit.rows(np.isfinite(fit.frequency))
    pressures, frequencies = kept.pressures, np.unique(kept.frequency)
    if len(kept) != len(pressures) * len(frequencies) or not len(kept):
        raise InvalidInput(
            "the fit has no full grid of pressures and frequencies; use stepped sines with one "
            "schedule"
        )
    order = np.lexsort((kept.frequency, kept.pressure))
    shape = len(pressures), len(frequencies)
    grids = [kept.values[order, i].reshape(shape) for i in range(len(COEFFICIENTS))]
    if frequencies[0] > 0:  # the lowest one holds down to standstill, where operating points may be
        frequencies, grids = (
            np.append(0.0, frequencies),
            [np.column_stack([grid[:, 0], grid]) for grid in grids],
        )
    axes = (("pressure", tuple(pressures.tolist())), ("frequency", tuple(frequencies.tolist())))
    values = tuple(
        (x, tuple(map(tuple, grid.tolist()))) for x, grid in zip(COEFFICIENTS, grids, strict=True)
    )
    return SealTable(axes, values), _quantile() * kept.deviations.max(axis=0)


def _change(machine: Machine, item: Seal, pressure: Tolerance) -> np.ndarray:
    """The largest change (4,) of a tabulated seal's coefficients over a tolerance of the pressure,
    SI.
    """
    point, table = (
        machine.operation.nominal,
        dict(item.table.axes)["pressure"] if item.table else (),
    )
    half = half_width(pressure, point.seal_pressure)
    ends = np.clip([point.seal_pressure - half, point.seal_pressure + half], table[0], table[-1])
    at = [point.seal_pressure, *ends, *(x for x in table if ends[0] < x < ends[1])]
    coefficients = [seal_coefficients(item, replace(point, seal_pressure=float(x))) for x in at]
    rows = np.array([[getattr(one, letter) for letter in COEFFICIENTS] for one in coefficients])
    return np.asarray(np.abs(rows - rows[0]).max(axis=0))


def check_reach(machine: Machine, seal: str, low: float, high: float) -> None:
    """Refuse pressures [Pa] of a table that some operating point lies outside of: nothing is
    extrapolated later.
    """
    for point in machine.operation.envelope:
        if not low * (1 - 1e-9) <= point.seal_pressure <= high * (1 + 1e-9):
            raise invalid(
                f"operating point {point.label!r}",
                f"{point.seal_pressure:g} Pa",
                f"within {low:g} to {high:g} Pa, the pressures at which seal {seal} was recorded, "
                "for a table",
                'record there, or take the form "line"',
            )


def _names(tolerance: Tolerance, seal: str, letter: str) -> bool:
    parameter = parse_parameter(tolerance.parameter)
    return (parameter.table, parameter.name, parameter.quantity) == ("seal", seal, letter)


def _quantile() -> float:
    from scipy.special import ndtri

    return float(ndtri((1 + _LEVEL) / 2))


_FAR = 3.0  # standard deviations from which a point is said to be off the line
# of a coefficient's largest value: what is less off is a note, no doubt (as identification.loop has
# it)
_SMALL = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class SealByPressure:
    """fit: the coefficients at every pressure; form: how the machine holds them, "line" or "table";
    highest [Pa]: pressure of all operating points.
    """

    fit: SealFit
    form: str
    highest: float

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What makes the coefficients at some pressure doubtful, points that lie off their line
        among it.
        """
        findings = (*self.fit.warnings, *(item for item, matters in self._scattered if matters))
        return tuple(replace(item, what=f"seal {self.fit.seal} {item.what}") for item in findings)

    @property
    def note(self) -> str:
        """Where operating points lie above the highest pressure measured, to which the line goes
        on, and which points are surely off their line, but hardly; else "".
        """
        top, sentences = float(self.fit.pressure.max()), []
        if self.highest > top * (1 + 1e-9):
            sentences = [
                f"seal {self.fit.seal} is extrapolated to {self.highest:g} Pa; the highest "
                f"measured pressure is {top:g} Pa"
            ]
        sentences += [
            f"seal {self.fit.seal} {item.what}: {item.evidence}"
            for item, matters in self._scattered
            if not matters
        ]
        return "; ".join(sentences)

    @property
    def _scattered(self) -> list[tuple[Finding, bool]]:
        return scattered(self.fit) if self.form == "line" else []

    @property
    def origin(self) -> str:
        return f"seal {self.fit.seal} as a {self.form} over {len(self.fit.pressures)} pressures"

    @property
    def lines(self) -> list[str]:
        """What the file says above the machine about its seal."""
        fit = self.fit
        forms = {
            "line": "the regression lines over pressure",
            "table": "the values at these pressures, linear between",
        }
        rows = [
            f"Seal {fit.seal}, pressure by pressure (standard deviations in brackets); in the "
            f"file: {forms[self.form]}."
        ]
        for i, pressure in enumerate(fit.pressure):
            texts = [
                f"{c} {fit.values[i, j]:.4g} ({fit.deviations[i, j]:.2g})"
                for j, c in enumerate(COEFFICIENTS)
            ]
            rows.append(f"  {pressure:g} Pa: {', '.join(texts)}")
        return [*rows, f"Note: {self.note}."] if self.note else rows

    def update(self, machine: Machine, result: ParameterEstimate) -> Machine:
        """The machine with the values of ``result``, and the seal over pressure in their place,
        each with its tolerance.
        """
        return update_seal(update_but_seal(machine, result, self.fit.seal), self.fit, self.form)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI; ``deviations`` are standard deviations."""
        fit, lines = self.fit, {}
        for letter in COEFFICIENTS if self.form == "line" else ():
            one = line(fit, letter)
            lines[letter] = {
                "intercept": one.intercept,
                "slope": one.slope,
                "scatter": one.scatter,
                "covariance": one.covariance.tolist(),
                "slope_probability": one.slope_probability,
            }
        return {
            "name": fit.seal,
            "form": self.form,
            "pressure": fit.pressure.tolist(),
            "coefficients": list(COEFFICIENTS),
            "values": fit.values.tolist(),
            "deviations": fit.deviations.tolist(),
            "correlation": fit.correlation.tolist(),
            "lines": lines or None,
            "warnings": [str(finding) for finding in fit.warnings],
            "note": self.note,
        }


def scattered(fit: SealFit) -> list[tuple[Finding, bool]]:
    """Coefficients of which a point lies further than 3 standard deviations from the line through
    the others, and whether it is off by more than 2 % of the coefficient's largest value (assumed),
    from where on it is a doubt.
    """
    rows, outliers = fit if np.isnan(fit.frequency).all() else averaged(fit), []
    # two points are always on a line
    for letter in COEFFICIENTS if len(np.unique(rows.pressure)) > 2 else ():
        (values, deviations), apart = rows.column(letter), np.abs(line(rows, letter).apart)
        at = int(np.argmax(apart))
        if apart[at] <= _FAR:
            continue
        others = np.arange(len(values)) != at
        overdetermined = others.sum() > 2 and np.ptp(rows.pressure[others]) > 0
        rest = (
            fit_line(rows.pressure[others], values[others], np.maximum(deviations[others], 1e-300))
            if overdetermined
            else None
        )
        if rest is None:
            off = float(values[at] - line(rows, letter).at(rows.pressure[at]))
            remedy = (
                "so few pressures do not tell which point is off: record at another one, or take "
                "the form table"
            )
        else:
            off = float(values[at] - rest.at(rows.pressure[at]))
            bent = np.abs(rest.apart).max() > _FAR
            remedy = (
                "without it the others scatter, too: take the form table"
                if bent
                else "the others lie on a line: record it again"
            )
        share = abs(off) / float(np.abs(values).max())
        what = f"{letter} at {rows.pressure[at]:g} Pa is off the line over pressure"
        through = "through all points" if rest is None else "through the other pressures"
        evidence = (
            f"by {apart[at]:.2g} standard deviations, {100 * share:.2g} % of its largest value, "
            f"from the line {through}"
        )
        outliers.append(
            (Finding(Code.SEAL_SCATTER, WARNING, what, evidence, remedy), share > _SMALL)
        )
    return outliers


def beyond_tolerance(machine: Machine, fit: SealFit) -> tuple[Finding, ...]:
    """Coefficients found further from the machine file's at their pressure than its tolerances and
    noise allow.
    """
    item = next(one for one in machine.seals if one.name == fit.seal)
    stated = [(parse_parameter(one.parameter), one) for one in machine.tolerances]
    of_seal = [
        (parameter, one)
        for parameter, one in stated
        if (parameter.table, parameter.name) == ("seal", fit.seal)
    ]
    point, far = machine.operation.nominal, []
    for pressure, values, deviations in zip(
        fit.pressure.tolist(), fit.values, fit.deviations, strict=True
    ):
        try:
            stated_values = seal_coefficients(item, replace(point, seal_pressure=pressure))
        except InvalidInput:  # beyond the file's table: it says nothing there
            continue
        for letter, value, deviation in zip(
            COEFFICIENTS, values.tolist(), deviations.tolist(), strict=True
        ):
            start, widths = float(getattr(stated_values, letter)), []
            for parameter, one in of_seal:
                if parameter.quantity == letter:
                    widths.append(half_width(one, start))
                elif parameter.quantity == "pressure" and pressure:
                    widths.append(half_width(one, pressure) / pressure * abs(start))
            if widths and start and abs(value - start) > max(widths) + COVERAGE * deviation:
                evidence = f"{letter} at {pressure:g} Pa is {value / start:.3g} times the file's"
                far.append(
                    f"{evidence}, beyond its tolerance of {100 * max(widths) / abs(start):.3g} %"
                )
    if not far:
        return ()
    what, remedy = (
        f"seal {fit.seal} is far from the machine file's",
        "look for another pressure or clearance, or a wrong scale",
    )
    return (Finding(Code.FAR_FROM_FILE, WARNING, what, ", ".join(far), remedy),)


def is_of_seal(path: str, name: str) -> bool:
    """Whether a path is a coefficient K, k, C or c of a seal."""
    if path in TIMING:
        return False
    parameter = parse_parameter(path)
    return (parameter.table, parameter.name) == (
        "seal",
        name,
    ) and parameter.quantity in COEFFICIENTS


def update_but_seal(machine: Machine, result: ParameterEstimate, name: str) -> Machine:
    """The machine with the values of ``result``, but for the seal's coefficients."""
    kept = np.array(
        [i for i, path in enumerate(result.paths) if not is_of_seal(path, name)], dtype=int
    )
    if not len(kept):
        return machine
    part = replace(
        result,
        paths=tuple(result.paths[i] for i in kept),
        values=result.values[kept],
        start=result.start[kept],
        covariance=result.covariance[np.ix_(kept, kept)],
        correlation=result.correlation[np.ix_(kept, kept)],
        column_cosine=result.column_cosine[np.ix_(kept, kept)],
    )
    return update_machine(machine, part, keep_wider=True)
