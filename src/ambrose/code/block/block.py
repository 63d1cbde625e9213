"""What the blocks of fixed and scheduled controllers share: signals, timing, limits, and how their
realisation is chosen.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.code.sampled import Deployment
from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    check_finite,
    check_positive,
    invalid,
)
from ambrose.core.frequency import peak_gains
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.law import Scheduling
from ambrose.law.supervision import Limits
from ambrose.law.synchronous_block import SynchronousLaw

# Fills the templates of generated files (templates/*.j2).


def render(template: str, values: Mapping[str, Any], autoescape: bool = False) -> str:
    """The text of a template. autoescape: for XML and HTML; elsewhere names are checked and
    comments made safe.
    """
    return _templates(autoescape).get_template(template).render(values)


@lru_cache(maxsize=2)
def _templates(autoescape: bool) -> Any:
    """All templates, each compiled once."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("ambrose.code"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=autoescape,
        auto_reload=False,
    )


# Names that become identifiers in generated code, and text that becomes a comment.


_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 24  # of C99's 31 significant characters, 7 are left for _track and the like
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int
long register restrict return short signed sizeof static struct switch typedef union unsigned void
volatile while asm bool catch class delete explicit export false friend main mutable namespace new
NULL nullptr operator private protected public template this throw true try typename using virtual
"""  # C99's and, as the header is meant for C++ as well, the commonest of C++'s
KEYWORDS = frozenset(_WORDS.split())
# no file can be called so on Windows
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)


def names_in_code(signals: Sequence[str]) -> tuple[str, ...]:
    """Signals as generated code calls them: names of a machine file may have hyphens, which become
    underscores.
    """
    return tuple(signal.replace("-", "_") for signal in signals)


def check_identifiers(name: str, inputs: Sequence[str], outputs: Sequence[str]) -> None:
    """Refuse names that cannot stand in C: the block's ``name``, and those of its signals. Raises
    InvalidInput.
    """
    check_identifier(name, "the name of the block", "choose letters, digits and underscores")
    for side, signals in (("input", inputs), ("output", outputs)):
        for signal in signals:
            check_identifier(
                signal,
                f"the {side} signal",
                "rename the bearing in the machine file, or give the signals other names",
            )
    upper = [signal.upper() for signal in (*inputs, *outputs)]
    for signal in upper:
        if upper.count(signal) > 1:
            raise invalid(
                "a signal's name",
                signal,
                "unique in capitals",
                "give the controller's signals other names",
            )


def check_identifier(name: str, what: str, remedy: str) -> str:
    """``name`` if it is a C identifier of at most 24 characters and no keyword. Raises
    InvalidInput.
    """
    if (
        not isinstance(name, str)
        or not _IDENTIFIER.fullmatch(name)
        or name in KEYWORDS
        or len(name) > _LONGEST
    ):
        wanted = (
            f"a C identifier of at most {_LONGEST} characters that starts with a letter and is no "
            "keyword"
        )
        raise invalid(what, repr(name), wanted, remedy)
    if _DEVICES.fullmatch(name):
        wanted = "unlike a device of Windows, where no file can be called so"
        raise invalid(what, repr(name), wanted, remedy)
    return name


def as_comment(text: str) -> str:
    """``text`` made safe inside a C comment: printable ASCII on one line, without comment ends,
    trigraphs and backslashes.
    """
    plain = "".join(c if " " <= c <= "~" and c != "\\" else "_" for c in text)
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


# status bits, as in the header
HELD = 1
FAULT = 2
LIMITED = 4
# of a scheduled block besides
CLAMPED = 8
TOLD = 16
BEHIND = 32
TOLD_SECOND = 64
# of a supervised block besides: who is in charge, why, and that it stays so
STATE_AT = 4
REASON_AT = 6
LATCHED = 512


# Operations and memory of one step of the generated code.


# of a signal, of a state
BYTES = {"double": (8, 8), "float": (4, 4), "fixed32": (4, 8), "fixed16": (2, 4)}


@dataclass(frozen=True, slots=True)
class Cost:
    """Multiplications and additions of a step, ``limited`` more of each while a current is cut;
    bytes of state and tables.
    """

    multiplications: int
    additions: int
    limited: int
    state_bytes: int
    table_bytes: int


def diagonals_of(x: np.ndarray) -> list[int]:
    """The offsets (positive above) of the diagonals of x (n, n) that are not zero."""
    return [k for k in range(1 - len(x), len(x)) if np.diagonal(x, k).any()]


HOLD_SAMPLES = 10
# s; an integral time of 0.2 s and a derivative time of 2 ms have it as their geometric mean
WINDUP_TIME = 0.02
HEADROOM = 1.02  # of the bounds on the states
_UNSEEN = 1e-150  # effect of a state that no output sees; its square is a number
_SLOW = 5.0  # times the windup time: modes slower than this wind up


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Block:
    """What runs, states within +-1, errors e (m,) [m], currents u (p,) [A]; every matrix of a
    scheduled block has its k grid points as the first axis.

    increment (n, n): A - I; B (n, m) [1/m], C (p, n) [A], D (p, m) [A/m], unwind (n, p) [1/A];
    error_limit (m,) [m] and current_limit (p,) [A]: what is plausible and what is given out;
    raw_limit (p,) [A]: the largest current asked for; hold_samples: how long a missing input is
    replaced; windup_time [s]: how fast states that wind up follow the limited current; delay
    [samples].
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float
    delay: int
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    unwind: np.ndarray
    error_limit: np.ndarray
    current_limit: np.ndarray
    raw_limit: np.ndarray
    hold_samples: int
    windup_time: float

    number: ClassVar[Any] = float  # of its errors, currents and states

    @property
    def n_states(self) -> int:
        return self.increment.shape[-1]

    @property
    def edge(self) -> np.ndarray:
        """The largest plausible errors (m,)."""
        return self.error_limit

    @property
    def fixed_increment(self) -> np.ndarray:
        """A - I (n, n), of a schedule what is the same at every point."""
        return self.increment

    @property
    def padding(self) -> tuple[int, int]:
        """How many places before and after the states the diagonals of A - I reach."""
        offsets = diagonals_of(self.fixed_increment)
        return max(0, -min(offsets, default=0)), max(0, max(offsets, default=0))

    def cost(self, arithmetic: str) -> Cost:
        """Of a step as the code does it."""
        raise NotImplementedError

    def section_tables(self) -> dict[str, np.ndarray]:
        """What a cascade has besides: mixings, channels and orders."""
        return {}

    @property
    def over(self) -> tuple[tuple[Scheduling, np.ndarray, float, float], ...]:
        """What its law changes with: each with its grid, the largest magnitude that is plausible,
        and the largest rate of the schedule [per s] (inf: none).
        """
        return ()

    @property
    def alone(self) -> tuple[tuple[Scheduling, np.ndarray, float, float], ...]:
        """``over`` where that is one at most. Raises InvalidInput for two."""
        if len(self.over) > 1:
            raise InvalidInput(
                "this takes a block scheduled over one parameter; one over speed and pressure is "
                "written as C"
            )
        return self.over

    @property
    def watch(self) -> Limits | None:
        """What a reading has to keep to, where a fixed law takes over; None: none does."""
        return None

    def middle(self) -> tuple[float, ...]:
        """What a step is told in the middle of its ranges."""
        return tuple(float(axis[0] + axis[-1]) / 2 for _, axis, *_ in self.over)

    def in_charge(self, status: int) -> bool:
        """Whether the law that was proved acts, by the status of a step."""
        return True

    @property
    def told(self) -> tuple[str, ...]:
        """What a step is told besides the errors."""
        return tuple(one.name for one, *_ in self.over)

    @property
    def base(self) -> Self:
        """As every law that a unit runs: the controller's block, here alone."""
        return self

    @property
    def beside(self) -> SynchronousLaw | None:
        return None

    @property
    def axial(self) -> ControlBlock | None:
        return None

    @property
    def state_range(self) -> np.ndarray:
        """The largest magnitude (n,) of every state."""
        return np.ones(self.n_states)

    @property
    def transfers(self) -> bool:
        """Whether the block can go on from given currents: its states reach every output."""
        raise NotImplementedError

    def single(self) -> Self:
        """The block with limits that single precision holds: what code in "float" compares with."""
        errors, currents = (
            np.float32(x).astype(float) for x in (self.error_limit, self.current_limit)
        )
        return replace(self, error_limit=errors, current_limit=currents)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Checked settings of a block: error_limit (m,) [m], current_limit (p,) [A], windup_time [s],
    hold_samples.
    """

    error_limit: np.ndarray
    current_limit: np.ndarray
    windup_time: float
    hold_samples: int


def check_settings(
    K: StateSpace | ScheduledSystem,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    windup_time: float,
    hold_samples: int,
) -> Settings:
    """The settings as arrays of the controller's size, after checking them and the names. Raises
    InvalidInput.
    """
    check_identifiers(name, names_in_code(K.inputs), names_in_code(K.outputs))
    errors = check_limits(
        error_limit, len(K.inputs), "error_limit", "the bearing's gap is the largest"
    )
    currents = check_limits(
        current_limit,
        len(K.outputs),
        "current_limit",
        "give the amplifier's largest control current in A",
    )
    check_positive(windup_time, "windup_time", f"give it in seconds, e.g. {WINDUP_TIME:g}")
    if (
        isinstance(hold_samples, bool)
        or not isinstance(hold_samples, int)
        or not 0 <= hold_samples <= 32767
    ):
        raise invalid(
            "hold_samples",
            hold_samples,
            "a whole number from 0 to 32767",
            f"{HOLD_SAMPLES} is usual",
        )
    return Settings(errors, currents, windup_time, hold_samples)


def check_limits(value: ArrayLike, count: int, name: str, remedy: str) -> np.ndarray:
    """One positive number or one per axis as an array (count,). Raises InvalidInput."""
    values = np.atleast_1d(check_finite(value, name)).astype(float).ravel()
    if values.size not in {1, count}:
        raise invalid(
            f"the number of {name} values",
            values.size,
            f"1 or {count}",
            "give one, or one per axis",
        )
    if (values <= 0).any():
        raise invalid(name, values.min(), "positive", remedy)
    return np.broadcast_to(values, count).copy()


def block_slices(sizes: Sequence[int]) -> list[slice]:
    """The places of diagonal blocks of these sizes."""
    return [slice(start, end) for start, end in pairwise(np.cumsum([0, *sizes]).tolist())]


def slow_states(
    increment: np.ndarray, sizes: Sequence[int], dt: float, windup_time: float
) -> np.ndarray:
    """Which states (n,) belong to blocks that decay slower than five times the windup time, or not
    at all.

    increment (n, n): A - I.
    """
    slow = np.zeros(len(increment), bool)
    for block in block_slices(sizes):
        # slow: 1 - |z| < dt/(_SLOW windup_time), for the slowest mode of the block
        radius = np.abs(np.linalg.eigvals(increment[block, block]) + 1).max()
        slow[block] = 1 - radius < dt / (_SLOW * windup_time)
    return slow


def anti_windup_gain(
    increment: np.ndarray,
    C: np.ndarray,
    size: np.ndarray,
    currents: np.ndarray,
    rate: float,
    where: str,
) -> np.ndarray:
    """L (n, p) [1/A]: a filter's gain, from the Riccati equation, that stabilises A - L C.

    increment (n, n): A - I. States are weighted by their effect ``size`` (n,) on the outputs C (p,
    n) in parts of the currents (p,) [A]; with one integrator per output the unwinding takes rate =
    dt / windup_time per sample. Raises NumericalFailure.
    """
    # states size x: A = size A/size, C = C/size, so that each moves the outputs by about 1
    A, C = np.eye(len(increment)) + increment * size[:, None] / size, C / size
    p = len(currents)
    try:
        # P = A P A' - A P C'(I + C P C')^-1 C P A' + rate^2 I,   L = A P C'(I + C P C')^-1;
        # one integrator, A = C = 1: P^2 = rate^2 (1 + P), hence L = rate for small rates
        P = sla.solve_discrete_are(A.T, C.T, rate**2 * np.eye(len(A)), np.eye(p))
        L = A @ np.linalg.solve(np.eye(p) + C @ P @ C.T, C @ P).T
    except np.linalg.LinAlgError as error:
        raise NumericalFailure(
            f"no anti-windup gain was found {where} ({error}): an integrator that no output sees, "
            "or an unsuitable "
            "windup_time; remove that state, or give another windup_time"
        ) from error
    if np.abs(np.linalg.eigvals(A - L @ C)).max() >= 1:
        raise NumericalFailure(
            f"the anti-windup gain {where} does not stabilise the states; give another windup_time"
        )

    # back from size x, and from parts of the currents to [1/A]
    return L / size[:, None] / currents


def transfer_gains(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """steady (k, n, m) and pick (k, n, p), so that x = steady e; x += pick (u - C x - D e) goes on
    with the currents u.

    increment (k, n, n): A - I; B (k, n, m), C (k, p, n); slow (n,); currents (p,) [A]. steady:
    where fast states stand for constant errors. pick = W C' (C W C')^-1: of all states that
    continue with u, the nearest to the fast modes' steady state, in weights W that leave the fast
    modes alone where the slow ones span the outputs. None where the states do not reach every
    output.
    """
    k, p, n = C.shape
    steady = np.zeros((k, n, B.shape[2]))
    pick = np.zeros((k, n, p))
    fast = ~slow

    # spans: whether the slow states alone reach every output, at every point
    C = C / currents[:, None]
    size = np.maximum(np.linalg.norm(C, axis=1).max(axis=0, initial=0.0), _UNSEEN)
    spans = slow.any() and all(
        np.linalg.matrix_rank(c[:, slow] / size[slow], tol=1e-3) == p for c in C
    )

    # W: states by their effect on the outputs, the fast ones left alone where the slow ones span
    weight = np.where(slow | (not spans), 1 / size**2, 0.0)
    for i in range(k):
        # C W C'; singular where no state reaches some combination of the outputs
        gram = (C[i] * weight) @ C[i].T
        if n == 0 or np.linalg.matrix_rank(gram, tol=1e-9 * max(np.trace(gram), 1e-300)) < p:
            return None

        # (I - A) x = B e of the fast states;  pick = W C'(C W C')^-1
        steady[i, fast] = np.linalg.solve(-increment[i][np.ix_(fast, fast)], B[i, fast])
        pick[i] = weight[:, None] * np.linalg.solve(gram, C[i]).T / currents
    return steady, pick


# Everything that the generated code contains, as numbers: the sampled controller in scaled states,
# limits, anti-windup.
#
#     u  = C x + D e                         the current asked for
#     us = min(max(u, -limit), limit)        the current given
#     x += increment x + B e + unwind (us - u)
#
# Every state lies within +-1 for every input that passes the plausibility check, which is proved:
# whatever the saturation does, x[k+1] = (A - L C) x + (B - L D) e + L us holds with L = unwind, so
# the peak gains of that system bound the states.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlBlock(Block):
    """What runs: see the module's formulas.

    sizes: of the diagonal blocks of ``increment``; from_error (n, m) [1/m] and from_output (n, p)
    [1/A]: the states with which the controller goes on from given currents; winding: how many
    states, the first ones, wind up.
    """

    sizes: tuple[int, ...]
    from_error: np.ndarray
    from_output: np.ndarray
    winding: int

    @property
    def transfers(self) -> bool:
        return bool(self.from_output.any())

    def said(self) -> dict[str, Any]:
        """What the templates ask of its form."""
        return {"cascade": False, "mixes": False}

    def listing(self) -> Sequence[tuple[Any, Sequence[float], float]]:
        """Every section of a cascade, its coefficients, and its largest output [m]."""
        return ()

    def tables(self) -> dict[str, np.ndarray]:
        """The numbers of the code, as they lie in memory."""
        return {
            "error_limit": self.error_limit,
            "current_limit": self.current_limit,
            "B": self.B.T,
            "C": self.C.T,
            "D": self.D.T,
            "unwind": self.unwind[: self.winding].T,
            "transfer_error": self.from_error.T,
            "transfer_current": self.from_output.T,
        }

    def products(self, *, floating: bool) -> int:
        """Of a step: whole diagonals of A - I, dense B, C and (where not zero) D."""
        n = self.n_states
        m, p = len(self.inputs), len(self.outputs)
        direct = m * p if self.D.any() else 0
        return len(diagonals_of(self.increment)) * n + n * m + n * p + direct

    @property
    def fractions(self) -> int:
        """How many sums in whole numbers keep what their shifts cut off."""
        return 0

    def cost(self, arithmetic: str) -> Cost:
        n, w = self.n_states, self.winding
        m, p = len(self.inputs), len(self.outputs)
        signal, state = BYTES[arithmetic]
        floating = arithmetic in {"double", "float"}
        products = self.products(floating=floating)

        # kept between samples: what compensated sums lost, or the fractions saved
        carry = w * signal if floating else self.fractions * state

        # coefficients with the unwinding, limits and transfer, then the shifts of the rows, a
        # byte each
        tables = products + w * p + floating * (m + p) + self.transfers * n * (m + p)
        shifts = 0 if floating else n + 2 * p + self.transfers * n
        return Cost(
            multiplications=products,
            additions=products + n + (3 * w if floating else 0),
            limited=w * p,
            state_bytes=(n + sum(self.padding)) * state + carry + m * (signal + 2),
            table_bytes=tables * signal + shifts,
        )

    @property
    def system(self) -> StateSpace:
        """The block between its limits, as a sampled system."""
        A = np.eye(self.n_states) + self.increment
        return StateSpace(A, self.B, self.C, self.D, self.inputs, self.outputs, self.sample_time)

    def respond(self, e: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The currents asked for (p,) [A] and what is added to the states (n,), for errors e (m,)
        [m].
        """
        return self.D @ e + self.C @ x, self.increment @ x + self.B @ e


