"""How many bending modes a design model must hold: those that a controller of the machine's weights
moves.

A mode that the model leaves out does no harm where the loop's gain at its resonance stays small;
how large that is depends on the controller, which the weights and the plant decide. So the nominal
H-infinity controller is designed with no bending mode in its model, then with one more at a time,
and each is judged on the full plant as the loop runs: enough is held where it is stable there and
its sensitivity is what the design model promises (spillover: Balas 1978).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.judge.as_it_runs import without_fast_poles
from ambrose.judge.certificate import certify
from ambrose.law.design_problem import apply_delay, design_plant, open_model
from ambrose.law.timing import Timing
from ambrose.law.weights import Weights
from ambrose.model.basis import bending_modes_of
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant
from ambrose.model.reduce import reduce
from ambrose.synthesis.fixed_order.job import bending_modes_for
from ambrose.synthesis.hinf.synthesis import hinf_synthesis

# of the design model's peak of S_o: by how much more the full plant's may be. Less is what a later
# design of mu or of matched gains moves it by.
_PROMISED = 1.5


def modes_that_matter(
    plant: Plant, weights: Weights, timing: Timing | None, progress: Callable[[str], None]
) -> int:
    """The least number of bending modes per plane with which the nominal H-infinity controller
    holds the full ``plant`` as well as its design model.

    Tried are all below half the sample rate, or where no rate is known, below the frequency up to
    which sensitivity is judged; where none of them does, the number that comes nearest.
    """
    available = bending_modes_of(plant.rotor_model)
    if timing is None:
        most = bending_modes_for(plant)
    else:
        frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
        most = int((frequencies < np.pi / timing.sample_time).sum())
    tried: dict[int, tuple[float, float]] = {}
    for modes in range(min(most, available) + 1):
        try:
            tried[modes] = _spilled(plant, weights, timing, modes)
        except NumericalFailure:  # such as two modes that cannot be parted: with one more they are
            continue
        abscissa, excess = tried[modes]
        if abscissa < 0 and excess <= _PROMISED:
            break
        words = f"unstable, {abscissa:+.3g} rad/s" if abscissa >= 0 else f"S_o {excess:.3g} times"
        progress(f"{modes} bending modes are too few: {words} on the full plant")
    best = min(tried, key=lambda n: (tried[n][0] >= 0, tried[n][1], tried[n][0]), default=0)
    if best:
        progress(f"design model with {best} bending modes per plane")
    return best


def _spilled(
    plant: Plant, weights: Weights, timing: Timing | None, modes: int
) -> tuple[float, float]:
    """Spectral abscissa [rad/s] of the nominal controller on the full plant, and its peak of S_o
    over that of the design model; both of the loop as it runs.
    """
    small = reduce(plant, modes)
    lag = 0.0 if timing is None else timing.lag
    model = apply_delay(open_model(small, None, False), lag)
    made = hinf_synthesis(design_plant(model, weights, uncertain=False))
    if timing is not None:
        made = without_fast_poles(made, timing, design_plant(small, weights, uncertain=False))
    law = made.controller if timing is None else timing.in_loop(made.controller)
    full = certify(plant, law, margins=False)
    if not full.stable:
        return full.spectral_abscissa, np.inf
    promised = certify(small, law, margins=False)
    return full.spectral_abscissa, full.closed_loop_norm / promised.closed_loop_norm
