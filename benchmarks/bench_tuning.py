"""Tuning to the requirements: one evaluation with its gradient against points, tolerances and
order; whole designs.

The peer of an evaluation is the same gradient by central differences (16 unknowns timed and
scaled). Errors: the largest difference of the two over the gradient's length; of a design the
largest ratio of a requirement to its limit on the full plants and the largest sigma_max(S_o). All
times are processor time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.law.loop import Timing
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed, reduce, tolerances_around
from ambrose.synthesis.fixed_order.channels import aims_of, loop_model
from ambrose.synthesis.fixed_order.job import bending_modes_for, with_states
from ambrose.synthesis.fixed_order.objective import Objective
from ambrose.synthesis.fixed_order.structure import axis_groups, structured

COMPRESSOR = (
    Path(__file__).parent.parent
    / "tests"
    / "synthesis"
    / "fixed_order"
    / "flexible_compressor.toml"
)
_TIMED, _STEP = 16, 1e-6
_DESIGNS = (
    ("turboexpander", 10e3, "< 30 s, S_o < 2.6"),
    ("seal-rig", 10e3, "< 45 s, S_o < 2.45"),
    (str(COMPRESSOR), 20e3, "< 60 s"),
)


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer_name, error, target."""
    for points, members, order in (
        ((1, 0, 12),) if smoke else ((1, 0, 12), (6, 0, 12), (6, 8, 12), (6, 0, 24))
    ):
        yield _evaluation(points, members, order)
    if smoke:  # one point without tolerances, few states
        machine = amb.load_machine("seal-rig")
        alone = replace(machine.operation, points=machine.operation.points[:1])
        yield _design(
            "seal-rig", replace(machine, tolerances=(), operation=alone), 10e3, "", order=8
        )
        return
    for machine, rate, target in _DESIGNS:
        yield _design(Path(machine).stem, amb.load_machine(machine), rate, target)


def _evaluation(points: int, members: int, order: int) -> dict[str, Any]:
    machine = amb.load_machine("turboexpander")
    plants = [assemble(machine, point) for point in machine.operation.points[:points]]
    small = [reduce(plant, bending_modes_for(plant)) for plant in plants]
    rng = np.random.default_rng(0)
    held = tolerances_around(small[0])
    corners = [
        {item.parameter: float(rng.choice([-1.0, 1.0])) for item in held} for _ in range(members)
    ]
    small += [perturbed(small[0], corner, held) for corner in corners]
    start = pid_controller(machine.controller, machine)
    structure, x = structured(
        with_states(start, order - start.n_states, axis_groups(machine, "free"))
    )
    models = [loop_model(plant, Timing(2e-5, 1)) for plant in small]
    cost = Objective(structure, models, np.geomspace(1, 3e4, 120), aims_of(machine, start))
    ours, (_, gradient) = _best(lambda: cost(x, 20.0))
    moved = rng.choice(len(x), _TIMED, replace=False)
    start_time = time.process_time()
    steps = _STEP * np.eye(len(x))[moved]
    differences = np.array(
        [(cost(x + step, 20.0)[0] - cost(x - step, 20.0)[0]) / (2 * _STEP) for step in steps]
    )
    peer = (time.process_time() - start_time) * len(x) / _TIMED
    off = float(np.abs(differences - gradient[moved]).max() / max(np.linalg.norm(gradient), 1e-300))
    name = (
        f"tuning: one gradient, {points} points, {members} members, {order} states, {len(x)} "
        "unknowns"
    )
    row = {
        "name": name,
        "ours": ours,
        "peer": peer,
        "peer_name": "central differences",
        "error": off,
        "target": "",
    }
    return row | (
        {"series": "gradient of tuning over models", "size": points + members}
        if order == 12
        else {}
    )


def _best(work: Any, repeats: int = 5) -> tuple[float, Any]:
    times, result = [], None
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return min(times), result


def _design(
    name: str, machine: amb.Machine, rate: float, target: str, **options: Any
) -> dict[str, Any]:
    start = time.process_time()
    result = amb.design(machine, "tuned", rate=rate, **options)
    seconds = time.process_time() - start
    reached = (
        f"gamma {result.gamma:.3f}, S_o {result.certificate.closed_loop_norm:.3f}, "
        f"{result.controller.n_states} states"
    )
    name = f"tuning: whole design, {name}, {rate / 1e3:g} kHz"
    return {
        "name": name,
        "ours": seconds,
        "peer": None,
        "peer_name": "",
        "error": reached,
        "target": target,
    }
