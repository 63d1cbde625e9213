"""``ambrose.compare``: a lateral analysis beside another code's table, beside measured values, or
beside an earlier analysis of the same rotor.

Every critical speed and every mode of theirs gets the one of ours that is nearest in the logarithm
of the speed, so that all pairs together lie as near as they can (each of ours is taken once), and
none further away than ``NEAR``.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ambrose.annexes.rotordynamics.placement import BACKWARD
from ambrose.annexes.rotordynamics.result import SCHEMA, Lateral
from ambrose.annexes.rotordynamics.standard import MODES_TO, RPM, rpm
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented, data_frame
from ambrose.identification.responses import response_fit
from ambrose.identification.result import ResponseFit
from ambrose.judge.measured import modelled, placed, read_responses
from ambrose.judge.plants import full_plants
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing, running_law
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.file.stations import Column, NamedTable, named_table
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import check_form, parse_json, read_text
from ambrose.machine.units import quoted, shown
from ambrose.record.response import (
    QUANTITIES,
    Path as MeasuredPath,
    Response,
    agreement,
    noise_beside,
    usable,
)

# Another code's results, or measured ones, as a table: CSV with a row of names first.
#
#    kind;     speed [rpm]; amplitude [um p-p]; amplification [-]; log_decrement [-]; whirl;   probe
#    critical; 5230;        34.1;               6.2;               ;                  ;        VE1
#    mode;     5411;        ;                   ;                  0.34;              forward;
#    response; 9000;        12.0;               ;                  ;                  ;        VE1
#
# ``critical``: a peak of the unbalance response; ``mode``: a damped natural frequency;
# ``response``: an amplitude at a speed. Columns stand in any order; but for kind and speed they may
# be missing.


KINDS = ("critical", "mode", "response")
WHIRLS = ("forward", "backward", "planar")
_EXAMPLE = "kind; speed [rpm]; amplitude [um p-p]; log_decrement [-]"
_COLUMNS = {  # name -> other names
    "kind": (),
    "speed": ("frequency", "rpm"),
    "amplitude": ("response",),
    "amplification": ("af", "amplification_factor"),
    "log_decrement": ("logdec", "log decrement", "log dec"),
    "damping_ratio": ("damping ratio", "zeta"),
    "whirl": ("direction",),
    "probe": ("reading",),
    "case": ("placement",),
    "label": ("name",),
}
_WORDS = ("kind", "whirl", "probe", "case", "label")
_PEAKS = {"p-p": 1.0, "pp": 1.0, "pk-pk": 1.0, "0-p": 2.0, "0-pk": 2.0}


@dataclass(frozen=True, slots=True)
class TheirRow:
    """One row: speed [rad/s], amplitude peak to peak [m]; None or "" where it says nothing."""

    kind: str
    speed: float
    amplitude: float | None = None
    amplification: float | None = None
    log_decrement: float | None = None
    whirl: str = ""
    probe: str = ""
    case: str = ""
    label: str = ""


def read_table(text: str, name: str) -> tuple[TheirRow, ...]:
    """The rows of a CSV text; ``name`` stands in messages. Raises InvalidInput."""
    try:
        table = named_table(text, _COLUMNS, _WORDS, required=("kind", "speed"), example=_EXAMPLE)
        for column in table.columns:
            if column.kind not in _WORDS:
                _si(column, 1.0)  # its unit, before any row
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {error}") from None
    return tuple(_row(f"{name}, line {line}", table, cells) for line, cells in table.rows)


def _si(column: Column, number: float) -> float:
    """In SI, amplitudes peak to peak: 0-p counts twice. Raises InvalidInput."""
    if column.kind == "speed":
        unit = column.unit or ("rpm" if column.word == "rpm" else "")
        return replace(column, unit=unit).si(number, "angular rate", "rpm")
    if column.kind != "amplitude":
        return column.si(number, "ratio", "-")
    length, _, peak = column.unit.rpartition(" ")
    if peak not in _PEAKS:
        raise InvalidInput(
            f'the unit of amplitude is "{column.unit}", but must state peak to peak or '
            'zero to peak; write "amplitude [um p-p]" or "amplitude [um 0-p]"'
        )
    return replace(column, unit=length).si(number, "length", "um p-p") * _PEAKS[peak]


def _row(where: str, table: NamedTable, cells: Mapping[Column, str]) -> TheirRow:
    words = {column.kind: cell for column, cell in cells.items() if column.kind in _WORDS}
    try:
        values = {
            column.kind: _si(column, table.number(column, cell))
            for column, cell in cells.items()
            if column.kind not in _WORDS
        }
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None
    kind = words.get("kind", "").lower()
    if kind not in KINDS:
        raise InvalidInput(
            f"{where}: kind is {quoted(words.get('kind', ''))}, but must be one of "
            f"{', '.join(KINDS)}; correct the row"
        )
    whirl = words.get("whirl", "").lower()
    if whirl and whirl not in WHIRLS:
        raise InvalidInput(
            f"{where}: whirl is {quoted(whirl)}, but must be one of {', '.join(WHIRLS)}; correct "
            "the row, or leave it empty"
        )
    if values.get("speed", 0.0) <= 0:
        raise InvalidInput(f"{where}: it needs a speed above 0; give one, or leave the row out")
    for column in ("amplitude", "amplification"):
        if values.get(column, 0.0) < 0:
            raise InvalidInput(
                f"{where}: {column} is negative, but must be at least 0; correct it, or leave the "
                "cell empty"
            )
    if kind == "response" and not values.get("amplitude"):
        raise InvalidInput(f"{where}: a response needs an amplitude; give one, or drop the row")
    damping = values.get("damping_ratio")
    decrement = values.get("log_decrement")
    if damping is not None and decrement is None:
        if not abs(damping) < 1:
            raise InvalidInput(
                f"{where}: damping_ratio is {damping:g}, but must lie below 1; give it as a share "
                "of critical damping, or with [%]"
            )
        # delta = 2 pi zeta/sqrt(1 - zeta^2)
        decrement = 2 * math.pi * damping / math.sqrt(1 - damping**2)
    return TheirRow(
        kind,
        values["speed"],
        values.get("amplitude"),
        values.get("amplification"),
        decrement,
        whirl,
        words.get("probe", ""),
        words.get("case", ""),
        words.get("label", ""),
    )


# The JSON schema of ``lateral.json``, for programs that read it.
#
# python -m ambrose.annexes.rotordynamics.comparison docs/lateral.schema.json


_NUMBER = {"type": "number"}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_SIZE = {"type": "number", "minimum": 0}
_TEXT = {"type": "string"}
_MAYBE = {"type": ["number", "null"]}
# infinite and unknown values are text: "inf", "nan"
_ANY_NUMBER = {"type": ["number", "string"]}
_VERDICT = {"type": ["boolean", "null"]}


def lateral_schema() -> dict[str, Any]:
    """The schema (draft 2020-12): keys carry their units, amplitudes 0p or pp."""
    item = _table(
        name=_TEXT,
        title=_TEXT,
        standard=_TEXT,
        clause=_TEXT,
        basis={"enum": ["checked", "recalled", "own"]},
        value={"type": ["number", "string", "null"]},
        unit=_TEXT,
        relation={"enum": ["<=", ">=", "<", ">"]},
        limit={"type": ["number", "string", "null"]},
        passed=_VERDICT,
        note=_TEXT,
        bound={"enum": ["", ">"], "description": ">: the value is more than the one given"},
        left_out={
            "type": "boolean",
            "description": "not checked, as the note explains; never a pass",
        },
    )
    mode = _table(
        frequency_rad_per_s=_SIZE,
        log_decrement=_NUMBER,
        judged={"type": "boolean", "description": "false: above the running speed"},
        whirl={**_NUMBER, "description": "1: forward circles, -1: backward ones"},
        shares={"type": "object", "additionalProperties": _NUMBER},
        least_over_tolerances_found=_MAYBE,
        at=_TEXT,
    )
    clearance = _table(
        name=_TEXT,
        kind={"enum": ["touchdown", "seal", "clearance", "magnet"]},
        position_m=_NUMBER,
        diametral_m=_NUMBER,
        motion_m_pp={**_NUMBER, "description": "scaled"},
        offset_m=_NUMBER,
        allowed_m_pp=_NUMBER,
        at_rad_per_s=_NUMBER,
        case=_TEXT,
        passed={"type": "boolean"},
    )
    budget = _table(
        axes=_list(_TEXT),
        frequencies_rad_per_s=_list(_NUMBER),
        elements_deg={"type": "object", "additionalProperties": _list(_NUMBER)},
        total_deg=_list(_NUMBER),
        notes=_list(_TEXT),
    )
    demand = _table(
        load=_TEXT,
        kind={"enum": ["unbalance", "part of unbalance", "impulse", "surge"]},
        frequency_rad_per_s=_NUMBER,
        force_N_0p={**_NUMBER, "description": "control current times k_i"},
        current_A_0p=_NUMBER,
        voltage_V_0p=_NUMBER,
        margin_alone=_ANY_NUMBER,
    )
    capacity = _table(
        axis=_TEXT,
        frequencies_rad_per_s=_list(_NUMBER),
        force_N_0p=_list(_NUMBER),
        other_side_force_N_0p=_list(_NUMBER),
        limited_by=_list(_TEXT),
        static_N={"type": "object", "additionalProperties": _NUMBER},
        static_current_A=_NUMBER,
        demands=_list(demand),
        margins=_list(_table(margin=_ANY_NUMBER, of=_TEXT, limited_by=_TEXT)),
    )
    weight = _table(position_m=_NUMBER, amount_kg_m=_NUMBER, angle_rad=_NUMBER, carried_kg=_NUMBER)
    peak = {
        "speed_rad_per_s": _POSITIVE,
        "amplitude_m_pp": _SIZE,
        "amplification_factor": {"type": ["number", "string"], "exclusiveMinimum": 0},
    }
    curve = _table(
        reading=_TEXT,
        case=_TEXT,
        amplitude_m_pp=_list(_SIZE),
        phase_lag_deg={
            **_list(_NUMBER),
            "description": "behind the key phasor, which is where the first unbalance is",
        },
        peaks=_list(_table(**peak)),
    )
    support = _table(
        axes=_list(_TEXT),
        kind={"enum": ["magnet", "film"]},
        speeds_rad_per_s=_list(_NUMBER),
        stiffness_abs_N_per_m=_list(_NUMBER),
        stiffness_real_N_per_m=_list(_NUMBER),
    )
    crossing = _table(
        axes=_TEXT,
        critical_speed={"type": "integer"},
        speed_rad_per_s=_NUMBER,
        stiffness_N_per_m=_NUMBER,
    )
    undamped = _table(
        support_stiffness_N_per_m=_list(_NUMBER),
        forward_rad_per_s={
            **_list(_list(_NUMBER)),
            "description": "a row per critical speed, over the stiffness",
        },
        on_rigid_supports_rad_per_s=_list(_NUMBER),
        supports=_list(support),
        crossings=_list(crossing),
    )
    branch = _table(frequency_rad_per_s=_NUMBER, log_decrement=_list(_NUMBER))
    by_axis = {"type": "object", "additionalProperties": _list(_NUMBER)}
    control = _table(
        states={"type": "integer"},
        sample_time_s=_MAYBE,
        frequencies_rad_per_s=_list(_NUMBER),
        gain_A_per_m={**by_axis, "description": "of each axis alone, delay and hold included"},
        phase_deg=by_axis,
    )
    sensor = _table(
        bearing=_TEXT,
        position_m=_NUMBER,
        angle_rad=_NUMBER,
        weight=_NUMBER,
        bandwidth_rad_per_s=_MAYBE,
    )
    whole = _table(
        schema={"const": SCHEMA},
        machine=_TEXT,
        controller=_TEXT,
        timing=_TEXT,
        operating_point=_TEXT,
        passed={"type": "boolean"},
        speeds_rad_per_s=_table(lowest=_SIZE, highest=_POSITIVE, trip=_POSITIVE),
        mean_gas_density_kg_per_m3=_MAYBE,
        scale_factor=_table(capped=_NUMBER, uncapped=_ANY_NUMBER),
        items=_list(item),
        modes_up_to_rad_per_s=_POSITIVE,
        modes=_list(mode),
        clearances=_list(clearance),
        phase_budget=_list(budget),
        capacity=_list(capacity),
        notes=_list(_TEXT),
        signal_chain=_table(
            sensors=_list(sensor),
            amplifier={"type": "object", "description": "as in the machine file, SI"},
            controller=control,
        ),
        critical_speed_map=undamped,
        level_one=_table(
            anticipated_N_per_m=_MAYBE,
            border_N_per_m={
                **_ANY_NUMBER,
                "description": "text, > and the end of the sweep, where none was met up to there",
            },
            log_decrement_at_anticipated=_MAYBE,
            critical_speed_ratio=_MAYBE,
            level_two_asked_for={
                "type": ["array", "null"],
                "items": _TEXT,
                "description": "reasons; null: no anticipated cross-coupling",
            },
            cross_coupling_N_per_m=_list(_NUMBER),
            modes=_list(branch),
        ),
        unbalance=_list(_table(case=_TEXT, why=_TEXT, weights=_list(weight))),
        critical_speeds=_list(
            _table(
                **peak,
                margin_percent=_NUMBER,
                required_percent=_NUMBER,
                reading=_TEXT,
                case=_TEXT,
            )
        ),
        response=_table(speeds_rad_per_s=_list(_POSITIVE), curves=_list(curve)),
    )
    # what an unstable loop, a rotor without Level I or one without a controller does not have
    missing = {"level_one", "unbalance", "critical_speeds", "response", "signal_chain"}
    whole["required"] = [key for key in whole["required"] if key not in missing]
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"lateral analysis of ambrose, schema {SCHEMA}",
    }
    return head | whole


def _table(**properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list(entry: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": entry}


if __name__ == "__main__":
    from ambrose.machine.ordinary_file import write_text

    write_text(Path(sys.argv[1]), json.dumps(lateral_schema(), indent=1) + "\n", "JSON schema")


NEAR = 0.25  # of the speed: a partner further away is none
_SAME_PEAK = 0.03  # peaks of two placements nearer to each other than this are one
_FAR = 1e6  # cost of a pair that must not be: above any sum of costs of pairs that may
_BYTES = 20_000_000  # of a file, at most; assumed
_AGAIN = "run ambrose lateral --data again"
UM = 1e6  # um per m


@dataclass(frozen=True, slots=True)
class Pair:
    """One quantity of both sides, in ``unit``; ours None: nothing of ours is near.

    where: the row it belongs to, in words. note: what a reader needs to know beside it.
    """

    where: str
    quantity: str
    theirs: float
    ours: float | None
    unit: str
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Ours less theirs, in ``unit``."""
        return None if self.ours is None else self.ours - self.theirs

    @property
    def percent(self) -> float | None:
        """Ours less theirs, of theirs [%]; None without a partner and where theirs is 0."""
        if self.difference is None or not self.theirs:
            return None
        return 100 * self.difference / abs(self.theirs)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        row = {name: getattr(self, name) for name in self.__slots__}
        return row | {"difference": self.difference, "difference_percent": self.percent}


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(Presented):
    """Two sets of results side by side.

    machine: whose they are; theirs_name: what the other side is called. pairs: row by row.
    within [%]: the largest difference that is accepted (None: no verdict). responses: measured ones
    beside ours; agreement: up to which frequency they agree, in words.
    """

    _FACTS: ClassVar = ("machine", "theirs=theirs_name", "pairs", "largest_percent", "passed")

    machine: str
    theirs_name: str
    pairs: tuple[Pair, ...]
    within: float | None = None
    responses: tuple[ResponseFit, ...] = ()
    agreement: str = ""

    @property
    def unpaired(self) -> tuple[Pair, ...]:
        """Rows of theirs to which nothing of ours is near."""
        return tuple(pair for pair in self.pairs if pair.ours is None)

    @property
    def compared(self) -> bool:
        """Whether any row has a partner, or responses lie side by side."""
        return len(self.unpaired) < len(self.pairs) or bool(self.responses)

    @property
    def largest_percent(self) -> float | None:
        """The largest difference [%] of all pairs; None where there is none in per cent."""
        shares = (abs(p.percent) for p in self.pairs if p.percent is not None)
        return max(shares, default=None)

    @property
    def passed(self) -> bool | None:
        """Whether every row has a partner within ``within``; None without a ``within``, but where
        nothing was compared that failed.
        """
        if not self.compared:
            return False
        if self.within is None:
            return None
        alike = all(pair.percent is not None or pair.difference == 0 for pair in self.pairs)
        return not self.unpaired and alike and (self.largest_percent or 0.0) <= self.within

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {
            "machine": self.machine,
            "theirs": self.theirs_name,
            "within_percent": self.within,
            "passed": self.passed,
            "largest_difference_percent": self.largest_percent,
            "rows": [pair.to_dict() for pair in self.pairs],
        } | ({"agreement": self.agreement} if self.agreement else {})

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row per pair."""
        rows = [pair.to_dict() for pair in self.pairs]
        return data_frame({key: [row[key] for row in rows] for key in rows[0]} if rows else {})


@dataclass(frozen=True, slots=True)
class Theirs:
    """The other side, read: its name, its rows, and the summary's rows of an analysis of ours."""

    name: str
    rows: tuple[TheirRow, ...]
    items: tuple[Mapping[str, Any], ...] = ()


