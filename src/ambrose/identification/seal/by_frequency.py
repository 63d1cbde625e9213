"""A seal's coefficients over frequency and pressure from records, into the machine: no controller
is needed, nothing is fitted.

    done = identify_by_frequency(machine, ["zero.h5", "one-bar.h5", "two-bar.h5"])
    done.machine, done.fit, done.findings

Stepped sines give their frequencies; chirps, binary sequences and noise give those asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented
from ambrose.identification.data_quality.signals import signal_findings
from ambrose.identification.findings import Finding, refuse
from ambrose.identification.frf.stepped import is_stepped
from ambrose.identification.seal import stepped_sine
from ambrose.identification.seal.by_pressure import beyond_tolerance, scattered
from ambrose.identification.seal.model_updating import FORMS, update_seal
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, averaged, line
from ambrose.machine.machine import Machine
from ambrose.model.assemble import seal_coefficients
from ambrose.record.files import read_record
from ambrose.record.record import Record

# [Hz], of broadband records where nothing else is asked for; assumed
_LOWEST, _HIGHEST = 5.0, 100.0
_LINES = 20  # from the one to the other


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SealByFrequency(Presented):
    """fit: a row per pressure and frequency; machine: the one given, with the seal as found in the
    form "line", "table" or "frequency"; reference: whether what the model lacks was found without
    pressure and taken off; records: their names.
    """

    given: Machine
    machine: Machine
    fit: SealFit
    form: str
    reference: bool
    findings: tuple[Finding, ...]
    records: tuple[str, ...] = ()

    @property
    def constants(self) -> SealFit:
        """One row per pressure: means over the frequencies."""
        return averaged(self.fit)

    @property
    def passed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.findings

    def facts(self) -> dict[str, Any]:
        """Where it was measured and what it is at the highest pressure."""
        top, f = self.constants.values[-1], self.fit.frequency / 2 / np.pi
        at = (
            f"{len(self.fit.pressures)} pressures to {self.fit.pressure.max() / 1e5:.4g} bar, "
            f"{f.min():.4g} to {f.max():.4g} Hz"
        )
        values = {letter: float(value) for letter, value in zip(COEFFICIENTS, top, strict=True)}
        return {"seal": self.fit.seal, "measured at": at, **values, "findings": len(self.findings)}

    @property
    def comment(self) -> str:
        """What the file says above the machine about its seal."""
        forms = {
            "line": "regression lines over pressure",
            "table": "the values at these pressures",
            "frequency": "every row",
        }
        rows = [
            f"Seal {self.fit.seal} from {', '.join(self.records) or 'records'}: {self.fit.method}."
        ]
        rows += [
            "Means over the frequencies (standard deviations in brackets); in the file: "
            f"{forms[self.form]}."
        ]
        mean = self.constants
        for i, pressure in enumerate(mean.pressure):
            texts = [
                f"{c} {mean.values[i, j]:.4g} ({mean.deviations[i, j]:.2g})"
                for j, c in enumerate(COEFFICIENTS)
            ]
            rows.append(f"  {pressure:g} Pa: {', '.join(texts)}")
        rows += [f"Doubt: {finding}" for finding in self.findings]
        return "".join(f"# {row}\n" for row in rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI; deviations are standard deviations."""
        fit, mean = self.fit, self.constants
        entries = None if np.isnan(fit.entries).any() else fit.entries.tolist()
        return {
            "machine": self.given.name,
            "seal": fit.seal,
            "form": self.form,
            "method": fit.method,
            "reference": self.reference,
            "pressure": fit.pressure.tolist(),
            "frequency": fit.frequency.tolist(),
            "coefficients": list(COEFFICIENTS),
            "values": fit.values.tolist(),
            "deviations": fit.deviations.tolist(),
            "entries": entries,
            "systematic": fit.systematic.tolist(),
            "means": {
                "pressure": mean.pressure.tolist(),
                "values": mean.values.tolist(),
                "deviations": mean.deviations.tolist(),
            },
            "lines": _lines(mean),
            "findings": [str(finding) for finding in self.findings],
            "records": list(self.records),
        }


