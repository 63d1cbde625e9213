"""Repeated experiments: mean, relative standard deviation, confidence intervals.

A single identification states its own standard deviation (output_error/statistics.py, from the
colour of the residuals). Repeats show the scatter itself, whatever causes it: noise, run-out,
temperature, a model wrong in another way each time. Means have Student's t intervals (papers P2:
five repeats, 95 %), scatters have chi-square ones: the standard deviation of five repeats is itself
uncertain by a factor between 0.6 and 2.9.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.identification.output_error.loop_model import ParametricModel, TimedLoop, over_weights
from ambrose.identification.output_error.normal_equations import fit, synchronised
from ambrose.identification.output_error.problem import Experiment
from ambrose.identification.parameters import Estimate
from ambrose.record.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """r repeats of q parameters, SI, in the order of ``paths``.

    values (r, q); predicted (q,): root mean square of the standard deviations that the single
    experiments state (NaN where they state none). level [-] of all intervals. mean (q,); deviation
    (q,): sample standard deviation of one repeat.
    """

    paths: tuple[str, ...]
    values: np.ndarray
    predicted: np.ndarray
    level: float

    @property
    def count(self) -> int:
        return len(self.values)

    @property
    def mean(self) -> np.ndarray:
        return np.asarray(self.values.mean(axis=0))

    @property
    def deviation(self) -> np.ndarray:
        return np.asarray(self.values.std(axis=0, ddof=1))

    @property
    def rsd(self) -> np.ndarray:
        """Relative standard deviation (q,) [%]; NaN where the mean is zero."""
        mean = np.abs(self.mean)
        return np.divide(100 * self.deviation, mean, out=np.full(len(mean), np.nan), where=mean > 0)

    @property
    def half_width(self) -> np.ndarray:
        """The mean lies within +- this (q,) with probability ``level``: t s/sqrt(r), Student's t
        with r - 1 degrees.
        """
        from scipy.special import stdtrit

        return np.asarray(
            stdtrit(self.count - 1, (1 + self.level) / 2) * self.deviation / np.sqrt(self.count)
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI."""
        return {
            "count": self.count,
            "values": self.values.tolist(),
            "mean": self.mean.tolist(),
            "half_width_95": self.half_width.tolist(),
            "rsd_percent": self.rsd.tolist(),
        }


def repeats(
    paths: Sequence[str], values: ArrayLike, predicted: ArrayLike | None = None, level: float = 0.95
) -> Repeats:
    """Repeats from values (r, q) and the standard deviations (r, q) that each experiment states.
    Raises InvalidInput.
    """
    values = check_shape(values, "values", "(r, q)", q=len(paths))
    if len(values) < 2:
        raise invalid(
            "the number of repeats",
            len(values),
            "at least 2",
            "one experiment shows no scatter; repeat it",
        )
    if not 0 < level < 1:
        raise invalid("level", level, "between 0 and 1", "0.95 is usual")
    deviations = (
        np.full(values.shape, np.nan)
        if predicted is None
        else check_shape(predicted, "predicted", "(r, q)", q=len(paths))
    )
    return Repeats(tuple(paths), values, np.sqrt(np.mean(deviations**2, axis=0)), float(level))


def of_estimates(estimates: Sequence[Estimate], level: float = 0.95) -> Repeats:
    """Repeats from identifications (or static loads) of the same parameters. Raises InvalidInput
    where those differ.
    """
    if not estimates:
        raise InvalidInput("no experiment was given; repeats need at least two")
    first = estimates[0].paths
    for number, item in enumerate(estimates, 1):
        if item.paths != first:
            raise invalid(
                f"the parameters of experiment {number}",
                ", ".join(item.paths),
                f"{', '.join(first)}, as in the first",
                "identify the same parameters each time",
            )
    values, predicted = (
        [getattr(item, name) for item in estimates] for name in ("values", "standard_deviations")
    )
    return repeats(first, values, predicted, level)


# The identified model driven by every record's excitation: its signals beside the measured ones.


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedOutput:
    """measured (p, k), as in the record, and model (p, k) of ``signals``, SI; the model with the
    estimated initial state and offset, and what turns with the rotor.
    """

    record: Record
    signals: tuple[str, ...]
    model: np.ndarray

    @property
    def measured(self) -> np.ndarray:
        return np.array([self.record[name] for name in self.signals])

    @property
    def residual(self) -> np.ndarray:
        return self.measured - self.model

    def rows(self, names: Sequence[str] | None = None) -> Iterator[tuple[str, np.ndarray]]:
        """Name and residual (k,) of one signal after the other, all or those named."""
        for name, model in zip(self.signals, self.model, strict=True):
            if names is None or name in names:
                yield name, self.record[name] - model


def simulate_outputs(
    experiment: Experiment, records: Sequence[Record], theta: np.ndarray
) -> tuple[SimulatedOutput, ...]:
    """Every record of an experiment with the model's outputs at theta (q,); the signals are those
    of the experiment.
    """
    signals = experiment.signals
    unit = experiment.sizes
    outputs = []
    for record, task in zip(records, experiment.tasks, strict=True):
        model, free = experiment.models[task.place], replace(task, initial_state=True, offset=True)
        loop = over_weights(model, theta, experiment.sizes)[0]
        part, response = (
            _fitted_part(record, model, task.samples),
            fit(loop, synchronised(loop, free))[0],
        )
        for name, row, size in zip(
            signals, response, unit, strict=True
        ):  # of the residual, the model
            row[:] = part[name] - row * size
        outputs.append(SimulatedOutput(part, signals, response))
    return tuple(outputs)


def _fitted_part(record: Record, model: ParametricModel, samples: int) -> Record:
    """The part of a record that was fitted: with an unknown delay of the excitation some samples at
    both ends are not.
    """
    skipped = model.skipped if isinstance(model, TimedLoop) else 0
    if samples == record.values.shape[1]:
        return record
    values = record.values[:, skipped : skipped + samples].copy()
    return replace(record, values=values, start_time=record.start_time + skipped * record.dt)
