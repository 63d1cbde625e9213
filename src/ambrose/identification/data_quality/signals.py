"""What a signal shows by itself: dead, clipped, held or repeated samples, at a limit of the
machine, not excited.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse, signal_rows
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS
from ambrose.machine.validation.ranges import usual
from ambrose.record.record import Record
from ambrose.record.response import Response

_LONG, _FEW = 3, 2  # samples of a flat top, and how many flat tops make it clipping
# samples at the extreme over those one step below it: 2.4 at the crest of a sine in coarse steps
_CROWDED = 4.0
_STEPPED = 1e-3  # share of equal neighbours from which a signal comes in coarse steps
_ROUNDING = 1e-9  # of a signal's size: less than this moves nothing
_SERIOUS = 1e-3  # share of clipped or repeated samples from which a record is refused
_AT_LIMIT = 0.999  # of the limit: a converter may stop a step short of it
_BEGINNING = 0.3  # share of a record: a limit is reached in it alone before the rotor settled
_HELD, _FEWEST_HELD = 0.05, 100  # share of a record, and samples, from which a sensor is stuck
_TWICE = 2.0  # of what the machine file states: beyond it is another unit, or another machine
_SURFACE = 800.0  # m/s, which no shaft of steel holds
_NONE, _PASCALS = 0.02, 1e4  # of a pressure, and a pressure [Pa]: what an idle sensor may show
_SIZES = {
    "speed": "angular rate",
    "seal_pressure": "pressure",
    "bias_current": "current",
    "whirl_frequency": "angular rate",
}
_STEADY = 0.05  # change of speed or pressure within a record, over its largest
_MEASURED = ("y", "u", "i")


def signal_findings(
    machine: Machine, record: Record, number: int, excited: str = "ef"
) -> list[Finding]:
    """The findings of one record, the ``number``-th of those given; excitations may be constant or
    two-valued. excited: kinds of excitation of which one must be there ("": none).
    """
    where = f"record {number}"
    findings = _excitation(machine, record, where, excited) if excited else []
    shown = [f"{kind}_{axis}" for kind in _MEASURED for axis in machine.axes]
    shown = [name for name in shown if name in record.signals]
    for name in shown:
        if np.ptp(record[name]) == 0:
            what = f"{where}: {name} never changes"
            evidence = f"all {record.values.shape[1]} samples are {record[name][0]:g}"
            remedy = (
                "a dead sensor or an unplugged channel: repair it, or leave the signal out of the "
                "record"
            )
            findings.append(Finding(Code.DEAD_CHANNEL, ERROR, what, evidence, remedy))
    moving = [name for name in shown if np.ptp(record[name]) > 0]
    for name in moving:
        findings += _at_limit(machine, record, name, where) or _clipped(record, name, where)
    findings += _stuck(record, [name for name in moving if name[0] == "y"], where)
    findings += _repeated(record, moving, where)
    return [*findings, *_moving_point(record, where), *point_findings(machine, record)]


def flat_tops(x: np.ndarray) -> tuple[int, float]:
    """Samples of x (k,) that lie at its clipped extreme, and that extreme; 0 where no extreme looks
    clipped.

    Clipped: several stretches of equal samples at the extreme, which a smooth signal has nowhere;
    in a signal of coarse steps, also far more samples there than one step below (a sine has 2.4
    times as many in its top step).
    """
    best, level = 0, 0.0
    for sign in (1.0, -1.0):
        y = sign * x
        top = y.max()
        at = y == top
        edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8)))
        long = int(((edges[1::2] - edges[::2]) >= _LONG).sum())
        others = y[~at]
        if long < _FEW or not others.size:
            continue
        stepped = np.mean(np.diff(others) == 0) > _STEPPED
        below = int((others == others.max()).sum()) if stepped else 0
        if at.sum() > _CROWDED * below and at.sum() > best:
            best, level = int(at.sum()), float(sign * top)
    return best, level


def _clipped(record: Record, name: str, where: str) -> list[Finding]:
    x = record[name]
    if np.ptp(x) <= _ROUNDING * np.abs(x).max():
        return []
    count, level = flat_tops(x)
    if not count or len(np.unique(x[:20000])) <= 3:  # two or three values alone: a switched signal
        return []
    share = count / len(x)
    unit = record.units[record.signals.index(name)]
    severity = ERROR if share > _SERIOUS else WARNING
    what = f"{where}: {name} is clipped"
    evidence = (
        f"{count} samples ({100 * share:.2g} %) lie exactly at {level:.4g} {unit}, in flat tops"
    )
    remedy = (
        "reduce the excitation, or widen the range of the sensor or the converter, and measure "
        "again"
    )
    return [Finding(Code.CLIPPED, severity, what, evidence, remedy)]


def _at_limit(machine: Machine, record: Record, name: str, where: str) -> list[Finding]:
    """Currents at the bearing's limit, displacements at its touchdown gap."""
    kind, axis = name.split("_", 1)
    bearing = machine.axis_bearings[machine.axes.index(axis)]
    gap = bearing.touchdown_gap
    limit, what = (
        (min(gap) if isinstance(gap, tuple) else gap, "touchdown gap")
        if kind == "y"
        else (bearing.max_current, "largest control current")
    )
    if limit is None or kind == "i":
        return []
    x = record[name]
    at = np.flatnonzero(np.abs(x) >= _AT_LIMIT * limit)
    count = len(at)
    if not count:
        return []
    unit = record.units[record.signals.index(name)]
    share = count / len(x)
    remedy = "reduce the excitation until no signal reaches its limit, and measure again"
    if at[-1] < _BEGINNING * len(x):
        remedy = (
            f"all of them lie in the first {(at[-1] + 1) * record.dt:.3g} s, as of a lift-off or a "
            "knock: record again once the rotor has settled, or take what follows that (identify "
            "--between)"
        )
    evidence = (
        f"{count} samples ({100 * share:.2g} %) reach the bearing's {what} of {limit:.4g} {unit}"
    )
    code, text = (
        (Code.SATURATED, "is saturated")
        if kind != "y"
        else (Code.TOUCHDOWN, "reaches the touchdown bearing")
    )
    return [
        Finding(
            code,
            ERROR if share > _SERIOUS or kind == "y" else WARNING,
            f"{where}: {name} {text}",
            evidence,
            remedy,
        )
    ]


