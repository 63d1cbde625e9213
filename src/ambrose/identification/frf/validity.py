"""How far a model may be trusted: line by line against a measured frequency response, and up to
which frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import as_statespace, select
from ambrose.identification.frf.spectral import Frf

AGREES = 1
UNDECIDED = 0
DISAGREES = -1


@dataclass(frozen=True, slots=True, eq=False)
class Validity:
    """A model against a measured response, at omega (w,) [rad/s].

    ratio (w, p, m): model over measured; margin (w, p, m): the measurement's own relative radius at
    the confidence asked for. verdict (w, p, m): 1 within the tolerances widened by the margin, -1
    outside, 0 where the margin is wider than the tolerance and the model inside: the record cannot
    tell. valid_to (p, m) [rad/s]: the last line that agrees below the first that disagrees; 0 where
    the first decided line disagrees or nothing is decided. decided (p, m): share of lines below it.
    """

    omega: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    ratio: np.ndarray
    margin: np.ndarray
    verdict: np.ndarray
    valid_to: np.ndarray
    decided: np.ndarray

    @property
    def worst(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest deviation of magnitude [-] and phase [rad] (p, m) over the decided lines of the
        valid band.
        """
        inside = (self.omega[:, None, None] <= self.valid_to) & (self.verdict != UNDECIDED)
        size = np.where(inside, np.abs(np.abs(self.ratio) - 1), 0.0).max(axis=0)
        return size, np.where(inside, np.abs(np.angle(self.ratio)), 0.0).max(axis=0)


def compare(
    measured: Frf,
    model: Any,
    *,
    magnitude_tolerance: float = 0.1,
    phase_tolerance: float = 0.1745,
    confidence: float = 0.95,
) -> Validity:
    """Where ``model`` agrees with ``measured`` in magnitude (relative) and phase [rad] (default 10
    %, 10 degrees).

    model: a FrequencyResponse on the same lines, or a system with the same signals; a continuous
    one is sampled at the record's rate with a zero-order hold first, because that is what the
    controller's commands see: half a sample of delay is 1.8 degrees at 100 Hz and 10 kHz. Raises
    InvalidInput.
    """
    check_positive(magnitude_tolerance, "magnitude_tolerance", "0.1 is 10 %")
    check_positive(phase_tolerance, "phase_tolerance", "give it in rad")
    expected = model_response(measured, model).values
    size = np.abs(measured.values)
    if not size.all():
        raise InvalidInput(
            "the measured response is exactly zero at some line: a dead channel; leave it out"
        )
    ratio, margin = expected / measured.values, measured.radius(confidence) / size

    # a circle of relative radius r about 1 reaches 1 + r and the angle arcsin r
    wide = (np.abs(np.abs(ratio) - 1) <= magnitude_tolerance + margin) & (
        np.abs(np.angle(ratio)) <= phase_tolerance + np.arcsin(np.minimum(margin, 1.0))
    )
    told = margin <= min(magnitude_tolerance, phase_tolerance)
    verdict = np.where(~wide, DISAGREES, np.where(told, AGREES, UNDECIDED))

    # only what lies below the first line that disagrees
    before = np.cumsum(verdict == DISAGREES, axis=0) == 0
    good = before & (verdict == AGREES)
    last = np.where(good, measured.omega[:, None, None], 0.0).max(axis=0)
    below = before & (measured.omega[:, None, None] <= last)
    decided = good.sum(axis=0) / np.maximum(below.sum(axis=0), 1)
    return Validity(
        measured.omega, measured.inputs, measured.outputs, ratio, margin, verdict, last, decided
    )


def model_response(measured: Frf, model: Any) -> FrequencyResponse:
    """The model on the lines and between the signals of ``measured``; v_<axis> of the measurement
    is u_<axis> of a plant.

    Raises InvalidInput where it lacks a signal or, a FrequencyResponse, was computed on other
    lines.
    """
    if isinstance(model, FrequencyResponse):
        if model.omega.shape != measured.omega.shape or not np.allclose(
            model.omega, measured.omega, rtol=1e-9
        ):
            raise InvalidInput(
                "the model's frequencies are not those of the measured response; evaluate it at "
                "measured.omega"
            )
        return model.select(_named(measured.inputs, model.inputs), measured.outputs)
    system = as_statespace(model)
    system = select(system, _named(measured.inputs, system.inputs), measured.outputs)
    return frequency_response(
        c2d(system, measured.dt) if system.dt is None else system, measured.omega
    )


def _named(wanted: tuple[str, ...], known: tuple[str, ...]) -> list[str]:
    return [
        f"u_{name[2:]}" if name not in known and name.startswith("v_") else name for name in wanted
    ]
