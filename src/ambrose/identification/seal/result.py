"""Seal coefficients found at several pressures and frequencies, their averages and lines over
pressure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.identification.findings import Finding
from ambrose.identification.seal.regression import Line, fit_line

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
