"""Assembly and reduction against the number of nodes; closed-loop frequency response; import time;
the whole verification.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.chain.check import facts
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles, select
from ambrose.judge import nominal
from ambrose.judge.verdict import verify_controller
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import modal_reduction
from ambrose.synthesis.design import design


def seconds(action: Callable[[], Any], runs: int) -> float:
    """Median wall time of ``action`` after one warm-up."""
    action()
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return median(times)


def refined(machine: Machine, nodes: int) -> Machine:
    """The machine with about ``nodes`` nodes, every section refined alike."""
    factor = (nodes - 1) / sum(s.elements for s in machine.shaft)
    return replace(
        machine,
        shaft=tuple(replace(s, elements=max(1, round(s.elements * factor))) for s in machine.shaft),
    )


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    rig = load_machine("seal-rig")
    for nodes in (40,) if smoke else (40, 100, 200, 400):
        machine = refined(rig, nodes)
        runs = 1 if smoke else 7 if nodes < 200 else 3
        spent = seconds(lambda m=machine: both(m), runs)
        grows = {"series": "assembly + reduction over nodes", "size": nodes}
        target = {"target": "< 0.05"} if nodes == 40 else {}
        yield {**_row(f"assembly + reduction to 8 states, {nodes} nodes", spent), **grows, **target}
    expander, runs = load_machine("turboexpander"), 1 if smoke else 3
    for nodes in (20,) if smoke else (40, 79):
        yield _poles(expander, nodes, runs)
    for nodes in (20,) if smoke else (101, 201, 401, 796):
        yield from _front_door(refined(rig, nodes))
    if not smoke:
        row = _front_door(refined(expander, 796))[-1]
        yield {**row, "name": f"{row['name']}, turboexpander", "series": None}
    yield _closed_loop_response(rig, 20 if smoke else 2000, runs)
    controller = pid_controller(rig.controller, rig)
    plant = assemble(rig)
    spent = seconds(lambda: nominal.check(plant, controller), runs)
    yield _row(f"all nominal checks, full plant, {plant.system.n_states} states", spent)
    runs = 1 if smoke else 7
    yield {**_row("import ambrose", median(import_time() for _ in range(runs))), "target": "< 0.5"}


def import_time() -> float:
    """Seconds of ``import ambrose`` in a process of its own, by that process' clock."""
    clock = "from time import perf_counter as t; b = t(); import ambrose; print(t() - b)"
    done = subprocess.run([sys.executable, "-c", clock], check=True, capture_output=True)
    return float(done.stdout)


def both(machine: Machine) -> None:
    modal_reduction(assemble(machine))


def _poles(machine: Machine, nodes: int, runs: int) -> dict[str, Any]:
    """The full plant's poles, beside those in all modes of the mesh; error: of the poles below 1e4
    rad/s, relative.
    """
    machine = refined(machine, nodes)
    found = {}
    for every_mode in (False, True):
        plant = assemble(machine, every_mode=every_mode)  # the modes are known from here on
        spent = seconds(
            lambda every=every_mode: poles(assemble(machine, every_mode=every).system), runs
        )
        values = np.sort_complex(poles(plant.rotor))
        found[every_mode] = spent, values[np.abs(values) < 1e4]
    (ours, slow), (theirs, exact) = found[False], found[True]
    row = _row(f"assembly and poles, turboexpander, {nodes - 1} elements", ours)
    return row | {
        "peer": theirs,
        "peer_name": "all modes",
        "error": float(np.abs(slow / exact - 1).max()),
    }


def _front_door(machine: Machine) -> list[dict[str, Any]]:
    """CPU time of the first `check`, `synthesize --method pid` and `verify` of a fine mesh."""
    rows: list[dict[str, Any]] = []
    elements = sum(section.elements for section in machine.shaft)

    def timed(what: str, action: Callable[[], Any]) -> Any:
        begin = time.process_time()
        result = action()
        row = _row(f"{what}, {elements} elements", time.process_time() - begin)
        rows.append({**row, "series": f"{what} over elements", "size": elements})
        return result

    timed("check", lambda: facts(machine))
    law = timed("design of a PID", lambda: design(assemble(machine), "pid"))
    timed("verification with tolerances", lambda: verify_controller(machine, law))
    return rows


def _closed_loop_response(machine: Machine, points: int, runs: int) -> dict[str, Any]:
    plant = assemble(machine)
    loop = closed_loop(plant, pid_controller(machine.controller, machine))
    system = select(loop, [f"d_{a}" for a in plant.axes], [f"y_{a}" for a in plant.axes])
    omega = np.geomspace(1, 2e4, points)
    row = _row(
        f"closed loop, {system.n_states} states, 4x4, {points} frequencies",
        seconds(lambda: frequency_response(system, omega), runs),
    )
    row["target"] = "< 0.5, >= 10x"
    try:
        import control
    except ImportError:
        return row
    peer = system.to_control()
    begin = time.perf_counter()
    theirs = control.frequency_response(peer, omega).frdata
    row |= {"peer": time.perf_counter() - begin, "peer_name": "python-control"}
    ours = frequency_response(system, omega).values
    row["error"] = float(np.abs(np.moveaxis(theirs, -1, 0) - ours).max() / np.abs(ours).max())
    return row


def _row(name: str, ours: float) -> dict[str, Any]:
    return {"name": name, "ours": ours, "peer": None, "peer_name": None, "error": None}
