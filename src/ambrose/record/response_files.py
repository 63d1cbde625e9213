"""Files of frequency responses: CSV that names its columns, own HDF5, and through a column map what
analysers write (text tables, universal files of function type 4, MATLAB).

A CSV names every column by path and part, and the machine and its operating point in lines above:

# machine: seal-rig
# speed_rad_s: 0
# seal_pressure_pa: 0
frequency [Hz],S A_zeta gain [dB],S A_zeta phase [deg],T A_eta/A_zeta real,T A_eta/A_zeta imag

JSON says the same as HDF5: machine, operating point, frequency [rad/s], and paths, each with
quantity, read, injected, at, real, imag and, where it is known, variance.

A map names columns of another program's file: machine, [point] and [frequency] as for records, and
a [[path]] for every quotient, with quantity, read, and source (complex), gain and phase, or real
and imag.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path as File
from typing import Annotated, Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.core.presentation import json_text
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import read_table, read_toml
from ambrose.machine.kinds import Choice, Name, Quantity, Words
from ambrose.machine.ordinary_file import NUMBERS, SIGNALS, check_source, draft_of, parse_json
from ambrose.machine.part import Part
from ambrose.machine.units import DIMENSIONS, in_si, quoted
from ambrose.options import either
from ambrose.record.apart import read_variables, variables_of
from ambrose.record.foreign import Column
from ambrose.record.hdf5_file import DAMAGE, fixed, is_checked, opened, own_member
from ambrose.record.record import POINT_KEYS
from ambrose.record.response import CURRENT, QUANTITIES, SENSOR, Path, Response, unit_factor
from ambrose.record.text_uff import ABSCISSA, Variable, refuse_encoding, refuse_separators

FORMAT = "ambrose responses"
_PLAIN = {".csv", ".txt", ".dat", ".asc", ".uff", ".unv"}  # that no library reads
_TABLE = "point,response,input,output,"  # how the table of `ambrose frf --csv NAME.csv` begins
_PATH_KEYS = ("quantity", "read", "injected", "at")
_CYCLE = 2 * np.pi  # [rad]
_TURNS = 8  # by which no phase turns within a sweep: then it is in degrees
_PARTS = ("gain", "phase", "real", "imag", "coherence", "deviation")
_COLUMN = re.compile(
    r"(?P<quantity>S|T|L|G|K|motion) (?P<read>[^\s/]+)(?:/(?P<injected>\S+))?"
    rf"(?: (?P<at>{CURRENT}))? (?P<part>{'|'.join(_PARTS)})"
)


@dataclass(frozen=True, slots=True, repr=False)
class PathColumns(Part):
    """The columns of one path; source: complex numbers, else gain and phase, or real and imag.

    sign: -1 for a loop with the minus of the feedback in it, or a channel that is turned over.
    coherence with averages, or deviation (of the value, one standard deviation), say how certain.
    """

    quantity: Annotated[str, Choice(tuple(QUANTITIES)), "what was measured"]
    read: Annotated[Name, "axis that was read"]
    injected: Annotated[Words, "axis of the injection; default: the one that was read"] = ""
    at: Annotated[str, Choice((SENSOR, CURRENT)), "where it was injected"] = SENSOR
    source: Annotated[Words, "column or dataset of complex numbers"] = ""
    gain: Annotated[Words, "column of the magnitude"] = ""
    gain_unit: Annotated[
        str,
        Choice(("", "abs", "dB")),
        "of the magnitude; dB is 20 log10; default: the header's, or abs",
    ] = ""
    phase: Annotated[Words, "column of the phase, a lag negative"] = ""
    phase_unit: Annotated[
        str, Choice(("", "deg", "rad")), "of the phase; default: the header's, or deg"
    ] = ""
    real: Annotated[Words, "column of the real part"] = ""
    imag: Annotated[Words, "column of the imaginary part"] = ""
    unit: Annotated[Words, "output over input, such as um/A"] = ""
    sign: Annotated[float, Quantity("plain number"), "factor of the values, such as -1"] = 1.0
    coherence: Annotated[Words, "column of the coherence"] = ""
    averages: Annotated[float, Quantity("plain number"), "how many, with coherence"] = 0.0
    deviation: Annotated[Words, "column of the standard deviation, as gain"] = ""

    def __post_init__(self) -> None:
        ways = [bool(self.source), bool(self.gain and self.phase), bool(self.real and self.imag)]
        name = f"{self.quantity} {self.read}"
        if sum(ways) != 1 or bool(self.gain) != bool(self.phase):
            raise InvalidInput(
                f"{name} needs source, or gain and phase, or real and imag; name exactly one of "
                "the three"
            )
        if self.coherence and not 1 <= self.averages < math.inf:
            raise InvalidInput(
                f"{name} has coherence, which cannot be used without the number of averages; add "
                "averages, or leave coherence out"
            )
        unit_factor(self.quantity, self.unit)


@dataclass(frozen=True, slots=True, repr=False)
class ResponseMap(Part):
    """What a file of another program does not say of its responses. Raises InvalidInput."""

    machine: Annotated[Name, "name of the machine"]
    point: Annotated[OperatingPoint, "where the machine ran"]
    paths: Annotated[tuple[PathColumns, ...], "the quotients"] = field(metadata={"key": "path"})
    frequency: Annotated[Column | None, "the column of frequencies, in Hz or rad/s or rpm"] = None
    date: Annotated[Words, "day of the measurement, ISO"] = ""
    sample_rate_hz: Annotated[float | None, Quantity("plain number"), "of the controller [Hz]"] = (
        None
    )


def read_map(document: Mapping[str, Any], name: str = "column map") -> ResponseMap:
    """The map in a parsed TOML document. Raises InvalidInput naming table and key."""
    from ambrose.machine.file.tables import keys_of, make_table

    model = make_table("ResponseMap", ResponseMap.__doc__ or "", keys_of(ResponseMap), ResponseMap)
    if isinstance(document.get("frequency"), Mapping):
        document = {**document, "frequency": {"name": "frequency", **document["frequency"]}}
    point = document.get("point")
    missing = [
        k for k in ("speed", "seal_pressure") if not isinstance(point, dict) or k not in point
    ]
    if missing:
        raise InvalidInput(
            f"{name}: [point]: {' and '.join(missing)} is missing; the operating point must be "
            "known, add it"
        )
    try:
        return ResponseMap(**read_table(model, document, name).given())
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error


def maps_responses(columns: str | File) -> bool:
    """Whether a column map is one of responses: whether it has a [[path]]. Raises InvalidInput."""
    return "path" in read_toml(columns, "column map")


def holds_responses(path: str | File) -> bool:
    """Whether a file is one of frequency responses that needs no map; False where it cannot be
    read.
    """
    path = File(path)
    try:
        # a pipe would never end, nor would what the system makes up as it is read
        if not path.is_file() or not path.stat().st_size:
            return False
        if path.suffix.lower() in {".h5", ".hdf5"}:
            if not is_checked(path):
                return False
            with opened(path) as file:
                return "frequency" in file
        if path.suffix.lower() == ".json":
            with path.open(encoding="utf-8") as text:
                return FORMAT in text.read(1000)
        if path.suffix.lower() != ".csv":
            return False
        with path.open(encoding="utf-8-sig") as lines:
            head = next((x for x in lines if x.strip() and x[0] != "#"), "")[:1000]
        return head.strip().lower().startswith(("freq", _TABLE))  # the table to be named
    except (InvalidInput, *DAMAGE):
        return False


def read_response(
    path: str | File | Response,
    columns: ResponseMap | Mapping[str, Any] | str | File | None = None,
) -> Response:
    """The responses in a file; a Response is as it is. columns: a map, its document or its TOML
    file; None for CSV that names its columns, own HDF5 and JSON. Raises InvalidInput with the
    file's name and what is wrong.
    """
    if isinstance(path, Response):
        return path
    path = check_path(path, "responses")
    try:
        if columns is None and path.suffix.lower() in {".h5", ".hdf5"}:
            check_source(path, "responses")
            return _read_hdf5(path)
        if columns is None and path.suffix.lower() == ".json":
            return _read_json(check_source(path, "responses"))
        if columns is None:
            columns = _own_map(path)
        elif isinstance(columns, str | File):
            columns = read_map(read_toml(columns, "column map"), f"column map {columns}")
        elif not isinstance(columns, ResponseMap):
            columns = read_map(columns)
        return _mapped(path, columns)
    except InvalidInput as error:
        words = str(error)
        raise InvalidInput(words if words.startswith(f"{path}") else f"{path}: {words}") from error
    except DAMAGE as error:
        raise InvalidInput(
            f"{path}: it cannot be read ({error}); it is damaged, truncated or of another kind"
        ) from error


def write_response(response: Response, path: str | File) -> File:
    """Write the responses as HDF5 (.h5), CSV or JSON, atomically. Raises InvalidInput."""
    path = check_path(path, "responses")
    writers = {".h5": _write_hdf5, ".hdf5": _write_hdf5, ".csv": _write_csv, ".json": _write_json}
    if path.suffix.lower() not in writers:
        raise invalid(
            f"the suffix of {path.name}", repr(path.suffix), either(list(writers)), "choose one"
        )
    with draft_of(path, "responses") as draft:
        writers[path.suffix.lower()](response, draft)
    return path


def _own_map(path: File) -> ResponseMap:
    """The map that a CSV's own header makes. Raises InvalidInput."""
    check_source(path, "responses")
    with path.open("rb") as raw:
        refuse_encoding(raw.read(4096))
    said: dict[str, str] = {}
    head = ""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for line in lines:
            if not line.startswith("#") and line.strip():
                head = line
                break
            key, _, value = line[1:].partition(":")
            said[key.strip()] = value.strip()
    if head.startswith(_TABLE):
        raise InvalidInput(
            "it is the table of ambrose frf, for people; write the responses with --csv NAME.h5, "
            "which every command takes"
        )
    refuse_separators(head)
    remedy = "add lines such as '# speed_rad_s: 0' above the header, or give a column map"
    for key in ("machine", "speed_rad_s", "seal_pressure_pa"):
        if not said.get(key):
            raise InvalidInput(f"it does not state {key}; {remedy} (ambrose convert --columns)")
    point, rate, averages = _stated(said)
    cells = [
        re.fullmatch(r"\s*\"?([^\[\"]*?)\s*(?:\[([^\]]*)\])?\"?\s*", c) for c in head.split(",")
    ]
    names = [("", "") if cell is None else (cell[1], cell[2] or "") for cell in cells]
    by_path: dict[tuple[str, ...], dict[str, Any]] = {}
    for name, unit in names[1:]:
        match = _COLUMN.fullmatch(name)
        if match is None:
            raise InvalidInput(
                f"the column {quoted(name)} does not state its quantity; write it as "
                "'S A_zeta gain [dB]' (quantity S, T, L, G, K or motion; axis read, /axis injected;"
                f" {', '.join(_PARTS)}), or give a column map (ambrose convert --columns)"
            )
        quantity, read, injected, at, part = match.groups()
        known = by_path.setdefault(
            (quantity, read, injected or read, at or SENSOR), {"averages": averages}
        )
        if part in known:
            raise InvalidInput(f"the column {quoted(name)} is there twice; leave one out")
        known[part] = name
        if part in {"gain", "phase"} and unit in {"dB", "deg", "rad", "abs", "°"}:
            known[f"{part}_unit"] = unit.replace("°", "deg")
        elif part == "phase":
            raise InvalidInput(f"{name} states no angle as its unit; write [deg] or [rad]")
        elif part == "gain" and not unit:
            raise InvalidInput(f"{name} states no unit; write [abs] or [dB], or such as [um/A]")
        elif part != "coherence" and unit and known.setdefault("unit", unit) != unit:
            raise _two_units(name, [known["unit"], unit])
    paths = [
        PathColumns(quantity=q, read=i, injected=j, at=at, **columns)
        for (q, i, j, at), columns in by_path.items()
    ]
    column = Column(name="frequency", source=names[0][0], unit=names[0][1])
    return ResponseMap(said["machine"], point, tuple(paths), column, said.get("date", ""), rate)


