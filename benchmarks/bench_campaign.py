"""Campaigns: processor time of one case, for members of one plant as one array and for the other
tasks.

The peer of an array is every case by itself; error: the largest relative difference of the worst
sensitivity. Times of whole campaigns, with one worker and with two, stand in
docs/how-to/campaign.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from ambrose.annexes.campaigns.plan import plan_of
from ambrose.annexes.campaigns.run import PEAK, bases_of, compute, fixed_of

_HEAD = {"machine": "seal-rig", "controller": "pid"}
_TASKS = (
    ("simulate", 4, {"scenario": "levitation"}),
    ("verify", 2, {}),
    ("design", 2, {"method": "tuned"}),
)
_SMOKE = (("simulate", 1, {"scenario": "levitation"}), ("design", 1, {"method": "pid"}))


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer_name, error, target."""
    for members in (2,) if smoke else (24, 96):
        yield _array(members)
    for item in _SMOKE if smoke else _TASKS:
        yield _task(*item)


def _cases(task: str, head: dict[str, Any], vary: dict[str, Any]) -> tuple[Any, Any, Any]:
    options = {"method": head.pop("method")} if "method" in head else {}
    head = {"task": task, **_HEAD, **head}
    if task == "design":
        del head["controller"]
    wanted = plan_of({"campaign": head, "vary": vary, "options": options})
    return list(wanted.drawn()), bases_of(wanted), fixed_of(wanted)


def _array(members: int) -> dict[str, Any]:
    vary = {"tolerance.seal.center.pressure": {"from": -1.0, "to": 0.4, "count": members}}
    cases, bases, fixed = _cases("screen", {}, vary)
    compute("screen", cases[:1], bases, fixed)
    start = time.process_time()
    together = compute("screen", cases, bases, fixed)
    ours = (time.process_time() - start) / members
    start = time.process_time()
    alone = [compute("screen", [case], bases, fixed)[0] for case in cases[::6]]
    peer = (time.process_time() - start) / len(alone)
    off = max(
        abs(a.values[PEAK] / b.values[PEAK] - 1) for a, b in zip(together[::6], alone, strict=True)
    )
    return {
        "name": f"campaign: screen, {members} members",
        "ours": ours,
        "peer": peer,
        "peer_name": "alone",
        "error": off,
        "target": "per case, processor time",
    }


def _task(task: str, count: int, head: dict[str, Any]) -> dict[str, Any]:
    vary = {
        "machine.bearing.*.negative_stiffness": {
            "from": 0.95,
            "to": 1.05,
            "count": count,
            "times": True,
        }
    }
    cases, bases, fixed = _cases(task, dict(head), vary)
    if task == "simulate":
        compute(task, cases[:1], bases, fixed)  # compiles
    start = time.process_time()
    rows = compute(task, cases, bases, fixed)
    ours = (time.process_time() - start) / count
    failed = [row.failure for row in rows if row.failure]
    return {
        "name": f"campaign: {task}",
        "ours": ours,
        "peer": None,
        "peer_name": "",
        "error": float(len(failed)),
        "target": "per case; error: failed cases",
    }