def build_block(
    deployment: Deployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
) -> ControlBlock:
    """The block of a deployment.

    name: prefix of everything in the code, a C identifier. error_limit [m] and current_limit [A]:
    one number or one per axis; larger errors are implausible, larger currents are cut. windup_time
    [s]: how fast states slower than five times it follow the limited output. hold_samples: a
    missing input is replaced by its last good value for so many samples before the block reports a
    fault. Raises InvalidInput, UnstableSystem for a controller whose states have no bound.
    """
    K = deployment.controller
    settings = check_settings(K, name, error_limit, current_limit, windup_time, hold_samples)
    errors, currents = settings.error_limit, settings.current_limit
    dt = float(K.dt or 0.0)

    # anti-windup L and bounds in the deployment's states, then scale: z = x/scale within +-1
    slow = slow_states(deployment.increment, deployment.sizes, dt, windup_time)
    unwind = unwinding(deployment, slow, currents, dt / windup_time)
    bound = state_bounds(deployment, unwind, slow, settings)
    scale = _powers(deployment.sizes, bound)

    # currents asked for at most: |C| bound + |D| errors
    C, D = K.C * scale, K.D
    raw = np.abs(C) @ (bound / scale) + np.abs(D) @ errors
    from_error, from_output = transfer(deployment, scale, slow, currents)

    # states that wind up first; A - I in scaled states
    order, sizes = _winding_first(deployment.sizes, slow)
    increment = (deployment.increment * scale / scale[:, None])[np.ix_(order, order)]
    return ControlBlock(
        name=name,
        inputs=names_in_code(K.inputs),
        outputs=names_in_code(K.outputs),
        sample_time=dt,
        delay=deployment.delay,
        sizes=sizes,
        increment=increment,
        B=(K.B / scale[:, None])[order],
        C=C[:, order],
        D=D,
        unwind=(unwind / scale[:, None])[order],
        from_error=from_error[order],
        from_output=from_output[order],
        error_limit=errors,
        current_limit=currents,
        raw_limit=np.maximum(raw, currents),
        winding=int(slow.sum()),
        hold_samples=hold_samples,
        windup_time=windup_time,
    )