def _stated(said: Mapping[str, Any]) -> tuple[OperatingPoint, float | None, float]:
    """Operating point, sample rate [Hz] and number of averages, as a file's texts have them. Raises
    InvalidInput.
    """
    texts = {name: said[key] for key, name in POINT_KEYS.items() if key in said}
    label = str(texts.pop("label", ""))
    stated = said.get("sample_rate_hz")
    try:
        point = OperatingPoint(**{name: float(text) for name, text in texts.items()}, label=label)
        rate = None if stated is None else float(stated)
        return point, rate, float(said.get("averages", 0))
    except InvalidInput:
        raise
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"its operating point or rate is no number, or missing ({error}); write speed_rad_s, "
            "seal_pressure_pa and sample_rate_hz"
        ) from None


def _two_units(name: str, units: Sequence[str]) -> InvalidInput:
    return InvalidInput(
        f"the columns of {name} state two units, {' and '.join(units)}; export them in one, or "
        "state their unit in a column map"
    )


def _mapped(path: File, columns: ResponseMap) -> Response:
    """The responses in a file of another program, read through a map. Raises InvalidInput."""
    wanted = []
    for item in columns.paths:
        parts = (item.source, item.gain, item.phase, item.real, item.imag)
        wanted += [name for name in (*parts, item.coherence, item.deviation) if name]
    frequency = columns.frequency
    if frequency is None:
        sources = [item.source for item in columns.paths]
        if not all(sources):
            raise InvalidInput("no column of frequencies is named; add [frequency] to the map")
        frequency = Column("frequency", ABSCISSA + sources[0], "Hz")
        wanted += [ABSCISSA + source for source in sources]
    if not 0 < len(wanted) <= SIGNALS:
        raise invalid("the number of columns", len(wanted), f"1 to {SIGNALS}", "name others")
    names = list(dict.fromkeys([frequency.source, *wanted]))
    if path.suffix.lower() in _PLAIN:
        data = dict(zip(names, read_variables(path, names), strict=True))
    else:  # others in a process apart, whose numbers are gone after the block
        with variables_of(path, names) as variables:
            copies = [replace(variable, values=np.array(variable.values)) for variable in variables]
        data = dict(zip(names, copies, strict=True))
    sizes = {name: len(variable.values) for name, variable in data.items()}
    if len(set(sizes.values())) > 1:
        raise invalid(
            "the numbers of lines", sizes, "the same for all columns", "export one sweep at a time"
        )
    axis = data[frequency.source].values.real
    for name in names:
        if name.startswith(ABSCISSA) and not np.allclose(data[name].values.real, axis, rtol=1e-6):
            raise InvalidInput(
                "the datasets are over different frequencies; read each as separate responses"
            )
    with np.errstate(over="ignore", invalid="ignore"):  # refused as what is not finite
        omega = _rates(frequency, data[frequency.source])
        paths = tuple(_path(item, data, omega) for item in columns.paths)
    return Response(
        columns.machine, omega, paths, columns.point, columns.date, columns.sample_rate_hz
    )