def identify_by_frequency(
    machine: Machine,
    records: Sequence[Record | str | Path],
    *,
    seal: str | None = None,
    form: str | None = None,
    frequencies: Sequence[float] | None = None,
    settle: float = 0.3,
    currents: str | None = None,
    harmonics: int = 3,
    progress: Callable[[str], None] = lambda stage: None,
) -> SealByFrequency:
    """The seal's K, k, C, c at every pressure of the records (record.point.seal_pressure) and every
    frequency driven.

    records: with y_<axis>, excitations e_<axis> along both directions, and i_<axis> or u_<axis>;
    those without pressure, where there are any, tell what the model lacks (couplings and bearings a
    little off, run-out of the model), which is taken off the others: the baseline. seal: its name,
    where there are several. form: "line" over pressure, "table" or "frequency" (None: lines from
    three pressures on, else a table). frequencies [rad/s]: of broadband records (None: 20 from 5 to
    100 Hz); settle [s]: left out of each sine; currents: "measured" or "commanded" (None: measured
    where recorded). Raises InvalidInput.
    """
    if not records:
        raise InvalidInput(
            "no record was given; record at several seal pressures, without pressure too"
        )
    if form is not None and form not in FORMS:
        raise invalid("form", repr(form), f"one of {', '.join(FORMS)}", "correct it")
    progress(f"reading {len(records)} record{'s' * (len(records) > 1)}")
    loaded = [item if isinstance(item, Record) else read_record(item) for item in records]
    names = tuple(Path(item).name for item in records if not isinstance(item, Record))
    checked = [
        finding
        for number, record in enumerate(loaded, 1)
        for finding in signal_findings(machine, record, number)
    ]
    refuse(checked)
    kinds = [is_stepped(record, [n for n in record.signals if n[:2] == "e_"]) for record in loaded]
    if len(set(kinds)) > 1:
        raise InvalidInput(
            "some records hold stepped sines and others do not; give those of one kind"
        )
    reference = any(record.point.seal_pressure == 0 for record in loaded)
    lines = None
    if not kinds[0]:
        lines = list(frequencies or 2 * np.pi * np.linspace(_LOWEST, _HIGHEST, _LINES))
    elif frequencies:
        raise InvalidInput(
            "frequencies are those of the steps where the records hold stepped sines; leave them "
            "out"
        )
    progress(f"the seal at {len({record.point.seal_pressure for record in loaded})} pressures")
    fit = stepped_sine.identify(
        machine,
        loaded,
        seal=seal,
        settle=settle,
        currents=currents,
        reference=reference,
        lines=lines,
        harmonics=harmonics,
    )
    fit = with_baseline(machine, fit, loaded) if reference else fit
    mean = averaged(fit)
    form = form or ("line" if len(mean.pressures) > 2 else "table")
    if form == "line" and len(mean.pressures) < 3:
        raise invalid(
            "the number of seal pressures for a line",
            len(mean.pressures),
            "at least 3",
            "take the form table",
        )
    off = [item for item, matters in scattered(mean) if matters] if form == "line" else []
    findings = (*checked, *fit.warnings, *off, *beyond_tolerance(machine, mean))
    return SealByFrequency(
        machine, update_seal(machine, fit, form), fit, form, reference, findings, names
    )


def with_baseline(machine: Machine, fit: SealFit, records: Sequence[Record]) -> SealFit:
    """The fit with the rows without pressure, from which all others were measured: the machine's
    own coefficients there, each with the largest deviation found at its frequency.
    """
    item = next(one for one in machine.seals if one.name == fit.seal)
    point = next(record.point for record in records if record.point.seal_pressure == 0)
    keys, first = np.unique(fit.frequency, return_index=True)
    rows = []
    for w, at in zip(keys.tolist(), first.tolist(), strict=True):
        baseline = seal_coefficients(item, replace(point, whirl_frequency=w))
        row, same = fit.rows(np.array([at])), fit.rows(fit.frequency == w)
        values = np.array([[baseline.K, baseline.k, baseline.C, baseline.c]])
        whole = np.array(
            [
                [
                    baseline.K,
                    baseline.k,
                    baseline.k,
                    baseline.K,
                    baseline.C,
                    baseline.c,
                    baseline.c,
                    baseline.C,
                ]
            ]
        )
        rows.append(
            replace(
                row,
                pressure=np.zeros(1),
                values=values,
                deviations=same.deviations.max(axis=0, keepdims=True),
                entries=np.where(np.isnan(row.entries), np.nan, whole),
                entry_deviations=same.entry_deviations.max(axis=0, keepdims=True),
            )
        )
    return fit.joined(*rows)


def _lines(mean: SealFit) -> dict[str, Any] | None:
    if len(mean.pressures) < 3:
        return None
    lines = {letter: line(mean, letter) for letter in COEFFICIENTS}
    return {
        letter: {
            "intercept": one.intercept,
            "slope": one.slope,
            "scatter": one.scatter,
            "covariance": one.covariance.tolist(),
        }
        for letter, one in lines.items()
    }
