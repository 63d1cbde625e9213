"""What an identification is worth, in words: warnings and the verdict of the residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.output_error.levenberg_marquardt import Minimum
from ambrose.identification.output_error.statistics import ResidualTest

_UNSURE, _ALIKE = 0.3, 0.98  # standard deviation over value, and correlation, that are worth a warning


def warnings_of(
    paths: tuple[str, ...],
    minimum: Minimum,
    covariance: np.ndarray,
    correlation: np.ndarray,
    tests: Sequence[ResidualTest],
    verdict: str,
) -> tuple[Finding, ...]:
    """What makes the result doubtful: not converged, hardly visible, hardly told apart, residuals that follow an excitation."""
    warnings = []
    if not minimum.converged:
        what = f"not converged after {minimum.iterations} steps"
        warnings.append(Finding(Code.NOT_CONVERGED, WARNING, what, remedy="begin elsewhere, or leave a parameter out"))
    for path, value, deviation in zip(paths, minimum.x, np.sqrt(np.diag(covariance)), strict=True):
        if value != 0 and deviation > _UNSURE * abs(value):
            what = f"{path} = {value:.4g} has the standard deviation {deviation:.2g}"
            remedy = "excite its axis more, record longer, or take it as known"
            warnings.append(Finding(Code.HARDLY_VISIBLE, WARNING, what, "hardly visible in these records", remedy))
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1)), strict=True):
        what = f"{paths[i]} and {paths[j]} are correlated by {correlation[i, j]:.3f}"
        remedy = "excite where they differ (other frequencies, other axes), or take one as known"
        warnings.append(Finding(Code.CORRELATED, WARNING, what, "hardly told apart", remedy))
    if not all(test.passed for test in tests):
        warnings.append(Finding(Code.RESIDUALS, WARNING, verdict))
    return tuple(warnings)


def verdict_of(tests: Sequence[ResidualTest], converged: bool = True) -> str:
    """One sentence: did the fit converge, do the residuals still follow an excitation, and what to look for if so."""
    return ("" if converged else "NOT CONVERGED, these values are not the best ones; ") + _of_residuals(tests)


def _of_residuals(tests: Sequence[ResidualTest]) -> str:
    failed = [test for test in tests if not test.passed]
    if not failed:
        return "the residuals hold no trace of the excitation: the model explains all that the records tell (99 %)"
    worst = max(failed, key=lambda test: abs(test.correlation) / test.limit)
    return (
        f"the residual of {worst.signal} still follows {worst.excitation} (correlation {worst.correlation:.3f}, "
        f"{abs(worst.correlation) / worst.limit:.1f} times the 99 % limit, {worst.lag} samples later), and so do "
        f"{len(failed) - 1} of {len(tests) - 1} other pairs; the model lacks something: look for a delay, "
        "a different controller, a missing bending mode, magnets beyond their linear range, or a parameter that is not as known"
    )