def _rates(column: Column, variable: Variable) -> np.ndarray:
    """The frequencies (w,) [rad/s] of a column in any unit of angular rate. Raises InvalidInput."""
    unit = column.unit or variable.unit
    try:
        if not unit:
            raise ValueError('has no unit; write "Hz", "rad/s" or "rpm"')
        values = column.scale * variable.values.real + column.offset
        return np.asarray(in_si(values, unit, DIMENSIONS["angular rate"]))
    except ValueError as error:
        raise InvalidInput(f"the column of frequencies {error}") from None


def _path(item: PathColumns, data: Mapping[str, Variable], omega: np.ndarray) -> Path:
    """One path, SI, from the columns that ``item`` names in ``data``; omega (w,) [rad/s]. Raises
    InvalidInput.
    """
    injected = item.injected or item.read
    empty = Path(item.quantity, item.read, injected, np.ones(1, complex), None, item.at)
    # what the columns themselves state, where the map does not
    columns = (item.source, item.gain, item.real, item.imag, item.deviation)
    units = dict.fromkeys(data[column].unit for column in columns if column)
    stated = [unit for unit in units if unit not in {"", "dB", "abs", "-"}]
    if not item.unit and len(stated) > 1:
        raise _two_units(empty.name, stated)
    # what the map says, against a header that may be wrong; else the header
    header = {column: data[column].unit for column in (item.gain, item.phase) if column}
    of_gain = item.gain_unit or ("dB" if header.get(item.gain) == "dB" else "abs")
    of_phase = item.phase_unit or ("rad" if header.get(item.phase) == "rad" else "deg")
    item = replace(item, gain_unit=of_gain, phase_unit=of_phase)
    unit = item.unit or next(iter(stated), "")
    name, factor = empty.name, item.sign * unit_factor(item.quantity, unit)

    def real(source: str) -> np.ndarray:
        values = data[source].values
        if np.iscomplexobj(values):
            raise InvalidInput(f"{source} has complex numbers; name it as source of {name}")
        return values.astype(float)

    if item.source:
        values = data[item.source].values.astype(complex)
        if not np.iscomplexobj(data[item.source].values):
            raise InvalidInput(
                f"{item.source} has real numbers only; state the columns of gain and phase of "
                f"{name}, or real "
                "and imag"
            )
    elif item.gain:
        gain, phase = real(item.gain), real(item.phase)
        _plausible(item, name, gain, phase, omega)
        size = 10 ** (gain / 20) if item.gain_unit == "dB" else gain
        values = size * np.exp(1j * (np.radians(phase) if item.phase_unit == "deg" else phase))
    else:
        values = real(item.real) + 1j * real(item.imag)
    values = factor * values
    variance = None
    if item.deviation:
        variance = (factor * real(item.deviation)) ** 2
    elif item.coherence:
        coherence = real(item.coherence)
        if not ((coherence > 0) & (coherence <= 1)).all():
            raise InvalidInput(f"a coherence of {name} is not within 0 and 1; correct the column")
        # E|error|^2/|G|^2 = (1 - c)/(n c); Bendat & Piersol (2010), table 9.1. A stepped sine's
        # is 1, which says nothing
        share = (1 - coherence) / (item.averages * coherence)
        variance = None if (share <= 0).any() else share * np.abs(values) ** 2
    return replace(empty, values=values, variance=variance)