def compare(
    mine: Lateral | Mapping[str, Any] | str | Path,
    theirs: Theirs | Lateral | Mapping[str, Any] | str | Path,
    *,
    within: float | None = None,
) -> Comparison:
    """Critical speeds, amplitudes and log decrements of both sides, with the differences.

    mine: a ``Lateral``, its data, or the path of a lateral.json. theirs: the same, or the path of
    a table (*.csv) of another code or of measurements, whose columns stand in
    ``ambrose.annexes.rotordynamics.comparison``. within [%]: the largest difference accepted.
    Amplitudes are comparable where both sides have the same unbalance. Raises InvalidInput for a
    file that is neither, for unknown columns and units.
    """
    if within is not None and not (math.isfinite(within) and within > 0):
        raise invalid("within", f"{within:g} %", "above 0 %", "leave it out for no verdict")
    ours = _data(mine, "mine")
    other = theirs if isinstance(theirs, Theirs) else read_theirs(theirs)
    pairs = (*_beside_table(ours, other.rows), *_items(ours, other.items))
    return Comparison(ours["machine"], other.name, pairs, within)


def read_theirs(source: Lateral | Mapping[str, Any] | str | Path) -> Theirs:
    """The other side of a comparison, as ``compare`` takes it. Raises InvalidInput."""
    if isinstance(source, str | Path) and Path(source).suffix.lower() != ".json":
        path = Path(source)
        return Theirs(path.name, read_table(read_text(path, "table of results", _BYTES), path.name))
    other = _data(source, "theirs")
    name = f"{other['machine']}, controller {other['controller']}"
    if isinstance(source, str | Path):
        name = Path(source).name
    return Theirs(
        name,
        tuple(_as_table(other)),
        tuple(other["items"]),
    )


