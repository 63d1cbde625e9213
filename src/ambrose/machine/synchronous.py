"""A synchronous block of the controller: what it does to the unbalance's signal, in which band of
speed.

The amplitudes a of the block turn with the rotor: a' = (2/time_constant) T exp(-j theta) z, c =
Re(exp(j theta) a) is added to what the controller measures; z is what the mode drives to zero
(law/synchronous.py). T over speed is a table of matrices, "phase only" one angle per speed, or,
where neither is given, one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ambrose.machine.kinds import Choice, Count, Length, ListOf, NestedOf, PairOf, Rate, Time
from ambrose.machine.part import Part

SYNCHRONOUS_UPDATES = ("sample", "turn")
SYNCHRONOUS_MODES = ("current-free", "force-free", "vibration-free", "damping")
SYNCHRONOUS_COORDINATES = ("axes", "tilt-translate")


@dataclass(frozen=True, slots=True, repr=False)
class Synchronous(Part):
    """A block at a harmonic of the speed: mode, band of speed, and T over speed.

    T acts on complex amplitudes, in the order of the machine's axes: matrices ``real`` + j
    ``imaginary`` at ``speeds``, linear between; or exp(j ``phase``) at ``speeds``; or, with
    neither, 1. In coordinates "tilt-translate" its rows and columns are translate_x, translate_y,
    tilt_x, tilt_y.
    """

    mode: Annotated[str, Choice(SYNCHRONOUS_MODES), "what is driven to zero"]
    band: Annotated[
        tuple[float, float],
        PairOf("angular rate", "lowest, highest", scalar=False),
        "speeds in which it is on",
    ]
    time_constant: Annotated[Time, "in which the amplitude settles, 2/eps"]
    speeds: Annotated[
        tuple[float, ...] | None, ListOf("angular rate"), "ascending speeds of the table of T"
    ] = None
    real: Annotated[Any, NestedOf("plain number"), "real part of T: speeds, rows, columns"] = None
    imaginary: Annotated[
        Any, NestedOf("plain number"), "imaginary part of T: speeds, rows, columns; default: none"
    ] = None
    phase: Annotated[
        tuple[float, ...] | None,
        ListOf("angle"),
        "the angle of T = exp(j phase) at every speed, in place of matrices",
    ] = None
    coordinates: Annotated[str, Choice(SYNCHRONOUS_COORDINATES), "of the rows and columns of T"] = (
        "axes"
    )
    harmonic: Annotated[int, Count(), "multiple of the speed"] = 1
    hysteresis: Annotated[
        Rate, "by which the speed has to be within the band before it is switched on"
    ] = 5.0
    limit: Annotated[
        Length | None, "largest amplitude of a channel; default: a quarter of the smallest gap"
    ] = None
    hold: Annotated[
        Time, "for which amplitudes are held after a fault before they are released"
    ] = 0.5
    release: Annotated[Time, "time constant in which released amplitudes decay"] = 0.2
    leak: Annotated[
        Rate, 'rate at which amplitudes fade all the time; needed by mode "damping"'
    ] = 0.0
    update: Annotated[
        str,
        Choice(SYNCHRONOUS_UPDATES),
        "when amplitudes move: every sample, or once a turn by its mean (convergent control)",
    ] = "sample"

    @property
    def gain(self) -> float:
        """eps = 2/time_constant [1/s]."""
        return 2 / self.time_constant

    def knots(self) -> tuple[float, ...]:
        """The speeds at which the table bends [rad/s]."""
        return self.speeds or ()

    def table(self, axes: int) -> tuple[np.ndarray, np.ndarray]:
        """Speeds (s,) [rad/s] and T (s, n, n) complex in the file's own coordinates; one speed
        where T is constant.
        """
        if self.speeds is None:
            turn = np.exp(1j * (self.phase[0] if self.phase else 0.0))
            return np.array([self.band[0]]), turn * np.eye(axes, dtype=complex)[None]
        speeds = np.array(self.speeds)
        if self.phase is not None:
            return speeds, np.exp(1j * np.array(self.phase))[:, None, None] * np.eye(axes)
        T = np.array(self.real, dtype=complex)
        if self.imaginary is not None:
            T = T + 1j * np.array(self.imaginary)
        return speeds, T