def _plausible(
    item: PathColumns, name: str, gain: np.ndarray, phase: np.ndarray, omega: np.ndarray
) -> None:
    """Refuses numbers that cannot be of the unit that is stated."""
    if item.gain_unit == "abs" and (gain < 0).any():
        at = omega[int(np.argmax(gain < 0))] / _CYCLE
        raise InvalidInput(
            f"the gain of {name} is negative at {at:g} Hz, so it is in dB, not absolute; state dB"
        )
    if item.gain_unit == "dB" and np.abs(gain).max() > 400:
        raise InvalidInput(f"the gain of {name} goes to {np.abs(gain).max():g} dB; state abs")
    # what noise alone makes may turn often; unwrapped, it moves by half a turn at most
    turns = np.ptp(phase) > _TURNS * _CYCLE and item.injected in {"", item.read}
    if item.phase_unit == "rad" and turns:
        raise InvalidInput(
            f"the phase of {name} covers {np.ptp(phase):.4g} rad, so it is in degrees; state deg"
        )


def _write_csv(response: Response, path: File) -> None:
    names, columns = ["frequency [Hz]"], [response.omega / _CYCLE]
    for item in response.paths:
        over, under = QUANTITIES[item.quantity][1:]
        unit = f" [{over}/{under}]" if over else ""
        names += [f"{item.name} real{unit}", f"{item.name} imag{unit}"]
        columns += [item.values.real, item.values.imag]
        if item.variance is not None:
            names.append(f"{item.name} deviation{unit}")
            columns.append(np.sqrt(item.variance))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in response.attributes.items())
        file.write(",".join(names) + "\n")
        np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")


