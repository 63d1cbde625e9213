"""What a drop is computed from and in, as the compiled kernel takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Rig(NamedTuple):
    """The rotor with its touchdown bearings as arrays, in n coordinates with b bearings.

    stiffness, damping, gyroscopic (n, n): M^-1 K and so on; rows (b, 2, n); answers (n, 2b): M^-1
    rows^T; weight (n,): M^-1 w; seals (s, 2, n) over their gaps; bearings (b, 21): of
    ``touchdown.Bearing``; inverse
    (b, 4): 1/mass of race, 1/inertia, 1/mass of ring, and mobility of the sliding [1/kg]; windage
    [N m s2]; flight: steps of free flight in one; loss (n, n): D; tally: whether its work is
    counted. axes (b, 2), magnets (b, 10), sensors (2b, n), bandwidth [rad/s]: of the magnets.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    rows: np.ndarray
    answers: np.ndarray
    weight: np.ndarray
    seals: np.ndarray
    bearings: np.ndarray
    inverse: np.ndarray
    polar_inertia: float
    windage: float
    flight: int
    loss: np.ndarray
    tally: bool
    axes: np.ndarray
    magnets: np.ndarray
    sensors: np.ndarray
    bandwidth: float


class SampledLaw(NamedTuple):
    """A controller between samples: A (s, s), B (s, a), C (a, s), D (a, a); slow: its first states
    that rest in contact; period: steps per sample; limit [A] of currents, reading [m] of sensors.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    slow: int
    period: int
    limit: float
    reading: float


class Case(NamedTuple):
    """What differs from drop to drop: unbalance cosine, sine (n,) [m] times M^-1; factors on
    friction, mount stiffness and damping; brake [N m].
    """

    cosine: np.ndarray
    sine: np.ndarray
    friction: float
    mount_stiffness: float
    mount_damping: float
    brake: float


class Work(NamedTuple):
    """Room for one drop at a time."""

    slopes: np.ndarray
    turning: np.ndarray
    seen: np.ndarray
    place: np.ndarray
    turns: np.ndarray
    states: np.ndarray
    fresh: np.ndarray
    command: np.ndarray
