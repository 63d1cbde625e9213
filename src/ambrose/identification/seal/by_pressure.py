"""A seal's coefficients pressure by pressure, beside the identification of all else: into the
machine, as data, in words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.model_updating import update_machine
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, half_width
from ambrose.identification.seal.model_updating import update_seal
from ambrose.identification.seal.regression import fit_line
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, averaged, line
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.model.assemble import seal_coefficients

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
                f"the lines of seal {self.fit.seal} go on to {self.highest:g} Pa; the highest "
                f"pressure measured is {top:g} Pa"
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