def _winding_first(sizes: Sequence[int], slow: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    blocks = sorted(block_slices(sizes), key=lambda block: not slow[block.start])
    order = (
        np.concatenate([np.arange(b.start, b.stop) for b in blocks]) if blocks else np.zeros(0, int)
    )
    return order, tuple(b.stop - b.start for b in blocks)


def unwinding(
    deployment: Deployment, slow: np.ndarray, currents: np.ndarray, rate: float
) -> np.ndarray:
    """L (n, p) [1/A], on the slow states only."""
    gain = np.zeros((deployment.controller.n_states, len(currents)))
    if not slow.any():
        return gain

    # currents in parts of their limits, seen from the slow states
    C = deployment.controller.C[:, slow] / currents[:, None]
    size = np.linalg.norm(C, axis=0)
    if not (size > 0).all():
        raise UnstableSystem(
            "the controller has an integrator that no output sees: it would grow for ever; remove "
            "that state"
        )
    where = f"for the controller's {len(size)} slow states"
    gain[slow] = anti_windup_gain(
        deployment.increment[np.ix_(slow, slow)], C, size, currents, rate, where
    )
    return gain


def state_bounds(
    deployment: Deployment, unwind: np.ndarray, slow: np.ndarray, settings: Settings
) -> np.ndarray:
    """Bounds (n,) on the states for every plausible input and any saturation (the module's
    formula).
    """
    K = deployment.controller
    E = deployment.increment
    errors = settings.error_limit
    bound = np.zeros(K.n_states)

    # blocks without slow states have no anti-windup: x[k+1] = A x + B e
    for block in block_slices(deployment.sizes):
        if not slow[block].any():
            bound[block] = peak_gains(E[block, block], K.B[block] * errors) @ np.ones(len(errors))
    if slow.any():
        # slow states: x[k+1] = (A - L C) x + (B - L D) e - L C_fast x_fast + L us,
        # fast ones at their bounds
        L, fast = unwind[slow], ~slow
        B = np.hstack(
            [
                (K.B[slow] - L @ K.D) * errors,
                -L @ K.C[:, fast] * bound[fast],
                L * settings.current_limit,
            ]
        )
        bound[slow] = peak_gains(E[np.ix_(slow, slow)] - L @ K.C[:, slow], B).sum(axis=1)
    if not np.isfinite(bound).all():
        raise UnstableSystem(
            "a state of the controller has no bound: it is unstable; design a stable controller "
            "for code"
        )
    return np.maximum(HEADROOM * bound, np.finfo(float).tiny)


def _powers(sizes: Sequence[int], bound: np.ndarray) -> np.ndarray:
    """Powers of two (n,), not below the bounds, one for the two states of a rotation."""
    scale = np.exp2(np.ceil(np.log2(bound)))

    # one scale keeps a rotation a rotation
    for block in block_slices(sizes):
        if block.stop - block.start == 2:
            scale[block] = scale[block].max()
    return scale


def transfer(
    deployment: Deployment, scale: np.ndarray, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled states from errors (n, m) and currents (n, p), zero where the states cannot set the
    outputs.
    """
    K = deployment.controller
    gains = transfer_gains(deployment.increment[None], K.B[None], K.C[None], slow, currents)
    if gains is None:
        return np.zeros(K.B.shape), np.zeros(K.C.T.shape)

    # x = steady e + pick (u - (D + C steady) e): fast states at constant errors, moved
    # until the outputs are u
    steady, pick = gains[0][0], gains[1][0]
    return (steady - pick @ (K.D + K.C @ steady)) / scale[:, None], pick / scale[:, None]
