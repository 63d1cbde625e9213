"""What a broadband record says about a seal, frequency by frequency: its responses to every
excitation, as phasors.

A column of the response matrix at a frequency is the steady answer to a sine of one ampere, so that
what is found from stepped sines is found from chirps, binary sequences and noise by the same
equations. The noise of the responses becomes draws from their distribution, which stand for the
blocks of a step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.frf.local import local_response
from ambrose.identification.frf.measured import driven_groups
from ambrose.identification.frf.phasors import Phasors
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.record.record import Record

_DRAWS = 60  # their standard deviation is good to 9 %

# the phasors of one experiment, and whether their currents were measured
Driven = tuple[Phasors, bool]


def at_lines(
    records: Sequence[Record],
    signals: Sequence[str],
    frequencies: Sequence[float],
    harmonics: int = 3,
) -> dict[float, list[Driven]]:
    """Frequency [rad/s] -> an experiment for each independent excitation e_ of the records: phasors
    of ``signals`` per ampere.

    frequencies (f,) [rad/s]: those that the records do not tell are left out. Raises InvalidInput
    where none remains, or all excitations are alike: two directions are needed.
    """
    axes = list(dict.fromkeys(name[2:] for name in signals))
    groups = driven_groups(records, axes)
    if any(name[:2] != "e_" for group in groups for name in group):
        raise InvalidInput(
            "a seal is told by currents e_<axis> added to the controller's; leave other "
            "excitations out"
        )
    if len(groups) < 2:
        raise InvalidInput(
            "all excitations of the records at one pressure are alike; drive both directions by "
            "patterns of their own"
        )
    inputs, measured = (
        [group[0] for group in groups],
        any(name.startswith("i_") for name in signals),
    )
    outputs = [name for name in signals if not name.startswith("e_")]
    calm = [without_synchronous(record, harmonics) for record in records]
    frf = local_response(calm, inputs, outputs, harmonics=0, at=frequencies)
    assert frf.noise is not None and frf.share is not None
    seed, result = np.random.default_rng(0), {}
    group_of = {name: j for j, group in enumerate(groups) for name in group}
    for w, omega in enumerate(frf.omega.tolist()):
        left, right = _root(frf.noise[w]), _root(frf.share[w])
        shape = (_DRAWS, len(outputs), len(inputs))
        white = (seed.standard_normal(shape) + 1j * seed.standard_normal(shape)) / np.sqrt(2)
        white -= white.mean(axis=0)
        # The scatter of the mean over draws is to be that of one value: each is as wide as that of
        # a block would be.
        draws = frf.values[w] + np.sqrt(_DRAWS) * left @ white @ right.T
        experiments: list[Driven] = []
        for j in range(len(inputs)):
            mean, blocks = (
                np.zeros(len(signals), complex),
                np.zeros((_DRAWS, len(signals)), complex),
            )
            for i, name in enumerate(signals):
                if name.startswith("e_"):
                    mean[i] = blocks[:, i] = float(group_of.get(name) == j)
                else:
                    mean[i], blocks[:, i] = (
                        frf.values[w, outputs.index(name), j],
                        draws[:, outputs.index(name), j],
                    )
            experiments.append((Phasors(omega, tuple(signals), mean, blocks), measured))
        result[omega] = experiments
    return result


def _root(matrix: np.ndarray) -> np.ndarray:
    """A with A A^H = matrix (n, n), positive semidefinite."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
