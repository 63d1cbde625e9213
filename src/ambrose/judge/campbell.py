"""Campbell map: natural frequencies and damping against speed, each mode followed by shape;
critical speeds.

| check | what | unit |
|---|---|---|
| stability.speeds | largest real part of the poles over the speed range; below zero | rad/s |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.core.presentation import Presented
from ambrose.judge.along_speed import AlongSpeed
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import judge
from ambrose.judge.rotor_modes import OSCILLATORY, Modes, damping_ratio, direction, modes
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop
from ambrose.machine.criteria import TWO_PI, Demand
from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CampbellMap(Presented):
    """speeds (s,) [rad/s]; frequency (m, s) [rad/s] damped, damping (m, s) ratio, whirl (m, s) in
    [-1, 1], a row per mode.

    Rows ascend by frequency at the first speed. whirl: +1 forward, -1 backward, 0 planar (see
    rotor_modes.modes).
    """

    speeds: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    whirl: np.ndarray

    def facts(self) -> Mapping[str, Any]:
        """The range of speeds, the modes with their direction, and the least damping."""
        span = f"{self.speeds[0]:.4g} to {self.speeds[-1]:.4g} rad/s"
        return {"speeds": span, "least_damping": float(self.damping.min()), "modes": self.names}

    @property
    def names(self) -> tuple[str, ...]:
        """One name per mode, with its direction at the highest speed."""
        return tuple(f"mode {k + 1}, {direction(row[-1])}" for k, row in enumerate(self.whirl))


def campbell(
    plant_at: Callable[[float], Plant],
    speeds: np.ndarray,
    count: int,
    controller: LawLike | None = None,
) -> CampbellMap:
    """The ``count`` lowest modes that can ring, over ascending speeds (s,) [rad/s], at least two.

    plant_at: speed [rad/s] -> Plant; controller: closes the loop at every speed, None for the plant
    alone (with the magnets' negative stiffness, so that its rigid modes need not oscillate). Modes
    are matched from speed to speed by the modal assurance criterion of their shapes at the ports
    and the distance of their poles (assignment with least total cost). Raises InvalidInput when
    there are fewer modes than ``count``.
    """
    speeds = check_shape(speeds, "speeds", "(s)").astype(float)
    if speeds.size < 2 or (np.diff(speeds) <= 0).any():
        raise invalid(
            "speeds", f"{speeds.size} values", "at least two, ascending", "give them in rad/s"
        )
    rows = [_lowest(_ringing(plant_at(float(speeds[0])), controller), count)]
    for speed in speeds[1:]:
        candidates = _ringing(plant_at(float(speed)), controller)
        rows.append(candidates[_follow(rows[-1], candidates)])
    p = np.array([row.poles for row in rows]).T
    return CampbellMap(speeds, p.imag, damping_ratio(p), np.array([row.whirl for row in rows]).T)


def _ringing(plant: Plant, controller: LawLike | None) -> Modes:
    """Every oscillating mode of the plant or of its closed loop."""
    loop = plant.system if controller is None else closed_loop(plant, controller)
    eigenmodes = modes(loop, plant.ports, plant.system)
    return eigenmodes[eigenmodes.poles.imag > 0]


def _lowest(eigenmodes: Modes, count: int) -> Modes:
    chosen = np.flatnonzero(np.abs(eigenmodes.damping) < OSCILLATORY)
    chosen = chosen[np.argsort(eigenmodes.frequency[chosen], kind="stable")][:count]
    if len(chosen) < count:
        raise invalid(
            "the number of modes",
            count,
            f"at most {len(chosen)}",
            "ask for fewer, or keep more bending modes in the plant",
        )
    return eigenmodes[chosen]


def _follow(eigenmodes: Modes, candidates: Modes) -> np.ndarray:
    """Which candidate continues which mode, (m,)."""
    poles, shapes = eigenmodes.poles, eigenmodes.shapes
    if len(candidates.poles) < len(poles):
        raise invalid(
            "the number of oscillating modes",
            len(candidates.poles),
            f"{len(poles)} at every speed",
            "ask for fewer modes or take smaller steps in speed",
        )
    from scipy.optimize import linear_sum_assignment

    size = (
        np.linalg.norm(shapes, axis=0)[:, None] * np.linalg.norm(candidates.shapes, axis=0)[None, :]
    )
    overlap = np.abs(shapes.conj().T @ candidates.shapes)
    assurance = np.divide(overlap, size, out=np.zeros_like(overlap), where=size > 0) ** 2
    distance = np.abs(candidates.poles[None, :] - poles[:, None]) / np.abs(poles)[:, None]
    _, order = linear_sum_assignment(10 * distance + (1 - assurance))
    return order


def campbell_curves(diagram: CampbellMap) -> list[Curve]:
    """The map as two curves: "campbell" (frequencies and the line of the speed itself) and
    "campbell.damping".
    """
    names = diagram.names
    lines = np.vstack([diagram.frequency, diagram.speeds])
    return [
        Curve(
            "campbell",
            "Natural frequencies against speed",
            "speed",
            diagram.speeds,
            lines,
            (*names, "once per revolution"),
            "rad/s",
            "rad/s",
        ),
        Curve(
            "campbell.damping",
            "Damping ratios against speed",
            "speed",
            diagram.speeds,
            diagram.damping,
            names,
            "rad/s",
            "-",
        ),
    ]


def speed_stability_check(along: AlongSpeed) -> Check:
    """Stability of a loop that was followed over a range of speeds, at the worst of them."""
    speeds, values = along.speeds, along.abscissa
    k = int(np.argmax(values))
    span = f"from {speeds[0] / TWO_PI:.4g} to {speeds[-1] / TWO_PI:.4g} Hz"
    lost = [
        f"from {part[0] / TWO_PI:.4g} to {part[-1] / TWO_PI:.4g} Hz"
        for part in np.split(speeds, np.flatnonzero(np.diff(values >= 0)) + 1)
        if values[np.searchsorted(speeds, part[0])] >= 0
    ]
    unstable = "" if not lost else f"; unstable {', '.join(lost)}"
    return judge(
        "stability.speeds",
        f"Stability over the speed range, {len(speeds)} speeds, refined at the worst",
        values[k],
        "rad/s",
        Demand(0.0, "<", "asymptotic stability"),
        f"largest at {speeds[k] / TWO_PI:.4g} Hz, {span}{unstable}",
    )
