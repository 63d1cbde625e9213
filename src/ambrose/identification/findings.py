"""What is wrong, or doubtful, with a record or with what was identified from it: findings, each
with a code to act upon.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.machine.units import BULLET
from ambrose.record.record import Record

ERROR, WARNING = "error", "warning"


class Code(StrEnum):
    """What a finding is about; programs compare codes, never texts."""

    # A signal by itself (data_quality/signals.py)
    NO_EXCITATION = "no-excitation"  # no excitation in the record, or one that never changes
    DEAD_CHANNEL = "dead-channel"  # a measured signal that never changes
    CLIPPED = "clipped"  # flat tops
    SATURATED = "saturated"  # a command at its limit
    TOUCHDOWN = "touchdown"  # a displacement at the touchdown gap
    REPEATED_SAMPLES = "repeated-samples"  # all channels hold a value at once
    MOVING_POINT = "moving-operating-point"  # speed or pressure changes within the record
    STUCK = "stuck-sensor"  # a displacement that stands still while others move
    OPERATING_POINT = "operating-point"  # one that the machine cannot have
    # Records against controller and model (data_quality/diagnosis.py)
    OTHER_MACHINE = "other-machine"
    DUPLICATE_RECORD = "duplicate-record"
    SAMPLE_RATE = "sample-rate"  # not the stated one
    MIXED_CHANNELS = "mixed-channels"  # swapped or inverted
    EXCITATION = "excitation"  # not of the size or the time that the loop answered
    NO_RESPONSE = "no-response"  # the displacements do not follow the excitation
    # the model with the start values responds otherwise; settled by the fit
    FAR_FROM_START = "far-from-start"
    OTHER_CONTROLLER = "other-controller"
    CONTROLLER_GAIN = "controller-gain"
    OTHER_DELAY = "other-delay"  # another computing delay explains the record better
    CHANNEL_SKEW = "channel-skew"  # channels recorded at different times
    LOST_SAMPLES = "lost-samples"
    # The fit (output_error/statistics.py, identification/youla.py)
    NOT_CONVERGED = "not-converged"
    HARDLY_VISIBLE = "hardly-visible"  # a parameter with a wide interval
    CORRELATED = "correlated"  # two parameters that are hardly told apart
    BLIND = "blind-tests"  # they pass, and would have seen little
    RESIDUALS = "residuals"  # they still follow an excitation: the verdict
    # The result (validation/plausibility.py)
    IMPOSSIBLE_VALUE = "impossible-value"
    NOT_DESTABILISING = "not-destabilising"  # a negative stiffness of the wrong sign
    FAR_FROM_FILE = "far-from-file"  # a value far from the machine file's
    COMMON_FACTOR = "common-factor"  # every K_i and K_s moved alike: a wrong mass
    MISSING_RESPONSE = "missing-response"  # what the model cannot reproduce at any parameter values
    # most of what the model leaves of a signal is one frequency, which is not excited
    TONE = "tone"
    BURST = "burst"  # a short time in which a signal leaves the model
    OTHER_LOAD = "other-load"  # a mean current that carries another thrust (places.py)
    # A seal over pressure (seal/by_pressure.py)
    SEAL_SCATTER = "seal-scatter"  # a point off the line through the others
    # Static loads (identification/static_load.py)
    ONE_SIDED = "one-sided-load"
    NOT_HELD = "position-not-held"
    CURVED = "curved"  # force over current
    # Stepped sines at a seal (seal/by_frequency.py)
    AT_SPEED = "step-at-speed"  # unbalance answers too
    NOISY = "noisy-step"
    # One axis under any controller (one_axis/identify.py)
    COHERENCE = "low-coherence"  # the displacement does not follow the reference
    NOT_THIS_MODEL = "not-this-model"  # the residual is neither white nor free of the excitation
    SCATTER = "halves-disagree"  # both halves of a record differ by more than noise
    PREDICTION = "poor-prediction"  # of the part that was not fitted
    FORCE_LAW = "force-law"  # a stated one does not fit
    # Frequency responses (annexes/site/frf.py)
    UNCERTAIN_LINES = "uncertain-lines"  # the excitation is too weak there


@dataclass(frozen=True, slots=True)
class Finding:
    """severity: "error" (no number from this record can be trusted) or "warning"; ``what`` names
    record and signal, ``evidence`` the numbers that show it, ``remedy`` what to do. Raises
    InvalidInput for another severity.
    """

    code: Code
    severity: str
    what: str
    evidence: str = ""
    remedy: str = ""

    def __post_init__(self) -> None:
        if self.severity not in {ERROR, WARNING}:
            raise invalid(
                "the severity of a finding",
                repr(self.severity),
                '"error" or "warning"',
                "choose one",
            )

    def __str__(self) -> str:
        text = f"{self.what}: {self.evidence}" if self.evidence else self.what
        return f"{text}; {self.remedy}" if self.remedy else text


def refuse(findings: Iterable[Finding]) -> None:
    """Raises InvalidInput with every error among the findings, the first one leading."""
    errors = [str(finding) for finding in findings if finding.severity == ERROR]
    if errors:
        raise InvalidInput(BULLET.join(errors))


# Whether the excitation of a record is enough: its order, and the rows of its signals.


def excitation_order(signals: ArrayLike, order: int = 100, threshold: float = 1e-8) -> int:
    """The order to which signals (m, k) excite persistently, at most ``order``: as many parameters
    per channel can be told.

    The largest n for which n successive samples of all channels have a covariance of full rank:
    smallest over largest eigenvalue above ``threshold``; Ljung (1999), definition 13.2. The best of
    every, every second, every fourth ... sample counts: slow signals hardly differ between samples,
    and leaving samples out adds no frequency. 0: not excited at all.
    """
    u = check_shape(signals, "signals", "(m, k)")
    order = _count(order, "order")
    step = 1
    best = 0
    if not u.any(axis=1).all():
        return 0
    while step == 1 or (best < order and u.shape[1] // step > 4 * order * len(u)):
        best = max(best, _rank_order(u[:, ::step], order, threshold))
        step *= 2
    return best


def signal_rows(record: Record, names: Sequence[str]) -> list[np.ndarray]:
    """The signals (k,) as views; zeros that take no memory for excitations e_, f_ and r_ that the
    record does not hold.
    """
    zeros = np.broadcast_to(0.0, (record.values.shape[1],))
    return [
        zeros if name[:2] in {"e_", "f_", "r_"} and name not in record.signals else record[name]
        for name in names
    ]


def _rank_order(u: np.ndarray, order: int, threshold: float) -> int:
    m, k = u.shape
    n = min(order, (k + 1) // (m + 1))
    if n < 1:
        return 0
    rows = (
        np.lib.stride_tricks.sliding_window_view(u, k - n + 1, axis=1)
        .transpose(1, 0, 2)
        .reshape(n * m, k - n + 1)
    )
    R = rows @ rows.T

    def full(count: int) -> bool:
        values = np.linalg.eigvalsh(R[: count * m, : count * m])
        return bool(values[0] > threshold * values[-1])

    low, high = 0, n
    while low < high:  # the leading blocks: once deficient, deficient for every larger count
        middle = (low + high + 1) // 2
        low, high = (middle, high) if full(middle) else (low, middle - 1)
    return low


def _count(value: int, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise invalid(name, repr(value), "a whole number, at least 1", "give a number of samples")
    return int(value)