def _data(source: Lateral | Mapping[str, Any] | str | Path, side: str) -> Mapping[str, Any]:
    """The data of an analysis whose loop was stable."""
    name = side
    data: Any = source
    if isinstance(source, Lateral):
        data = source.to_dict()
    elif isinstance(source, str | Path):
        name = Path(source).name
        text = read_text(Path(source), "lateral analysis", _BYTES)
        try:
            data = parse_json(text, _AGAIN)
        except InvalidInput as error:
            raise InvalidInput(f"{name} {error}") from None
    if not isinstance(data, Mapping) or not {"schema", "machine", "items", "modes"} <= set(data):
        raise InvalidInput(
            f"{name} is no lateral analysis; give the lateral.json that ambrose lateral --data "
            "writes"
        )
    if data["schema"] != SCHEMA:
        raise InvalidInput(
            f"{name} has schema {data['schema']}, but this version reads {SCHEMA}; run ambrose "
            "lateral again"
        )
    if "response" not in data:
        raise InvalidInput(
            f"{name} has no unbalance response, as its loop is unstable or as an earlier version "
            "wrote it; run ambrose lateral again, with a controller that stabilises the rotor"
        )
    if not isinstance(source, Lateral):
        try:
            check_form(data, lateral_schema(), _AGAIN)
            _check_curves(data["response"])
        except InvalidInput as error:
            raise InvalidInput(f"{name}: {error}") from None
    return data


