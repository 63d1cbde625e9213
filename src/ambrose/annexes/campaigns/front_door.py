"""What ``import ambrose as amb`` offers of this annex."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambrose.annexes.campaigns.result import Campaign

Progress = Callable[[str], None]


def _quiet(stage: str) -> None:
    """Progress that nobody watches."""


def campaign(
    plan: Any,
    directory: str | os.PathLike[str] = "campaign",
    *,
    engine: str = "processes",
    workers: int | None = None,
    progress: Progress = _quiet,
) -> Campaign:
    """A plan of many cases computed, and what it gave; what ``directory`` holds of it already is
    not computed again.

    plan: the path of a plan file, its content as a dict, or a Plan. engine: "processes" on this
    computer, "dask" for a Dask cluster on it, or the address of a running scheduler, which must be
    one that you trust. workers: 1 or more; None: one for each processor. A case whose worker
    process dies is none of the results: ``missing`` counts it, and the next call computes it.
    Raises InvalidInput, and NumericalFailure where the workers die before they return anything.
    """
    from ambrose.annexes.campaigns.plan import Plan, plan_of, read_plan
    from ambrose.annexes.campaigns.result import read_campaign
    from ambrose.annexes.campaigns.run import run_plan
    from ambrose.annexes.campaigns.workers import executors
    from ambrose.core.processes import processors

    if isinstance(plan, Plan):
        wanted = plan
    else:
        wanted = plan_of(plan) if isinstance(plan, dict) else read_plan(plan)
    with executors(engine, processors() if workers is None else workers) as (make, count):
        run_plan(wanted, Path(directory), make=make, workers=count, progress=progress)
    result = read_campaign(wanted, Path(directory))
    result.write(Path(directory))
    return result