def _stuck(record: Record, names: list[str], where: str) -> Iterator[Finding]:
    """A displacement that keeps one value for a good part of the record, while another moves as
    much as elsewhere: a sensor that hangs, or a cable that came off.
    """
    for name in names:
        row = record[name]
        edges = np.flatnonzero(np.diff(row, prepend=np.nan, append=np.nan) != 0)
        longest = int(np.argmax(np.diff(edges)))
        first, last = int(edges[longest]), int(edges[longest + 1])
        if last - first < max(_HELD * len(row), _FEWEST_HELD):
            continue
        others = [other for other in names if other != name]
        if any(np.std(record[o][first:last]) > 0.3 * np.std(record[o]) for o in others):
            begin, end = record.time[first], record.time[last - 1]
            what = f"{where}: {name} stands still from {begin:.5g} to {end:.5g} s"
            evidence = f"{last - first} samples are {row[first]:g}, while other displacements move"
            remedy = "mend the sensor or its cable, and record again"
            yield Finding(Code.STUCK, ERROR, what, evidence, remedy)


def point_findings(machine: Machine | None, record: Record | Response) -> Iterator[Finding]:
    """An operating point that the machine (None: any) cannot have, and currents that no amplifier
    of it gives.
    """
    point = record.point
    signals = {n: record[n] for n in record.signals} if isinstance(record, Record) else {}
    remedy = "correct the record's operating point (its unit, its sign), or the machine file"

    def of_point(name: str, value: float, unit: str, allowed: str) -> Finding:
        what = f"{name} of the record's operating point is {value:.4g} {unit}"
        return Finding(Code.OPERATING_POINT, ERROR, what, allowed, remedy)

    for key, dimension in _SIZES.items():
        value, unit = getattr(point, key) or 0.0, DIMENSIONS[dimension].unit
        low, high = usual(f"operation.point.{key}", dimension) or (0.0, np.inf)
        # what stands still turns a little by its encoder, and an idle gauge shows a little
        if abs(value) > high or (0 < value < low and key == "bias_current"):
            span = f"{low:.4g} to {high:.4g} {unit} is usual"
            yield of_point(f"the {key.replace('_', ' ')}", value, unit, span)
            return
    envelope = () if machine is None else machine.operation.envelope
    radius = max((part.outer_diameter for part in getattr(machine, "shaft", ())), default=0.0) / 2
    speeds = () if machine is None else machine.operation.speed_range
    fastest = max((*speeds, *(other.speed for other in envelope)), default=0.0)
    fastest = _TWICE * fastest or (_SURFACE / radius if radius else np.inf)
    if point.speed > fastest:
        yield of_point("the speed", point.speed, "rad/s", f"the machine has at most {fastest:.4g}")
    bearings = () if machine is None else machine.axis_bearings
    biases = [b.bias_current for b in bearings if getattr(b, "bias_current", None)]
    biases += [other.bias_current for other in envelope if other.bias_current]
    if point.bias_current is not None and biases:
        low, high = min(biases) / _TWICE, _TWICE * max(biases)
        if not low <= point.bias_current <= high:
            yield of_point(
                "the bias current",
                point.bias_current,
                "A",
                f"the machine has {', '.join(f'{b:g}' for b in set(biases))}",
            )
    largest = max((abs(other.seal_pressure) for other in envelope), default=0.0)
    own = {"the seal pressure": point.seal_pressure}
    own |= {n: float(row.mean()) for n, row in signals.items() if n.partition("_")[0] == "p"}
    for name, value in own.items():
        if value < -_NONE * max(largest, _PASCALS):
            yield of_point(name, value, "Pa", "pressures across a seal are 0 and above")
        if largest and value > 2 * _TWICE * largest:
            yield of_point(name, value, "Pa", f"the machine has at most {largest:.4g}")
    for axis, bearing in zip(() if machine is None else machine.axes, bearings, strict=True):
        name, limit = f"i_{axis}", bearing.max_current
        if limit is None or name not in signals:
            continue
        share = float(np.mean(np.abs(signals[name]) > _TWICE * limit))
        if share > _SERIOUS:
            evidence = f"{100 * share:.2g} % of its samples exceed twice the largest, {limit:g} A"
            mend = "record the control current, without the bias, and check its scale"
            yield Finding(Code.SATURATED, ERROR, f"{name} is not a control current", evidence, mend)


