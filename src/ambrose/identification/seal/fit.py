"""Seal coefficients from closed-loop records, by pressure and frequency: READ FIRST; the work is done next door.

    fit = seal_fit.stepped_sine(machine, records)                  # frequency by frequency, a reference without pressure (P4)
    fit = seal_fit.from_records(machine, records, controller)      # impulses, PRBS, chirps: all frequencies at once (P5)
    seal_fit.line(fit, "k")                                        # over pressure, with confidence and prediction bands
    machine = seal_fit.identified_seal(machine, fit)               # back into the machine, with tolerances

``machine`` must be known but for the seal: identify bearings and coupling without pressure first (output_error/closed_loop.py).
"""

from __future__ import annotations

from ambrose.identification.frf.phasors import Step, find_steps, steps_of
from ambrose.identification.seal.model_updating import identified_seal
from ambrose.identification.seal.regression import Line, fit_line
from ambrose.identification.seal.result import COEFFICIENTS, ENTRIES, SealFit, averaged, line
from ambrose.identification.seal.stepped_sine import identify as stepped_sine
from ambrose.identification.seal.time_domain import identify as from_records

__all__ = [
    "COEFFICIENTS",
    "ENTRIES",
    "Line",
    "SealFit",
    "Step",
    "averaged",
    "find_steps",
    "fit_line",
    "from_records",
    "identified_seal",
    "line",
    "stepped_sine",
    "steps_of",
]