def _write_hdf5(response: Response, path: File) -> None:
    import h5py

    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        attributes = {"format": FORMAT, **response.attributes}
        file.attrs.update({key: fixed(value) for key, value in attributes.items() if value != ""})
        file.create_dataset("frequency", data=response.omega, fletcher32=True, chunks=True)
        for number, item in enumerate(response.paths):
            parts = [item.values.real, item.values.imag]
            parts += [] if item.variance is None else [item.variance]
            data = file.create_dataset(
                f"path_{number}", data=np.array(parts), fletcher32=True, chunks=True
            )
            for key in _PATH_KEYS:
                data.attrs[key] = fixed(getattr(item, key))


def _read_hdf5(path: File) -> Response:
    def text(value: Any) -> str:
        return value.decode() if isinstance(value, bytes) else str(value)

    with opened(path) as file:
        # one that this package wrote has checksums on its structure
        ours = is_checked(path) and text(file.attrs.get("format", "")) == FORMAT
        if not ours or "frequency" not in file:
            raise InvalidInput(
                f"it is not a file of responses (format {FORMAT!r}); give a column map (ambrose "
                "convert --columns)"
            )
        said = {key: text(file.attrs[key]) for key in file.attrs}
        omega = own_member(file, "frequency", "/frequency")
        paths = []
        for number in range(min(len(file) - 1, SIGNALS)):
            data = own_member(file, f"path_{number}", f"/path_{number}")
            if data.ndim != 2 or data.shape[0] not in (2, 3) or data.size > NUMBERS:
                raise invalid(
                    f"the size of /path_{number}", data.shape, "(2 or 3, lines)", "write it again"
                )
            rows, keys = data[:], {key: text(data.attrs[key]) for key in data.attrs}
            variance = rows[2] if len(rows) == 3 else None
            paths.append(Path(values=rows[0] + 1j * rows[1], variance=variance, **keys))
        return _from_attributes(said, omega[:], paths)