def check_point(machine: Machine, record: Record, where: str) -> None:
    """Raises InvalidInput for an operating point that changes during the record, or that the
    machine cannot have.
    """
    refuse((*_moving_point(record, where), *point_findings(machine, record)))


def _moving_point(record: Record, where: str) -> Iterator[Finding]:
    """Speed or pressure that changes during the record: the model holds at one operating point."""
    for name, unit in zip(record.signals, record.units, strict=True):
        if name.partition("_")[0] in {"p", "speed"}:
            low, high = float(record[name].min()), float(record[name].max())
            if high - low > _STEADY * max(abs(low), abs(high)):
                what = f"{where}: the operating point changes"
                evidence = f"{name} goes from {low:.4g} to {high:.4g} {unit}"
                remedy = "cut the record into stretches at one speed and pressure, and take those"
                yield Finding(Code.MOVING_POINT, ERROR, what, evidence, remedy)


def _repeated(record: Record, names: list[str], where: str) -> list[Finding]:
    """All measured channels equal to their last sample at once: a logger that repeats, or a slower
    rate than stated.
    """
    if len(names) < 2:
        return []
    same = np.array([row[1:] == row[:-1] for row in signal_rows(record, names)])
    moving = np.flatnonzero(~same.all(axis=0))
    if not len(moving):
        return []
    same = same[:, moving[0] : moving[-1] + 1]  # at rest before and after the experiment
    both = same.all(axis=0)
    count, k = int(both.sum()), same.shape[1]
    alone = (same.sum(axis=1) - count) / max(k - count, 1)
    expected = k * float(np.prod(np.sort(alone)[:2]))  # of the two that repeat least, by chance
    if count <= 3 * expected + 0.5:
        return []
    share = count / k
    first = int(np.flatnonzero(both)[0]) + 1 + int(moving[0])
    evidence = (
        f"{count} of {k} samples repeat the one before in all of {len(names)} channels, first at "
        f"sample {first}"
    )
    hold = 1 / (1 - share)
    if share > 0.3 and abs(hold - round(hold)) < 0.05:
        rate = record.sample_rate_hz
        what = f"{where}: the sample rate of {rate:g} Hz is not the one it was measured at"
        evidence = (
            f"every value is held for {round(hold)} samples, as if measured at "
            f"{rate / round(hold):g} Hz"
        )
        remedy = (
            "record at the controller's rate, or keep every value once and correct sample_rate_hz"
        )
        return [Finding(Code.SAMPLE_RATE, ERROR, what, evidence, remedy)]
    remedy = "samples were lost and filled in: find the gaps in the logger, or cut the record there"
    severity = ERROR if share > _SERIOUS else WARNING
    return [
        Finding(
            Code.REPEATED_SAMPLES,
            severity,
            f"{where}: samples are repeated in all channels at once",
            evidence,
            remedy,
        )
    ]