def _check_curves(response: Mapping[str, Any]) -> None:
    """Raises InvalidInput where no spline goes through a curve: its speeds do not ascend, or it has
    more or fewer values than speeds.
    """
    speeds = response["speeds_rad_per_s"]
    if len(speeds) < 2 or any(a >= b for a, b in pairwise(speeds)):
        raise InvalidInput(f"response.speeds_rad_per_s must ascend; {_AGAIN}")
    for i, curve in enumerate(response["curves"]):
        for key in ("amplitude_m_pp", "phase_lag_deg"):
            if len(curve[key]) != len(speeds):
                raise InvalidInput(
                    f"response.curves[{i}].{key} has {len(curve[key])} values for {len(speeds)} "
                    f"speeds; {_AGAIN}"
                )


# Measured frequency responses of the running loop beside those of the full model, as API 617 asks
# for them of magnetic bearings: resonance by resonance, and line by line.

_PROMINENT = 1.0  # [dB] of a resonance over what lies beside it, at least
_CLEAR = 5.0  # and deviations of its noise
_FINER = 8  # lines of ours for one of theirs


def beside_responses(
    machine: Machine, controller: LawLike, source: Response | str | Path, timing: Timing | None
) -> Comparison:
    """The responses of every axis on itself that were measured while a controller ran, beside those
    of the full model with it: frequency and height of every resonance, and how far both agree.

    Raises InvalidInput for responses of another machine or of no operating point of it.
    """
    (given,) = read_responses(source)
    plants = full_plants(machine)
    ((number, _),) = placed(plants, given, None).items()
    plant, law = plants[number], running_law(controller, plants[number], timing)
    given = usable(given, plant.axes, law.dt)
    alone = tuple(path for path in given.paths if path.read == path.injected)
    if not alone:
        raise InvalidInput(
            "no response of an axis on itself was measured; sweep every axis and record it"
        )
    own = replace(given, paths=alone)
    steps = np.arange(_FINER * len(own.omega)) / _FINER
    fine = np.unique(np.interp(steps, np.arange(len(own.omega)), own.omega))
    between = tuple(
        replace(path, values=np.interp(fine, own.omega, path.values), variance=None)
        for path in own.paths
    )
    finer = replace(own, omega=fine, paths=between)
    ours = modelled(plant, controller, own, timing)
    curves = modelled(plant, controller, finer, timing)
    pairs: list[Pair] = []
    fits: list[ResponseFit] = []
    items: list[tuple[np.ndarray, MeasuredPath, np.ndarray]] = []
    for path, values, curve in zip(own.paths, ours, curves, strict=True):
        noise = noise_beside(own.omega, path, values)
        pairs += _resonance_pairs(path, own.omega, noise, fine, np.abs(curve))
        fits.append(response_fit(own.omega, path, values, values, float(law.dt or 0.0)))
        items.append((own.omega, path, values))
    name = source.name if isinstance(source, Path) else str(getattr(source, "machine", source))
    return Comparison(machine.name, name, tuple(pairs), None, tuple(fits), str(agreement(items)))