def _from_attributes(said: Mapping[str, Any], omega: np.ndarray, paths: Sequence[Path]) -> Response:
    """What ``Response.attributes`` says, as text or numbers, and the rest."""
    point, rate, _ = _stated(said)
    name, date = str(said.get("machine", "")), str(said.get("date", ""))
    return Response(name, omega, tuple(paths), point, date, rate)


def _write_json(response: Response, path: File) -> None:
    document = {
        "format": FORMAT,
        **response.attributes,
        "frequency": response.omega.tolist(),
        "paths": [
            {
                **{key: getattr(item, key) for key in _PATH_KEYS},
                "real": item.values.real.tolist(),
                "imag": item.values.imag.tolist(),
                **({} if item.variance is None else {"variance": item.variance.tolist()}),
            }
            for item in response.paths
        ],
    }
    path.write_text(json_text(document, indent=1), encoding="utf-8")


def _read_json(path: File) -> Response:
    try:
        said = parse_json(path.read_text("utf-8"), "export it again")
        if not isinstance(said, dict) or said.get("format") != FORMAT:
            raise InvalidInput(f'it is no file of responses; state "format": {FORMAT!r}')
        paths = []
        for item in said["paths"]:
            real, imag = np.array(item["real"], float), np.array(item["imag"], float)
            variance = item.get("variance")
            keys = {key: str(item[key]) for key in _PATH_KEYS if key in item}
            paths.append(
                Path(
                    values=real + 1j * imag,
                    variance=None if variance is None else np.array(variance, float),
                    **{"injected": keys.get("read", ""), **keys},
                )
            )
        return _from_attributes(said, np.array(said["frequency"], float), paths)
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(
            f"a part of it is missing, or no list of numbers ({error}); write frequency and, for "
            "each of paths, quantity, read, real and imag"
        ) from None