def _excitation(machine: Machine, record: Record, where: str, kinds: str) -> list[Finding]:
    """No excitation at all, or excitations that are there but never change."""
    excitations = [
        name
        for name in record.signals
        if name[:1] in kinds and name[1:2] == "_" and not name.startswith("f_magnet_")
    ]
    known = [name for name in excitations if name[:2] == "f_" or name[2:] in machine.axes]
    if any(np.ptp(record[name]) > 0 for name in known):
        return []
    held = ", ".join(dict.fromkeys(f"{name.partition('_')[0]}_" for name in record.signals))
    evidence = f"{', '.join(known)} never change" if known else f"it has signals {held} alone"
    if excitations and not known:
        evidence = (
            f"{', '.join(excitations)} fit no axis of the machine ({', '.join(machine.axes)})"
        )
    what = f"{where} holds no excitation"
    remedy = (
        "add a PRBS or chirp to the controller's output and record it as e_<axis>; noise alone "
        "tells nothing"
    )
    return [Finding(Code.NO_EXCITATION, ERROR, what, evidence, remedy)]


# Where a record's rotor has settled: a knock, or the end of a lift-off, at a record's beginning is
# motion of tens of micrometres, at which the magnets are another machine than about the middle.
#
# The judgement needs no model. A signal's mean and its swing over short blocks are held against
# what those of later blocks scatter about their own middle; a beginning is left out up to the last
# block beyond, and twice as much again, so that a decay is down by the same factor twice more.


_BLOCK = 0.02  # s; a block is that long at least
_BLOCKS = 400  # of a long record
_FEWEST = 20  # blocks, below which nothing is told
_BEYOND = 8.0  # times the scatter of later blocks: not settled; assumed
_MOVED = 5.0  # times its own scatter: the excitation does it itself; assumed
_PART = 0.5  # of the signal's own standard deviation later: less is a small part of what it does
_QUIET = 10  # blocks in a row within their bound, after which a signal has settled
_LONGEST = 0.3  # share of a record that may be left out: a longer course is the experiment itself
_AT_LIMITS = {Code.TOUCHDOWN, Code.SATURATED, Code.CLIPPED}