def _resonance_pairs(
    path: MeasuredPath, omega: np.ndarray, noise: np.ndarray, fine: np.ndarray, ours: np.ndarray
) -> list[Pair]:
    """Frequency and height of every resonance that was measured, and the nearest of ours."""
    theirs = np.abs(path.values)
    # a deviation of |X| in dB: 20 / ln 10 sigma / |X|
    measured = _maxima(theirs, _PROMINENT + _CLEAR * 20 / np.log(10) * np.sqrt(noise / 2) / theirs)
    found = _maxima(ours, np.zeros(len(ours)))  # exact, so that a slight one is a partner
    rows = [TheirRow("mode", float(omega[k])) for k in measured]
    chosen = _assign(rows, [(float(fine[k]), "") for k in found])
    pairs = []
    for k, partner in zip(measured, chosen, strict=True):
        where = f"{path.name} at {omega[k] / TWO_PI:.4g} Hz"
        at = None if partner is None else found[partner]
        lone = f"no resonance of ours within {NEAR:.0%}" if at is None else ""
        at_hz, height = (None, None) if at is None else (float(fine[at] / TWO_PI), float(ours[at]))
        unit = "/".join(filter(None, QUANTITIES[path.quantity][1:]))
        pairs.append(Pair(where, "frequency", float(omega[k] / TWO_PI), at_hz, "Hz", lone))
        pairs.append(Pair(where, "height", float(theirs[k]), height, unit, lone))
    return pairs


