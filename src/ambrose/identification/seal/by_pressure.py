"""A seal's coefficients pressure by pressure, beside the identification of all else: into the machine, as data, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.identification.findings import Finding
from ambrose.identification.model_updating import update_machine
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.seal.model_updating import update_seal
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, line
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter


@dataclass(frozen=True, slots=True, eq=False)
class SealByPressure:
    """fit: the coefficients at every pressure; form: how the machine holds them, "line" or "table"; highest [Pa]: pressure of
    all operating points."""

    fit: SealFit
    form: str
    highest: float

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What makes the coefficients at some pressure doubtful."""
        return tuple(replace(item, what=f"seal {self.fit.seal} {item.what}") for item in self.fit.warnings)

    @property
    def note(self) -> str:
        """Where operating points lie above the highest pressure measured, to which the line goes on; else ""."""
        top = float(self.fit.pressure.max())
        if self.highest <= top * (1 + 1e-9):
            return ""
        return f"the lines of seal {self.fit.seal} go on to {self.highest:g} Pa; the highest pressure measured is {top:g} Pa"

    @property
    def origin(self) -> str:
        return f"seal {self.fit.seal} as a {self.form} over {len(self.fit.pressures)} pressures"

    @property
    def lines(self) -> list[str]:
        """What the file says above the machine about its seal."""
        fit = self.fit
        forms = {"line": "the regression lines over pressure", "table": "the values at these pressures, linear between"}
        rows = [f"Seal {fit.seal}, pressure by pressure (standard deviations in brackets); in the file: {forms[self.form]}."]
        for i, pressure in enumerate(fit.pressure):
            texts = [f"{c} {fit.values[i, j]:.4g} ({fit.deviations[i, j]:.2g})" for j, c in enumerate(COEFFICIENTS)]
            rows.append(f"  {pressure:g} Pa: {', '.join(texts)}")
        return [*rows, f"Note: {self.note}."] if self.note else rows

    def update(self, machine: Machine, result: ParameterEstimate) -> Machine:
        """The machine with the values of ``result``, and the seal over pressure in their place, each with its tolerance."""
        return update_seal(update_but_seal(machine, result, self.fit.seal), self.fit, self.form)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI; ``deviations`` are standard deviations."""
        fit, lines = self.fit, {}
        for letter in COEFFICIENTS if self.form == "line" else ():
            one = line(fit, letter)
            lines[letter] = {
                "intercept": one.intercept, "slope": one.slope, "scatter": one.scatter,
                "covariance": one.covariance.tolist(), "slope_probability": one.slope_probability,
            }  # fmt: skip
        return {
            "name": fit.seal, "form": self.form, "pressure": fit.pressure.tolist(), "coefficients": list(COEFFICIENTS),
            "values": fit.values.tolist(), "deviations": fit.deviations.tolist(), "correlation": fit.correlation.tolist(),
            "lines": lines or None, "warnings": [str(finding) for finding in fit.warnings], "note": self.note,
        }  # fmt: skip


def is_of_seal(path: str, name: str) -> bool:
    """Whether a path is a coefficient K, k, C or c of a seal."""
    if path in TIMING:
        return False
    parameter = parse_parameter(path)
    return (parameter.table, parameter.name) == ("seal", name) and parameter.quantity in COEFFICIENTS


def update_but_seal(machine: Machine, result: ParameterEstimate, name: str) -> Machine:
    """The machine with the values of ``result``, but for the seal's coefficients."""
    kept = np.array([i for i, path in enumerate(result.paths) if not is_of_seal(path, name)], dtype=int)
    if not len(kept):
        return machine
    part = replace(
        result, paths=tuple(result.paths[i] for i in kept), values=result.values[kept], start=result.start[kept],
        covariance=result.covariance[np.ix_(kept, kept)], correlation=result.correlation[np.ix_(kept, kept)],
        column_cosine=result.column_cosine[np.ix_(kept, kept)],
    )  # fmt: skip
    return update_machine(machine, part, keep_wider=True)
