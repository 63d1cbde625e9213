"""Verification between operating points: a range of speeds and pressures, gridded as finely as the
loop changes.
"""

from __future__ import annotations

from ambrose.judge.certificate import certify
from ambrose.judge.checks import Checks, Curve
from ambrose.judge.criteria import judge, required_line
from ambrose.judge.range_search import search
from ambrose.law.law import LawLike
from ambrose.law.loop import running_law
from ambrose.law.timing import Timing
from ambrose.machine.criteria import Demand, demand
from ambrose.machine.description import OperatingRange
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble


def check_range(
    machine: Machine, area: OperatingRange, law: LawLike, timing: Timing | None = None
) -> Checks:
    """Stability and sigma_max(S_o) of the nominal loop over a range; the worst point that is found,
    on the full plant.

    law: a controller or a schedule that covers the range; timing: the loop as it runs (None:
    continuous).
    """
    extremes = search(machine, area, law, timing)
    point = extremes.worst(area)
    plant = assemble(machine, point)
    full = certify(plant, running_law(law, plant, timing), margins=False)
    size = (
        f"{len(extremes.speeds)} speeds x {len(extremes.pressures)} pressures, "
        f"{100 * extremes.change:.2g} % between neighbours"
    )
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    abscissa = max(float(extremes.abscissa.max()), full.spectral_abscissa)
    checks = (
        judge(
            "range.abscissa",
            "Outermost pole between the points",
            abscissa,
            "rad/s",
            Demand(0.0, "<", "stability"),
            f"found on a grid of {size}",
        ),
        judge(
            "range.sensitivity",
            "Largest output sensitivity between the points",
            full.closed_loop_norm,
            "-",
            wanted,
            f"{point.label}, on the full plant; found on a grid of {size}",
        ),
    )
    curves: tuple[Curve, ...] = ()
    if len(extremes.speeds) > 1:
        labels = tuple(f"{pressure / 1e5:.4g} bar" for pressure in extremes.pressures)
        title = f"Largest sensitivity over {area.label}"
        curves = (
            Curve(
                "range.sensitivity",
                title,
                "speed",
                extremes.speeds,
                extremes.peak.T,
                labels,
                "rad/s",
                "-",
                required_line(wanted.limit),
            ),
        )
    return Checks(area.label, abscissa < 0, checks, curves)