def _maxima(size: np.ndarray, unsure: np.ndarray) -> list[int]:
    """Where values (w,) have maxima, higher than what is unsure of them (w,) [dB]."""
    from scipy.signal import find_peaks

    places, facts = find_peaks(20 * np.log10(np.maximum(size, 1e-300)), prominence=0)
    return [
        int(k) for k, high in zip(places, facts["prominences"], strict=True) if high > unsure[k]
    ]


# ----------------------------------------------------------------------------- pairs


def _beside_table(ours: Mapping[str, Any], table: Sequence[TheirRow]) -> list[Pair]:
    """Row by row of the table: critical speeds, then modes, then amplitudes."""
    pairs: list[Pair] = []
    trip = float(ours["speeds_rad_per_s"]["trip"])
    counted = [row for row in table if row.kind == "critical"]
    groups: dict[tuple[str, str], list[TheirRow]] = {}
    for row in counted:
        groups.setdefault((row.probe, row.case), []).append(row)
    for (probe, case), rows in groups.items():
        peaks = _peaks(ours, probe, case)
        at = _at(peaks)
        for row, k in zip(rows, _assign(rows, at), strict=True):
            peak = None if k is None else peaks[k]
            said = "" if peak is not None else _nobody(row, "critical speed", at, trip)
            pairs += _critical_pairs(row, peak, said)
    rows = [row for row in table if row.kind == "mode"]
    modes = [(m["frequency_rad_per_s"], _whirl(m["whirl"])) for m in ours["modes"]]
    top = float(ours.get("modes_up_to_rad_per_s", MODES_TO * trip))
    for row, k in zip(rows, _assign(rows, modes), strict=True):
        mode = None if k is None else ours["modes"][k]
        pairs += _mode_pairs(
            row, mode, "" if mode is not None else _nobody(row, "mode", modes, top)
        )
    splines: dict[tuple[str, str], Any] = {}
    pairs += [_amplitude_pair(ours, row, splines) for row in table if row.kind == "response"]
    return pairs


