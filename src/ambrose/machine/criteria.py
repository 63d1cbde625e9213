"""Limits as data: what the standards and the reference work ask for, and how a user's requirement
overrides it.

Nothing here computes a quantity. A ``Criterion`` is a row with its source; a ``Rule`` says which
row (if any) and which field of ``Requirements`` judge a quantity. What verification judges by and
what tuning aims at is the same.
"""

from dataclasses import dataclass

import numpy as np

from ambrose.machine.description import Requirements


@dataclass(frozen=True, slots=True)
class Limit:
    """Upper end of a zone (or the one limit, with zone ""); confirmed: seen in a source at hand,
    False: recalled only.
    """

    zone: str
    value: float
    confirmed: bool


@dataclass(frozen=True, slots=True)
class Criterion:
    """One criterion of a standard: what it limits, where it is written, and how well we know it.

    limits ascend; a value below the first is in its zone, past the last one in ``beyond``.
    relation: "<", "<=" or ">=".
    """

    name: str
    quantity: str
    standard: str
    edition: str
    clause: str
    unit: str
    limits: tuple[Limit, ...]
    relation: str = "<"
    beyond: str | None = None
    note: str = ""

    @property
    def source(self) -> str:
        """Standard, edition and clause in one line, with a remark when the applied (first) limit is
        recalled only.
        """
        recalled = (
            ""
            if self.limits and self.limits[0].confirmed
            else " (recalled, not checked against the text)"
        )
        return f"{self.standard}:{self.edition}, {self.clause}{recalled}"


SENSITIVITY = Criterion(
    "iso-14839-3.sensitivity",
    "largest modulus of the sensitivity function of each control axis, other loops closed",
    "ISO 14839-3",
    "2006",
    "zone limits of the peak sensitivity",
    "-",
    (Limit("A", 3.0, True), Limit("B", 4.0, False), Limit("C", 5.0, False)),
    beyond="D",
    note="zone A is quoted by the reference work; B and C are recalled. Per axis: the maximum "
    "singular value is stricter, and has no zone",
)
SENSITIVITY_RANGE = Criterion(
    "iso-14839-3.frequency-range",
    "frequency up to which the sensitivity is evaluated: the greater of this and 3 times the "
    "rated speed",
    "ISO 14839-3",
    "2006",
    "measuring range",
    "rad/s",
    (Limit("", 12566.370614359172, False),),
    note="2 kHz",
)
CLEARANCE = Criterion(
    "iso-14839-2.displacement",
    "largest displacement from the clearance centre as a fraction of the minimum clearance",
    "ISO 14839-2",
    "2004",
    "zone limits of the shaft displacement",
    "-",
    (Limit("A", 0.3, False), Limit("B", 0.4, False), Limit("C", 0.5, False)),
    beyond="D",
    note="the standard's displacement includes a static offset; here it is the unbalance orbit "
    "about the centre",
)
LOG_DECREMENT = Criterion(
    "api-617.log-decrement",
    "logarithmic decrement of the first forward mode",
    "API 617",
    "9th edition (2022)",
    "stability analysis",
    "-",
    (Limit("", 0.1, False),),
    relation=">=",
    note="from public code that cites the 9th edition; the annex on magnetic bearings was not seen",
)
SEPARATION = Criterion(
    "api-617.separation-margin",
    "amplification factor of a critical speed over the one that its place allows "
    "(model/static_load.py)",
    "API 617",
    "9th edition (2022)",
    "separation margin",
    "-",
    (Limit("", 1.0, False),),
    relation="<=",
    note="the formula from public code that cites the 8th edition and API 684; the text was not "
    "seen",
)
BALANCE_GRADE = Criterion(
    "iso-21940-11.balance-grade",
    "default residual unbalance: speed times eccentricity of the centre of mass",
    "ISO 21940-11",
    "2016",
    "balance quality grade G2.5",
    "m/s",
    (Limit("", 2.5e-3, True),),
    note="G2.5 is the grade the reference work assumes; the force at speed W balanced at W_b is "
    "mass grade W^2 / W_b",
)

TWO_PI = 2 * np.pi  # rad/s per Hz
# ISO 14839-3: multiples of the rated speed that the sensitivity is evaluated to
SPEED_RANGE_FACTOR = 3.0


@dataclass(frozen=True, slots=True)
class Pulse:
    """A test disturbance: a rectangular pulse of excitation current, one axis at a time.

    duration [s], amplitude [A]; settled once every displacement stays within ``band`` [-] times the
    peak displacement.
    """

    duration: float
    amplitude: float
    band: float
    source: str


CURRENT_PULSE = Pulse(
    10e-3, 0.05, 0.05, "Lauridsen, PhD thesis, paper P5 (10 ms, 0.05 A); the 5 % band is ours"
)


@dataclass(frozen=True, slots=True)
class Rule:
    """Which requirement and which criterion judge a quantity; either may be missing. relation holds
    for the requirement.
    """

    quantity: str
    requirement: str | None = None
    criterion: Criterion | None = None
    relation: str = "<="
    # whether the criterion sets the limit without a requirement; False: it only tells the zone
    default: bool = True


RULES: dict[str, Rule] = {
    rule.quantity: rule
    for rule in (
        Rule("sensitivity of an axis", "sensitivity_peak", SENSITIVITY),
        Rule("input sensitivity of an axis", None, SENSITIVITY, default=False),
        # ISO 14839-3 judges axes: of all axes together nothing has a zone
        Rule("maximum singular value of a sensitivity", "sensitivity_peak"),
        Rule("compliance", "compliance_peak"),
        Rule("log decrement", "log_decrement", LOG_DECREMENT, ">="),
        Rule("damping above the top speed", "damping_above", relation=">="),
        Rule("unbalance orbit", "unbalance_orbit"),
        Rule("orbit over clearance", None, CLEARANCE),
        Rule("settling time", "settling_time"),
        Rule("gain margin", "gain_margin", relation=">="),
        Rule("phase margin", "phase_margin", relation=">="),
        Rule("current", "max_current"),
        Rule("control gain", "control_gain"),
        Rule("separation margin", None, SEPARATION),
        Rule("information"),
    )
}


@dataclass(frozen=True, slots=True)
class Demand:
    """What one quantity is held against: limit None means information only."""

    limit: float | None
    relation: str
    source: str
    zones: Criterion | None = None


def demand(quantity: str, requirements: Requirements) -> Demand:
    """The limit for a quantity of ``RULES``: the user's requirement if set, else the standard's,
    else none.
    """
    rule = RULES[quantity]
    wanted = None if rule.requirement is None else getattr(requirements, rule.requirement)
    zones = (
        rule.criterion if rule.criterion is not None and rule.criterion.beyond is not None else None
    )
    if wanted is not None:
        return Demand(float(wanted), rule.relation, f"requirement {rule.requirement}", zones)
    if rule.criterion is None:
        return Demand(None, rule.relation, "")
    if not rule.default:
        return Demand(
            None,
            rule.criterion.relation,
            f"{rule.criterion.source}, zone for comparison only",
            zones,
        )
    return Demand(
        rule.criterion.limits[0].value, rule.criterion.relation, rule.criterion.source, zones
    )


def machine_limit(value: float | None, source: str) -> Demand:
    """A limit that the machine itself sets, such as a bearing's largest current; None means
    information only.
    """
    return Demand(value, "<=", source if value is not None else "")
