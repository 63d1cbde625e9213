"""A scheduled controller on its way to files: what it is refused for, what its header says."""

from __future__ import annotations

from collections.abc import Sequence

from ambrose import __version__
from ambrose.core.checks import invalid
from ambrose.core.scheduled import ScheduledSystem
from ambrose.deployment.c.scheduled import check_precision
from ambrose.deployment.discretisation.scheduled import ScheduledDeployment, sensitivity_peak, unmet_over_range
from ambrose.machine.machine import Machine
from ambrose.synthesis.result import Synthesis
from ambrose.verification.checks import Checks


def check_deliverable(scheduled: ScheduledSystem, target: str, arithmetic: str) -> None:
    """Refuse what a scheduled controller cannot be written as: targets other than C, fixed point. Raises InvalidInput."""
    if target != "c":
        low, high = scheduled.range
        what = f"{target!r} for a controller scheduled over {low:g} to {high:g} {scheduled.unit} of {scheduled.parameter}"
        remedy = (
            "a scheduled controller is written as C99 only; or write the fixed one of a speed, scheduled.at(speed), to a file"
        )
        raise invalid("the target", what, '"c"', remedy)
    check_precision(arithmetic)


def scheduled_provenance(file: Synthesis, machine: Machine | None, deployment: ScheduledDeployment) -> Sequence[str]:
    """The lines of the header that say where the controller comes from and what it was verified on."""
    made, (low, high) = file.provenance, deployment.sampled.range
    lines = [
        f"Controller {file.method}, written {made.date} by ambrose {made.package_version}; code by ambrose {__version__}.",
        f"Machine    {made.machine or 'not recorded'}, hash {made.machine_hash or 'not recorded'}.",
        f"Sampled    by {deployment.method} at every grid point, computing delay in the loop [samples]: {deployment.delay}.",
        f"Between    grid points within {deployment.deviation:.2g} of the gain of the sampled continuous controller (worst at "
        f"{deployment.deviation_at:.6g} rad/s).",
    ]
    if machine is None:
        lines.append("Verified   NOT: the sampled loop was not examined.")
    else:
        stable = sum(c.stable for c in deployment.checks)
        peak, where = sensitivity_peak(deployment.checks)
        lines.append(
            f"Verified   stable at {stable} of {len(deployment.checks)} frozen speeds from {low:.6g} to {high:.6g} rad/s, "
            f"sensitivity peak {peak:.3g} (at {where})."
        )
    lines += [f"Verified   {c.label}: {_verdict(c)}." for c in deployment.points]
    for box in deployment.box:
        count = box.checks[0]
        lines.append(f"Verified   {box.label}: {count.value:.0f} unstable of {count.detail}.")
    for c in deployment.outside:
        lines.append(f"Outside    the range, clamped, {c.label}: {_verdict(c)}.")
    lines += [f"Forced     although {problem}." for problem in deployment.problems]
    return lines + [f"Unmet      {text}." for text in unmet_over_range(deployment)]


def _verdict(checks: Checks) -> str:
    if not checks.stable:
        return "UNSTABLE"
    return f"stable, sensitivity peak {sensitivity_peak([checks])[0]:.3g}"