def _at(peaks: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """(speed [rad/s], no whirl) of our critical speeds."""
    return [(float(peak["speed_rad_per_s"]), "") for peak in peaks]


def _whirl(value: float) -> str:
    if abs(value) <= BACKWARD:
        return "planar"
    return "forward" if value > 0 else "backward"


def _assign(rows: Sequence[TheirRow], ours: Sequence[tuple[float, str]]) -> list[int | None]:
    """For each row the index of its partner of ours (speed, whirl), or None.

    Least sum of |ln(theirs/ours)| over all pairs (Kuhn's assignment). A pair that is too far away,
    or that whirls the other way, costs more than any sum of near ones.
    """
    from scipy.optimize import linear_sum_assignment

    chosen: list[int | None] = [None] * len(rows)
    if not rows or not ours:
        return chosen
    speeds = np.array([speed for speed, _ in ours])
    whirls = np.array([{"forward": 1, "backward": -1}.get(whirl, 0) for _, whirl in ours])
    theirs = np.array([{"forward": 1, "backward": -1}.get(row.whirl, 0) for row in rows])
    with np.errstate(divide="ignore"):  # a mode of 0 rad/s is nobody's partner
        apart = np.abs(np.log(np.array([row.speed for row in rows]))[:, None] - np.log(speeds))
    other = theirs[:, None] * whirls < 0
    cost = np.where((apart <= math.log1p(NEAR)) & ~other, apart, _FAR)
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if cost[i, j] < _FAR:
            chosen[i] = int(j)
    return chosen


def _peaks(ours: Mapping[str, Any], probe: str, case: str) -> list[Mapping[str, Any]]:
    """Our critical speeds: of a probe where one is named (the largest of all placements, or those
    of one), else each where its margin is least.
    """
    if not probe and not case:
        return list(ours["critical_speeds"])
    found: list[Mapping[str, Any]] = []
    for curve in _curves(ours, probe, case):
        for peak in curve["peaks"]:
            same = next((k for k, other in enumerate(found) if _same(peak, other)), None)
            if same is None:
                found.append(peak)
            elif peak["amplitude_m_pp"] > found[same]["amplitude_m_pp"]:
                found[same] = peak
    return found


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    speeds = one["speed_rad_per_s"], other["speed_rad_per_s"]
    return bool(abs(speeds[0] - speeds[1]) <= _SAME_PEAK * max(speeds))


def _curves(ours: Mapping[str, Any], probe: str, case: str) -> list[Mapping[str, Any]]:
    """Our response curves of a probe and a placement, "" for all. Raises InvalidInput."""
    curves = ours["response"]["curves"]
    for key, word in (("reading", probe), ("case", case)):
        names = sorted({curve[key] for curve in curves})
        if word and word not in names:
            called = "probe" if key == "reading" else "case"
            raise InvalidInput(
                f'the {called} "{word}" of the table is not in the analysis; it has '
                f"{', '.join(shown(name) for name in names)}"
            )
        curves = [curve for curve in curves if not word or curve[key] == word]
    return list(curves)


def _critical_pairs(row: TheirRow, peak: Mapping[str, Any] | None, note: str) -> list[Pair]:
    where = row.label or _worded(row, "critical speed")
    found = [Pair(where, "speed", row.speed / RPM, _in_rpm(peak, "speed_rad_per_s"), "rpm", note)]
    if peak is None:
        return found
    if row.amplitude is not None:
        ours = UM * peak["amplitude_m_pp"]
        found.append(Pair(where, "amplitude", UM * row.amplitude, ours, "um p-p"))
    if row.amplification is not None:
        factor = peak["amplification_factor"]
        known = None if isinstance(factor, str) else float(factor)
        said = "" if known is not None else "ours has no half power inside the curve"
        found.append(Pair(where, "amplification factor", row.amplification, known, "-", said))
    return found


def _mode_pairs(row: TheirRow, mode: Mapping[str, Any] | None, note: str) -> list[Pair]:
    where = row.label or _worded(row, "mode")
    speed = Pair(
        where, "frequency", row.speed / RPM, _in_rpm(mode, "frequency_rad_per_s"), "rpm", note
    )
    if mode is None or row.log_decrement is None:
        return [speed]
    return [speed, Pair(where, "log decrement", row.log_decrement, mode["log_decrement"], "-")]


def _amplitude_pair(
    ours: Mapping[str, Any], row: TheirRow, splines: dict[tuple[str, str], Any]
) -> Pair:
    """The largest of our curves at that speed. splines: those of a probe and a case, kept."""
    from scipy.interpolate import CubicSpline

    where = row.label or _worded(row, "response")
    speeds = ours["response"]["speeds_rad_per_s"]
    theirs = UM * float(row.amplitude or 0.0)
    if not speeds[0] <= row.speed <= speeds[-1]:
        note = f"our curves run from {rpm(speeds[0])} to {rpm(speeds[-1])} rpm"
        return Pair(where, "amplitude", theirs, None, "um p-p", note)
    key = row.probe, row.case
    if key not in splines:
        curves = np.array([curve["amplitude_m_pp"] for curve in _curves(ours, *key)])
        splines[key] = CubicSpline(np.asarray(speeds), curves, axis=1)
    return Pair(where, "amplitude", theirs, UM * float(splines[key](row.speed).max()), "um p-p")


def _worded(row: TheirRow, what: str) -> str:
    more = [row.whirl] if row.whirl else []
    more += [
        f'{word} "{name}"' for word, name in (("probe", row.probe), ("case", row.case)) if name
    ]
    return ", ".join([f"{what} at {rpm(row.speed)} rpm", *more])


def _nobody(row: TheirRow, what: str, ours: Sequence[tuple[float, str]], top: float) -> str:
    """Why a row has no partner: the nearest of ours (speed [rad/s], whirl), and how far ours are
    listed, to the speed ``top`` [rad/s].
    """
    listed = f"; ours are listed up to {rpm(top)} rpm" if row.speed > top else ""
    if not ours:
        return f"ours has no {what}{listed}"

    def rank(entry: tuple[float, str]) -> tuple[bool, bool, float]:
        apart = abs(math.log(row.speed / entry[0])) if entry[0] > 0 else math.inf
        other = {row.whirl, entry[1]} == {"forward", "backward"}
        return apart > math.log1p(NEAR), other, apart

    best = min(ours, key=rank)
    far, other, _ = rank(best)
    nearest = f"{rpm(best[0])} rpm" + (f" ({best[1]})" if best[1] and row.whirl else "")
    if far:
        return f"no {what} of ours within {100 * NEAR:g} %, the nearest at {nearest}{listed}"
    reason = "whirls the other way" if other else "is another row's"
    return f"the nearest {what} of ours, at {nearest}, {reason}{listed}"


def _in_rpm(row: Mapping[str, Any] | None, key: str) -> float | None:
    return None if row is None else float(row[key]) / RPM


# ------------------------------------------------------- an earlier analysis as theirs


def _as_table(other: Mapping[str, Any]) -> list[TheirRow]:
    """Critical speeds and modes of an analysis as rows of a table."""
    rows = [
        TheirRow(
            "critical",
            peak["speed_rad_per_s"],
            peak["amplitude_m_pp"],
            None if isinstance(peak["amplification_factor"], str) else peak["amplification_factor"],
        )
        for peak in other["critical_speeds"]
    ]
    rows += [
        TheirRow(
            "mode",
            mode["frequency_rad_per_s"],
            log_decrement=mode["log_decrement"],
            whirl=_whirl(mode["whirl"]),
        )
        for mode in other["modes"]
    ]
    return rows


def _items(ours: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[Pair]:
    """Rows of the summary that both have with a value; critical speeds are paired by speed."""
    mine = {item["name"]: item for item in ours["items"]}
    pairs = []
    for item in items:
        partner = mine.get(item["name"])
        numbers = isinstance(item["value"], int | float)
        if partner is None or not numbers or item["name"].startswith("critical_speed."):
            continue
        value = partner["value"]
        if isinstance(value, int | float) and item["unit"] == partner["unit"]:
            pairs.append(Pair(item["title"], "value", item["value"], value, item["unit"]))
    return pairs
