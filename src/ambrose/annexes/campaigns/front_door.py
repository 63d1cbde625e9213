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
    computer, "dask" for a Dask cluster on it, or the address of a running scheduler. workers: None:
    one for each processor. In a script call it below ``if __name__ == "__main__"``: the workers
    import the script. Raises InvalidInput.
    """
    from ambrose.annexes.campaigns.plan import Plan, plan_of, read_plan
    from ambrose.annexes.campaigns.result import read_campaign
    from ambrose.annexes.campaigns.run import executors, processors, run_plan

    if isinstance(plan, Plan):
        wanted = plan
    else:
        wanted = plan_of(plan) if isinstance(plan, dict) else read_plan(plan)
    with executors(engine, workers or processors()) as (make, count):
        run_plan(wanted, Path(directory), make=make, workers=count, progress=progress)
    result = read_campaign(wanted, Path(directory))
    result.write(Path(directory))
    return result
