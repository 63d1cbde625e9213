"""Assembly and reduction against the number of nodes; closed-loop frequency response; import time; the whole verification."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import select
from ambrose.evaluation.verdict import verify_controller
from ambrose.machine.machine import Machine
from ambrose.plant import assemble as assembly
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop
from ambrose.plant.reduce import modal_reduction
from ambrose.stages.plants import facts
from ambrose.synthesis.design import design
from ambrose.synthesis.pid import pid_controller
from ambrose.verification import nominal


def seconds(action: Callable[[], Any], runs: int = 7) -> float:
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
    return replace(machine, shaft=tuple(replace(s, elements=max(1, round(s.elements * factor))) for s in machine.shaft))


def run() -> list[dict[str, Any]]:
    rig = load_machine("seal-rig")
    rows = []
    for nodes in (40, 100, 200, 400):
        machine = refined(rig, nodes)
        runs = 7 if nodes < 200 else 3
        spent = seconds(lambda m=machine: both(m), runs)
        grows = {"series": "assembly + reduction over nodes", "size": nodes}
        rows.append({**_row(f"assembly + reduction to 8 states, {nodes} nodes", spent), **grows})
    rows[0]["target"] = "< 0.05"
    rows += [_facts(load_machine("turboexpander"), nodes) for nodes in (79, 157)]
    rows += [row for nodes in (101, 201, 401, 801) for row in _front_door(refined(rig, nodes), nodes - 1)]
    rows.append(_closed_loop_response(rig))
    controller = pid_controller(rig.controller, rig)
    plant = assemble(rig)
    rows.append(_row("all nominal checks, full plant, 328 states", seconds(lambda: nominal.check(plant, controller), 3)))
    command = [sys.executable, "-c", "import ambrose"]
    bare = seconds(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True))
    rows.append({**_row("import ambrose", seconds(lambda: subprocess.run(command, check=True)) - bare), "target": "< 0.5"})
    return rows


def both(machine: Machine) -> None:
    modal_reduction(assemble(machine))


def _facts(machine: Machine, nodes: int) -> dict[str, Any]:
    """What `ambrose check` computes, beside the same with all modes of the mesh; error: of the unstable poles."""
    machine = refined(machine, nodes)

    def timed() -> tuple[float, np.ndarray]:
        begin = time.perf_counter()
        found = np.array(facts(machine)["unstable_poles_rad_s"])
        return time.perf_counter() - begin, found

    timed()  # the seals' coefficients are computed once
    ours, found = timed()
    kept, assembly.FINE_MESH_MODES = assembly.FINE_MESH_MODES, 10**6
    try:
        theirs, exact = timed()
    finally:
        assembly.FINE_MESH_MODES = kept
    row = _row(f"check, {nodes - 1} elements", ours)
    return row | {"peer": theirs, "peer_name": "all modes", "error": float(np.abs(found - exact).max() / np.abs(exact).max())}


def _front_door(machine: Machine, elements: int) -> list[dict[str, Any]]:
    """CPU time of the first `check`, `synthesize --method pid` and `verify` of a fine mesh."""
    rows: list[dict[str, Any]] = []

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


def _closed_loop_response(machine: Machine) -> dict[str, Any]:
    plant = assemble(machine)
    loop = closed_loop(plant, pid_controller(machine.controller, machine))
    system = select(loop, [f"d_{a}" for a in plant.axes], [f"y_{a}" for a in plant.axes])
    omega = np.geomspace(1, 2e4, 2000)
    row = _row(
        f"closed loop, {system.n_states} states, 4x4, 2000 frequencies",
        seconds(lambda: frequency_response(system, omega), 3),
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
