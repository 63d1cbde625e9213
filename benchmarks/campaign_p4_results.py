"""What the campaigns of P4 and P5 give (campaign_p4.py), for their tables and their page; the rig
and its truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose import load_machine
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf import Validity
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.seal.by_pressure import Line, SealFit
from ambrose.machine.machine import Machine
from ambrose.model.effects import seal

HZ, BAR = 2 * np.pi, 1e5
NOMINAL = 2.04 * BAR
# bit time [s]: what was found from y, from y and i, from i
Columns = dict[float, tuple[ParameterEstimate, ...]]


def rig(coupling: bool = True, leak: float = 0.0, noise: float = 0.2e-6) -> Machine:
    """The machine whose truth is sought."""
    machine = load_machine("seal-rig")
    return replace(
        machine,
        seals=(replace(machine.seals[0], K=0.0, scales_with_pressure=("k", "C", "c")),),
        sensors=tuple(replace(item, noise=noise) for item in machine.sensors),
        bearings=tuple(replace(item, cross_coupling=leak) for item in machine.bearings),
        couplings=machine.couplings if coupling else (),
    )


def truth(pressure: float) -> np.ndarray:
    """K, k, C, c of the rig's seal."""
    found = seal.coefficients(rig().seals[0], pressure)
    return np.array([found.K, found.k, found.C, found.c])


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """P4.1, one direction: measured direct and cross response, the models' direct ones, how far
    each is valid within 2 %.

    limits: per model the frequency [Hz] to which it is valid, by tolerance (of magnitude, and of
    phase in rad).
    """

    axis: str
    measured: Frf
    models: dict[str, FrequencyResponse]
    validity: dict[str, Validity]
    limits: dict[str, dict[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Coupled:
    """P4.3: stiffness of the coupling (zeta, eta) with its deviation, in three experiments."""

    separate: ParameterEstimate
    untrue_bearings: ParameterEstimate
    at_once: ParameterEstimate


@dataclass(frozen=True, slots=True, eq=False)
class Stepped:
    """P4.4 and P4.6: coefficients per frequency and pressure, their constants up to 100 Hz, and the
    measured responses (pressure -> Frf of the middle) beside the global model with these constants.
    """

    fit: SealFit
    constants: SealFit
    measured: dict[float, Frf]
    model: dict[float, FrequencyResponse]


@dataclass(frozen=True, slots=True, eq=False)
class Impulses:
    """P5.1, P5.2: coefficients per pressure, their lines, and per pressure time (k,), measured and
    modelled y (4, k), means over the repeats.
    """

    fit: SealFit
    lines: dict[str, Line]
    responses: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]]