def settled(machine: Machine, record: Record) -> Record:
    """The record from where every y_ and u_<axis> has settled; the record itself where they had
    from the first sample on, where they never do, and where one reaches a limit of the machine:
    what is said of that must not be lost with a beginning.

    What an excitation, reference or force does itself is no reason: a slow chirp moves the rotor
    slowly.
    """
    samples = record.values.shape[1]
    length = max(round(_BLOCK / record.dt), samples // _BLOCKS, 1)
    count = samples // length
    if count < _FEWEST:
        return record
    axes = set(machine.axes)
    blocks = 0
    for name, row in zip(record.signals, record.values, strict=True):
        kind, _, place = name.partition("_")
        whole = row[: count * length].reshape(count, length)
        if kind in {"y", "u"} and place in axes:
            least = _PART * float(np.std(row[count // 2 * length :]))
            mean, swing = _courses(whole)
            blocks = max(blocks, _unsettled(np.abs(mean - _middle(mean)), mean, least))
            # a swing that is smaller at first is no motion to wait for
            blocks = max(blocks, _unsettled(swing - _middle(swing), swing, least))
    # three times as long: what had fallen to a part r of its beginning is down to r^3; two times
    # at least
    longest = int(_LONGEST * count)
    if blocks == 0 or 2 * blocks > longest:
        return record
    blocks = min(3 * blocks, longest)
    if _moved(record, blocks, length, count):
        return record
    if any(found.code in _AT_LIMITS for found in signal_findings(machine, record, 1, "")):
        return record
    return record.between(float(record.time[blocks * length]), float(record.time[-1]) + record.dt)


def left_out(whole: Sequence[Record], kept: Sequence[Record]) -> str:
    """In words, which beginnings ``settled`` took off; empty where none."""
    parts = [
        f"the first {now.start_time - record.start_time:.3g} s of record {number}"
        for number, (record, now) in enumerate(zip(whole, kept, strict=True), 1)
        if now is not record
    ]
    if not parts:
        return ""
    verb = "is" if len(parts) == 1 else "are"
    return (
        f"{', '.join(parts)} {verb} left out: the rotor had not settled (--between takes what you "
        "name)"
    )


def taken(parts: Sequence[Record]) -> str:
    """In words, from when to when the records were cut on demand."""
    each = [
        f"{part.start_time:.4g} to {part.start_time + part.values.shape[1] * part.dt:.4g} s of "
        f"record {number}"
        for number, part in enumerate(parts, 1)
    ]
    return f"{', '.join(each)} {'was' if len(each) == 1 else 'were'} taken"


def _courses(whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and swing (blocks,) of a signal in blocks (blocks, samples)."""
    return whole.mean(axis=1), np.ptp(whole, axis=1)


def _middle(values: np.ndarray) -> float:
    """The median of the later half."""
    return float(np.median(values[len(values) // 2 :]))


def _scatter(values: np.ndarray) -> float:
    """The standard deviation of the later half."""
    return float(np.std(values[len(values) // 2 :]))


def _unsettled(off: np.ndarray, values: np.ndarray, least: float) -> int:
    """How many blocks at the beginning are not settled yet, ``off`` (blocks,) from the middle of
    ``values`` (blocks,); ``least``: a smaller deviation is none.
    """
    beyond = off > max(_BEYOND * _scatter(values), least)
    # a decay is largest where the record begins; of a swing, the mean may pass its middle there
    if not beyond[:2].any():
        return 0
    # the first block after which ten in a row are within
    within = np.convolve(~beyond, np.ones(_QUIET, int), "valid") == _QUIET
    return int(within.argmax()) if within.any() else len(off)


def _moved(record: Record, blocks: int, length: int, count: int) -> bool:
    """Whether an excitation, a reference or a force has another course over the first ``blocks``
    than later.
    """
    for name, row in zip(record.signals, record.values, strict=True):
        # a magnet's force is measured; all else with these names is given
        if name[:2] not in {"e_", "r_", "f_"} or name.startswith("f_magnet_"):
            continue
        for values in _courses(row[: count * length].reshape(count, length)):
            off = np.abs(values[:blocks] - _middle(values)).max()
            if off > max(_MOVED * _scatter(values), 1e-9 * np.abs(row).max()):
                return True
    return False
