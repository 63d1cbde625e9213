"""The lines of a generated file's header: where the controller comes from and what it was verified
on.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from ambrose.code.sampled import Deployment, ScheduledDeployment, sensitivity_peak, unmet_limits
from ambrose.judge.checks import Checks
from ambrose.judge.result import Synthesis
from ambrose.version import __version__


def provenance_lines(
    synthesis: Synthesis, deployment: Deployment | ScheduledDeployment
) -> Sequence[str]:
    """Origin, sampling, verification, and what speaks against the controller, one line each."""
    made = synthesis.provenance
    written = f"written {made.date}" if made.date else "made"
    lines = [
        f"Controller {synthesis.method}, {written} by ambrose {made.package_version}; code by "
        f"ambrose {__version__}.",
        f"Machine    {made.machine or 'not recorded'}, hash {made.machine_hash or 'not recorded'}.",
    ]
    if isinstance(deployment, ScheduledDeployment):
        lines += _over_range(deployment)
    else:
        lines.append(
            f"Sampled    by {deployment.method}, {deployment.delay} samples of computing delay in "
            "the loop."
        )
        lines += [f"Verified   {c.label}: {_verdict(c)}." for c in deployment.checks]
    if not deployment.checks:
        lines.append("Verified   NOT: the sampled loop was not examined.")
    for box in deployment.box:
        count, label = box["sampled.stability.box"], box.label.removesuffix(", sampled")
        lines.append(f"Verified   {label}: {count.value:.0f} unstable of {count.detail}.")
    if isinstance(deployment, ScheduledDeployment):
        lines += [
            f"Outside    the range, clamped, {c.label}: {_verdict(c)}." for c in deployment.outside
        ]
    lines += [f"Forced     although {problem}." for problem in deployment.problems]
    return lines + [f"Unmet      {text}." for text in unmet_limits(deployment)]


def _over_range(deployment: ScheduledDeployment) -> list[str]:
    (low, high), along = deployment.sampled.range, deployment.along
    lines = [
        f"Sampled    by {deployment.method} at every grid point, computing delay in the loop "
        f"[samples]: {deployment.delay}.",
        f"Between    grid points within {deployment.deviation:.2g} of the gain of the sampled "
        "continuous controller (worst at "
        f"{along.number(deployment.deviation_at)}).",
    ]
    if deployment.checks:
        stable = sum(c.stable for c in deployment.checks)
        peak, where = sensitivity_peak(deployment.checks)
        lowest = ", ".join(f"{value:.6g}" for value in (low if along.parts else (low,)))
        lines.append(
            f"Verified   stable at {stable} of {len(deployment.checks)} frozen {along.plural} "
            f"from {lowest} to "
            f"{along.number(high)}, sensitivity peak {peak:.3g} (at {where})."
        )
    return lines + [f"Verified   {c.label}: {_verdict(c)}." for c in deployment.points]


def _verdict(checks: Checks) -> str:
    if not checks.stable:
        return "UNSTABLE"
    with suppress(KeyError):
        return f"stable, sensitivity peak {checks['sensitivity.output.max'].value:.3g}"
    return "stable"
