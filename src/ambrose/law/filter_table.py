"""Controllers of others: filters per channel, transfer-function or state-space matrices, from CSV,
JSON and MAT-files.

Whatever the file, it becomes one table of plain data (docs/controller-table.schema.json), and that
a controller. A channel is an axis, or "A_zeta -> B_zeta" from the error of one to the current of
another. Coefficients stand by falling powers of s [rad/s], or with a sample rate of z; ``b`` and
``a`` then by rising powers of z^-1, as a difference equation has them. A digital table stays as it
is: a sampled controller, not an analog one that resembles it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.statespace import StateSpace, balance_system, poles, spectral_abscissa
from ambrose.law.loop import match_axes
from ambrose.law.pid import chain, modes, section_matrix
from ambrose.machine.file.stations import named_table
from ambrose.machine.machine import AXIS, Machine
from ambrose.machine.ordinary_file import DELAY_SAMPLES, SAMPLE_TIME, STATES
from ambrose.machine.part import Section, modal_channels
from ambrose.machine.units import DIMENSIONS, in_si, quoted
from ambrose.machine.validation.controller import section_problems

SOS = ("b0", "b1", "b2", "a0", "a1", "a2")
ZPK = ("zeros", "poles", "gain")
ON_CIRCLE = 1.001  # modulus of a pole of z that coefficients of few digits leave on the unit circle
DEFAULT_AXES = "default_axes"  # stated for a table that names none
FACTS = (
    "rate_hz",
    "delay_samples",
    "input",
    "input_unit",
    "output_unit",
    "feedback",
    "axes",
)  # what a table, or its reader, says of all of it
_FILTERS: Mapping[str, tuple[str, ...]] = {
    "sos": ("sos", "gain"),
    "b": ("b", "a", "gain"),
    "num": ("num", "den", "gain"),
    "zeros": ZPK,
}
_FORMS = {"channels": ("channels",), "A": ("A", "B", "C", "D", "outputs"), **_FILTERS}
_OTHER_NAMES = {
    "z": "zeros",
    "p": "poles",
    "k": "gain",
    "g": "gain",
    "Ts": "sample_time",
    "dt": "sample_time",
    "fs": "rate_hz",
    "inputs": "axes",
}
_BEARINGS = 20  # whose bend_18_y is more than a machine has
_SIGN = {"error": 1.0, "displacement": -1.0}
_FEEDBACK = ("subtracted", "added")  # a1 u[k-1] + a2 u[k-2], in the sum that gives u[k]
_HEADER = (
    f'"channel", then {", ".join(SOS)} or b, a or {", ".join(ZPK)}, and "rate_hz" where it is '
    "digital"
)
_CSV_WORDS = ("channel", "label", "input", "input_unit", "output_unit", "feedback")
# columns of a CSV table, all by their own names
_CSV: Mapping[str, tuple[str, ...]] = dict.fromkeys(
    ("channel", *SOS, "b", "a", "num", "den", *ZPK, *FACTS[:-1], "label"), ()
)
# from the error of an axis to currents: Theta = [[D, C], [B, A]]
_Channel = tuple[str, tuple[str, ...], np.ndarray]


def csv_table(text: str) -> dict[str, Any]:
    """A row for each section: channel, coefficients or zeros, poles and gain; facts have columns.
    Raises InvalidInput.
    """
    try:
        table = named_table(text, _CSV, _CSV_WORDS, required=(), example=_HEADER, exact=True)
    except InvalidInput as error:
        raise InvalidInput(f"{error}; its first line must name the columns {_HEADER}") from None
    columns = {column.kind for column in table.columns}
    kinds = (SOS, ("b", "a"), ("num", "den"), ZPK)
    kind = max(kinds, key=lambda names: len(columns & {*names}) / len(names))
    if missing := [name for name in ("channel", *kind) if name not in {*columns, "a0"}]:
        raise InvalidInput(
            f"it lacks {', '.join(missing)}; its first line must name the columns {_HEADER}"
        )
    facts, channels = dict[str, set[str]](), dict[str, list[Any]]()
    for number, row in table.rows:
        cells = {
            column.kind: cell.replace(",", ".") if table.mark == "," else cell
            for column, cell in row.items()
        }
        if kind is SOS and "a0" not in columns:  # as signal processors have them: a0 = 1
            cells["a0"] = "1"
        for key in FACTS[:-1]:
            facts.setdefault(key, set()).add(cells.get(key, ""))
        form = next(
            (names for names in kinds if all(cells.get(key) for key in names)),
            ZPK if "zeros" in columns else kind,
        )
        item: dict[str, Any] = {"where": f"line {number}"}
        if form is SOS:
            item["sos"] = [[cells.get(key, "") for key in SOS]]
        else:
            item |= {
                key: cells.get(key, "").replace(",", " ").split() for key in form if key != "gain"
            }
        if form is ZPK or cells.get("gain"):
            item["gain"] = cells.get("gain", "")
        channels.setdefault(cells.get("channel", ""), []).append(item)
    for key, values in facts.items():
        if len(values) > 1:
            raise InvalidInput(
                f"{key} is {' and '.join(sorted(map(quoted, values)))}; give all sections one {key}"
            )
    return {"channels": channels, **{key: value for key, (value,) in facts.items() if value}}


def mat_table(variables: Mapping[str, Any]) -> dict[str, Any]:
    """The variables of a MAT-file, or the fields of its only struct that is a controller; several
    structs are channels.

    What else a file holds is left out. Raises InvalidInput where it has no controller.
    """
    if not is_table(variables):
        structs = {
            name: one for name, one in variables.items() if isinstance(one, dict) and is_table(one)
        }
        if not structs:
            remedy = (
                "save b and a, sos, zeros, poles and gain, or A, B, C, D with Ts, as plain "
                "variables or fields of a struct"
            )
            raise InvalidInput(
                f"it has no controller ({', '.join(variables) or 'nothing'}); {remedy}"
            )
        inner = (
            next(iter(structs.values()))
            if len(structs) == 1
            else {"channels": {key: _own(one) for key, one in structs.items()}}
        )
        variables = {**variables, **inner}
    return _own(variables)


@np.errstate(over="ignore", invalid="ignore")  # numbers that overflow are refused as not finite
def controller_of(table: Mapping[str, Any], **stated: Any) -> tuple[StateSpace, int | None]:
    """The controller of a table, from errors r - y [m] to currents [A], and the computing delay
    [samples] that is said of it.

    stated: ``FACTS`` that the table leaves open (None: not stated), ``DEFAULT_AXES``. Raises
    InvalidInput, also where the two contradict.
    """
    facts = _facts(_named(table), stated)
    system = _system(table, facts, stated)
    if "feedback" not in facts:
        _check_poles(system, table, facts, stated)
    return system, facts.get("delay_samples")


def _check_poles(
    system: StateSpace,
    table: Mapping[str, Any],
    facts: Mapping[str, Any],
    stated: Mapping[str, Any],
) -> None:
    """Refuses coefficients whose rate, or whose sign of a1 and a2, is plainly another. Raises
    InvalidInput.

    Poles z = exp(s T) of a controller lie in the unit circle. Read as s [rad/s] they would be
    slower than a turn in six seconds, or unstable.
    """

    def radius(of: StateSpace) -> float:
        return float(np.abs(poles(of)).max(initial=0.0))

    own, turned = radius(system), math.inf
    if own > ON_CIRCLE:
        turned = radius(_system(table, {**facts, "feedback": "added"}, stated))
    if not system.n_states or (own > ON_CIRCLE and turned > ON_CIRCLE):
        return
    if system.dt is not None and turned <= ON_CIRCLE:
        raise InvalidInput(
            f"its sections are unstable (a pole of z at modulus {own:.4g}), and stable with a1 and "
            "a2 of the other sign, as CMSIS-DSP and SigmaDSP write them; say so with a column "
            "feedback, added in every row (--feedback added of ambrose convert controller), or "
            "turn the signs"
        )
    growing = own <= ON_CIRCLE or spectral_abscissa(system) > 0
    if system.dt is None and growing and "sample_time" not in _named(table):
        raise InvalidInput(
            "it states no sample rate, and its poles are those of z; give it in a column rate_hz, "
            "or with --rate-hz of ambrose convert controller (sample_time 0: they are of s)"
        )


def _system(
    table: Mapping[str, Any], facts: Mapping[str, Any], stated: Mapping[str, Any]
) -> StateSpace:
    """The controller of a table with these facts. Raises InvalidInput."""
    table = _named(other_feedback(table) if facts.get("feedback") == "added" else table)
    dt = None if facts.get("rate_hz") is None else 1 / facts["rate_hz"]
    form = next((key for key in _FORMS if key in table), None)
    known = {*FACTS, "sample_time", *_FORMS.get(form or "", ())}
    for key in table:
        if form is None or key not in known:
            holds = (
                "channels, or sos, or b and a, or zeros, poles and gain, or A, B, C and D"
                if form is None
                else form
            )
            raise InvalidInput(
                f"unknown key {quoted(key)}; a table of filters has {holds}, and "
                f"{', '.join(sorted(FACTS))}"
            )
    axes = facts.get("axes") or (None if form == "channels" else stated.get(DEFAULT_AXES))
    if form is None or (form == "channels" and not table["channels"]):
        raise InvalidInput("a channel has no name; name the axes, such as A_zeta")
    if form == "A":
        (A, B, C, D), outputs = _matrices(table), table.get("outputs")
        axes = _axes(axes, D.shape[1])
        system = StateSpace(
            A,
            B,
            C,
            D,
            _signals("err", axes),
            _signals("u", axes if outputs is None else _texts(outputs)),
            dt,
        )
    else:
        if form == "channels":
            entries = list(_channels(table["channels"], dt))
        elif form in ("b", "num") and _depth(table[form]) > 2:
            entries = list(_transfer_matrix(table, form, axes, dt))
        else:
            if axes is None:
                raise InvalidInput(
                    "it is one filter for every axis, and their names are not known; name them "
                    "(--axes, --machine)"
                )
            entries = list(
                _channels(
                    {
                        axis: {key: table[key] for key in _FORMS[form] if key in table}
                        for axis in axes
                    },
                    dt,
                )
            )
        ends = [source for source, *_ in entries] + [
            target for _, targets, _ in entries for target in targets
        ]
        names = tuple(dict.fromkeys(ends)) if form == "channels" else tuple(axes or ())
        system = _assembled(entries, names, names if axes is None else _axes(axes, len(names)), dt)

    # sign and units of the table, on B and D alone
    factor = _SIGN[facts.get("input", "error")] * facts["output_unit"] / facts["input_unit"]
    return StateSpace(
        system.A, system.B * factor, system.C, system.D * factor, system.inputs, system.outputs, dt
    )


def named_for(machine: Machine, system: StateSpace) -> StateSpace:
    """The controller with the machine's axes in their order; one whose channels are translate_x,
    tilt_y ... (machine/part.py) with the rotor's coordinates around it. Raises InvalidInput
    where its channels are others.
    """
    own = [name.removeprefix("err_") for name in system.inputs]
    modal = modal_channels(len(machine.bearings)) if machine.bearings else ()
    if is_modal(system) and set(own) <= set(modal):
        return _between_modes(machine, system, own, modal)
    if sorted(own) != sorted(machine.axes):
        raise invalid(
            "the axes of the controller",
            ", ".join(own),
            f"those of {machine.name}, {', '.join(machine.axes)}"
            + (f", or {', '.join(modal)}" if modal else ""),
            "rename its channels, or name them in their order with --axes of ambrose convert "
            "controller",
        )
    return match_axes(system, machine.axes, machine.name)


def is_modal(system: StateSpace) -> bool:
    """Whether all channels are the rotor's coordinates: translate_x, tilt_y, bend_1_x ..."""
    known = modal_channels(_BEARINGS)
    return all(name.removeprefix("err_") in known for name in system.inputs)


def check_channels(system: StateSpace) -> None:
    """Refuses names that no machine's axes have: those come in pairs, A_zeta and A_eta, or one by
    itself along the shaft. Raises InvalidInput.
    """
    names = [name.removeprefix("err_") for name in system.inputs]
    pairs = [f"{name.rpartition('_')[0]}_{way}" for name in names for way in ("zeta", "eta")]
    if is_modal(system) or sorted(names) == sorted({*pairs}):
        return
    if len(names) != 1 or not names[0].endswith(AXIS):
        raise invalid(
            "the list of its channels",
            ", ".join(names),
            "pairs as A_zeta, A_eta, B_zeta, B_eta, or translate_x, translate_y, tilt_x, tilt_y",
            "name them in their order (--axes, or --machine)",
        )


def _between_modes(
    machine: Machine, system: StateSpace, own: Sequence[str], modal: Sequence[str]
) -> StateSpace:
    """Behind measured displacements to channels, before channels to currents; a channel that it
    lacks is not controlled. Raises InvalidInput.
    """
    given = [name.removeprefix("u_") for name in system.outputs]
    if sorted(given) != sorted(own):
        raise invalid(
            "the outputs of the controller",
            ", ".join(given),
            f"those of its inputs, {', '.join(own)}",
            "name both alike",
        )

    # u = out K into err, the rows and columns of the channels that it has
    into, out = modes(machine)
    into = into[[modal.index(name) for name in own]]
    out = out[:, [modal.index(name) for name in given]]
    return StateSpace(
        system.A,
        system.B @ into,
        out @ system.C,
        out @ system.D @ into,
        [f"err_{axis}" for axis in machine.axes],
        [f"u_{axis}" for axis in machine.axes],
        system.dt,
    )


def other_feedback(table: Any, key: str = "") -> Any:
    """The table with a1 and a2 of its sections of the other sign, as libraries for signal
    processors write them: y = b0 x + ... + a1 y[k-1] + a2 y[k-2].
    """
    if isinstance(table, Mapping):
        return {name: other_feedback(value, name) for name, value in table.items()}
    if key == "sos" and _depth(table) == 1:
        return [*table[:4], *(-_real(key, value) for value in table[4:])]
    if key in ("a", "den") and _depth(table) == 1:
        return [*table[:1], *(-_real(key, value) for value in table[1:])]
    return [other_feedback(value, key) for value in table] if isinstance(table, list) else table


def is_table(content: Mapping[str, Any]) -> bool:
    """Whether parsed JSON is such a table, or tries to be."""
    return bool({*_FORMS} & {*_named(content)})


def _named(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with the keys that this module knows, where it has another name for them."""
    return {_OTHER_NAMES.get(key, key): value for key, value in table.items()}


def _own(table: Mapping[str, Any]) -> dict[str, Any]:
    """What belongs to the form of a table, and facts; nothing else."""
    table = _named(table)
    form = next(key for key in _FORMS if key in table)
    return {key: table[key] for key in (*_FORMS[form], *FACTS, "sample_time") if key in table}


def _facts(table: Mapping[str, Any], stated: Mapping[str, Any]) -> dict[str, Any]:
    """What holds for the whole controller, in SI: said by the table or stated. Raises
    InvalidInput.
    """
    in_table = {key: table.get(key) for key in FACTS}
    step = table.get("sample_time")
    # 0: what MATLAB calls continuous
    if step is not None and (seconds := _scalar("the sample time", step)) != 0:
        if not seconds >= SAMPLE_TIME:
            remedy = "give it in seconds, or 0 where the controller is continuous"
            raise invalid(
                "the sample time", f"{seconds:g} s", f"at least {SAMPLE_TIME:g} s", remedy
            )
        in_table["rate_hz"] = 1 / seconds
    facts: dict[str, Any] = {"input_unit": 1.0, "output_unit": 1.0}
    for key in FACTS:
        own, given = (
            None if value is None else _fact(key, value)
            for value in (in_table[key], stated.get(key))
        )
        if key != "axes" and own is not None and given is not None and own != given:
            raise InvalidInput(
                f"{key} is {in_table[key]} in the file, and {stated[key]} was stated; leave out "
                "the wrong one"
            )
        if (value := own if given is None else given) is not None:
            facts[key] = value
    return facts


def _fact(key: str, value: Any) -> Any:
    if key == "axes":
        return _texts(value)
    if key == "input":
        if not isinstance(value, str) or value not in _SIGN:
            raise invalid(
                "input",
                quoted(value),
                "error (r - y) or displacement (y)",
                "state the controller's input",
            )
        return value
    if key == "feedback":
        if value not in _FEEDBACK:
            raise invalid(
                "feedback",
                quoted(value),
                " or ".join(_FEEDBACK),
                "say how a1 and a2 enter the sum that gives the output",
            )
        return value
    if key in ("input_unit", "output_unit"):
        dimension = DIMENSIONS["length" if key == "input_unit" else "current"]
        try:
            return in_si(1.0, str(value), dimension)
        except ValueError as error:
            raise InvalidInput(f"{key} {error}") from error
    number = _scalar(key, value)
    if key == "delay_samples":
        if not (0 <= number <= DELAY_SAMPLES and number.is_integer()):
            raise invalid(
                key, f"{number:g}", f"a whole number from 0 to {DELAY_SAMPLES}", "1 is usual"
            )
        return int(number)
    if not 0 < number <= 1 / SAMPLE_TIME:
        raise InvalidInput(
            f"rate_hz is {number:g}, but must be above 0 and at most {1 / SAMPLE_TIME:g} Hz; "
            "leave it out for s"
        )
    return number


def _texts(value: Any) -> tuple[str, ...]:
    """Names of axes: a list, or text with commas."""
    names = value.split(",") if isinstance(value, str) else _flat(value)
    return tuple(str(name).strip().removeprefix("err_").removeprefix("u_") for name in names)


def _axes(axes: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if axes is None:
        raise InvalidInput(
            f"its {count} channels have no names; name their axes in this order (--axes, or "
            "--machine)"
        )
    if len(axes) != count:
        raise invalid(
            "the number of axes",
            f"{len(axes)} ({', '.join(axes)})",
            f"{count}, one per channel",
            "name them all, once",
        )
    return tuple(axes)


def _signals(kind: str, axes: Sequence[str]) -> list[str]:
    return [f"{kind}_{axis}" for axis in axes]


def _channels(channels: Any, dt: float | None) -> Iterator[_Channel]:
    """The channels of a table; the filters of one are in series. Raises InvalidInput."""
    if not isinstance(channels, dict):
        raise InvalidInput("channels is not a table; write the axes' names as its keys")
    for name, items in channels.items():
        source, arrow, target = (part.strip() for part in str(name).partition("->"))
        if not source or (arrow and not target):
            raise InvalidInput(
                "a channel has no name; name the axes, such as A_zeta, or A_zeta -> B_zeta"
            )
        where = f"channel {quoted(name)}"
        parts = [
            part
            for item in (items if isinstance(items, list) else [items])
            for part in _filter(where, item, dt)
        ]
        yield source, (target or source,), chain(1.0, parts)


def _filter(where: str, item: Any, dt: float | None) -> list[np.ndarray]:
    """Theta of every section of a filter (law/pid.py). Raises InvalidInput."""
    item = _named(item) if isinstance(item, dict) else {}
    where = item.pop("where", where)
    form = next((key for key in _FILTERS if key in item), "zeros")
    if not {*_FILTERS[form]} - {"gain"} <= {*item} <= {*_FILTERS[form]}:
        forms = f"sos (and gain), with b and a (and gain), or with {', '.join(ZPK)}"
        raise InvalidInput(f"{where} must be a table with {forms}; write one of the two")
    gain = _scalar(f"{where}: gain", item.get("gain", 1.0))
    if form in ("b", "num"):
        coefficients = [_flat(item[key]) for key in _FILTERS[form][:2]]
        return [
            gain * np.eye(1),
            _rational(where, coefficients[:1], coefficients[1], form == "num" or dt is None),
        ]
    sections = _zpk(where, item, gain) if form == "zeros" else item["sos"]
    parts = [section_matrix(section) for section in _sections(where, sections)]
    return parts if form == "zeros" else [gain * np.eye(1), *parts]


def _transfer_matrix(
    table: Mapping[str, Any], form: str, axes: Sequence[str] | None, dt: float | None
) -> Iterator[_Channel]:
    """b[i][j] and a[i][j] from input j to output i; what shares input and denominator shares
    states. Raises InvalidInput.
    """
    above, below = (_cells(key, table[key]) for key in _FILTERS[form][:2])
    if above.shape != below.shape or above.shape[0] != above.shape[1]:
        size = f"{above.shape} and {below.shape}"
        raise invalid(
            "the sizes of numerators and denominators",
            size,
            "square and the same",
            "give a list per output and input",
        )
    axes = _axes(axes, len(above))
    for j, source in enumerate(axes):
        shared = dict[tuple[float, ...], list[int]]()
        for i in range(len(axes)):
            if any(_number(form, value) for value in above[i, j]):
                shared.setdefault(tuple(_real(form, value) for value in below[i, j]), []).append(i)
        for denominator, rows in shared.items():
            where = f"the filter {source} -> {axes[rows[0]]}"
            theta = _rational(
                where, [above[i, j] for i in rows], list(denominator), form == "num" or dt is None
            )
            yield source, tuple(axes[i] for i in rows), theta


def _cells(name: str, values: Any) -> np.ndarray:
    """A matrix of lists of coefficients."""
    rows = [[_flat(cell) for cell in _listed(name, row)] for row in _listed(name, values)]
    if len({len(row) for row in rows}) != 1:
        raise InvalidInput(
            f"the rows of {name} have different lengths; give a list of coefficients per output "
            "and input"
        )
    cells = np.empty((len(rows), len(rows[0])), object)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            cells[i, j] = cell
    return cells


def _rational(where: str, numerators: Sequence[Any], denominator: Any, falling: bool) -> np.ndarray:
    """Theta from one input through one denominator; falling: powers of s or z, otherwise rising
    ones of z^-1.
    """
    rows = [
        np.array([_real(where, value) for value in _listed(where, row)])
        for row in (denominator, *numerators)
    ]

    # filled with zeros to one length: falling powers in front, rising ones of z^-1 behind
    size = max(map(len, rows))
    a, *above = (
        np.pad(row, (size - len(row), 0) if falling else (0, size - len(row))) for row in rows
    )

    # improper in s or z, or a0 = 0 in powers of z^-1: cannot run
    first = int(np.flatnonzero(a)[0]) if a.any() else size
    if first == size or any(b[:first].any() for b in above) or (first and not falling):
        remedy = (
            "give a denominator whose degree is not below the numerator's"
            if falling
            else "divide by a factor z^-1"
        )
        raise InvalidInput(
            f"{where}: the denominator begins with 0 (or has none but zeros), which cannot run; "
            f"{remedy}"
        )

    # b0 + (b - b0 a)/a in controllable form:   x1' = -a1 x1 - ... - an xn + u, x_i' = x_(i-1)
    b, a = np.array(above)[:, first:] / a[first], a[first:] / a[first]
    n = len(a) - 1
    A = np.eye(n, k=-1)
    B = np.eye(n, 1)
    C = b[:, 1:] - b[:, :1] * a[1:]
    A[:1] = -a[1:]
    if n:
        A, B, C, _ = balance_system(A, B, C)
    return np.block([[b[:, :1], C], [B, A]])


def _matrices(table: Mapping[str, Any]) -> list[np.ndarray]:
    """A (n, n), B (n, m), C (p, n), D (p, m); D may be left out. Raises InvalidInput."""
    # jsonencode of MATLAB writes a scalar as 5, a row and a column alike as [1, 0]: of one state B
    # is a row and C a column, of more the other way round; D is what B and C leave open
    one_state = len(_flat(table.get("A", []))) == 1
    B = _matrix("B", table.get("B", []), as_row=one_state)
    C = _matrix("C", table.get("C", []), as_row=not one_state)
    A = _matrix("A", table.get("A", []), as_row=True)
    D = _matrix("D", table.get("D", []), as_row=len(C) == 1)
    p, m = (max(D.shape[0], C.shape[0]), max(D.shape[1], B.shape[1]))
    n = len(A)
    if "D" not in table:
        D = np.zeros((p, m))
    fitting = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    for key, matrix in zip("ABCD", (A, B, C, D), strict=True):
        if matrix.size != np.prod(fitting[key]) or (matrix.size and matrix.shape != fitting[key]):
            raise invalid(
                f"the size of {key}",
                matrix.shape,
                str(fitting[key]),
                "the four must fit each other, row by row",
            )
    if n > STATES:
        raise InvalidInput(f"it has {n} states, but at most {STATES} are allowed; reduce its order")
    return [matrix.reshape(fitting[key]) for key, matrix in zip("ABCD", (A, B, C, D), strict=True)]


def _matrix(key: str, values: Any, *, as_row: bool) -> np.ndarray:
    """Rows of numbers; a single list is a row or a column. Raises InvalidInput."""
    if _depth(values) < 2 and values != []:
        flat = _flat(values)
        values = [flat] if as_row else [[value] for value in flat]
    rows = [_listed(key, row) for row in _listed(key, values)]
    if len({len(row) for row in rows}) > 1:
        raise InvalidInput(f"the rows of {key} have different lengths; give the matrix row by row")
    numbers = [[_real(key, value) for value in row] for row in rows]
    return np.array(numbers, dtype=float).reshape(len(rows), -1 if rows and rows[0] else 0)


def _assembled(
    entries: Sequence[_Channel], names: Sequence[str], axes: Sequence[str], dt: float | None
) -> StateSpace:
    """The channels side by side, on all the axes that ``names`` are."""
    states = sum(len(theta) - len(targets) for _, targets, theta in entries)
    if states > STATES:
        raise InvalidInput(
            f"its filters have {states} states, but at most {STATES} are allowed; leave sections "
            "out"
        )

    # rows (u, x'), columns (err, x); what goes to one current from several errors adds up
    m, start = len(names), len(names)
    whole = np.zeros((m + states, m + states))
    for source, targets, theta in entries:
        t, j = len(targets), names.index(source)
        inner = range(start, start + len(theta) - t)
        rows = [names.index(target) for target in targets]
        whole[np.ix_(rows, [j, *inner])] += theta[:t]
        whole[np.ix_(inner, [j, *inner])] = theta[t:]
        start += len(inner)

    parts = whole[m:, m:], whole[m:, :m], whole[:m, m:], whole[:m, :m]
    return StateSpace(*parts, _signals("err", axes), _signals("u", axes), dt)


def _zpk(where: str, item: Mapping[str, Any], gain: float) -> list[list[float]]:
    """Zeros, poles and gain as rows of six coefficients."""
    zeros, poles = (
        np.array([_number(where, v) for v in _flat(item[key])]) for key in ("zeros", "poles")
    )
    if len(zeros) > len(poles):
        raise InvalidInput(
            f"{where}: there are {len(zeros)} zeros and {len(poles)} poles, which cannot run; add "
            "poles"
        )
    above, below = _pairs(where, zeros), _pairs(where, poles) or [np.ones(1)]
    # of as many roots as the poles' pair, or fewer
    above += [np.ones(1)] * (len(below) - len(above))
    above[0] = gain * above[0]
    # each filled in front to b0, b1, b2, a0, a1, a2
    return [
        [*[0.0] * (3 - len(b)), *b, *[0.0] * (3 - len(a)), *a]
        for b, a in zip(above, below, strict=True)
    ]


def _sections(where: str, rows: Any) -> Iterator[Section]:
    """Sections of six coefficients each, one of them also by itself. Raises InvalidInput."""
    rows = _listed(where, rows)
    for row in rows if _depth(rows) > 1 or not rows else [rows]:
        numbers = [_real(where, value) for value in _listed(where, row)]
        if len(numbers) != len(SOS):
            raise InvalidInput(
                f"{where}: a section has {len(numbers)} numbers, but must have six; give "
                f"{', '.join(SOS)}"
            )
        section = Section("sos", numerator=tuple(numbers[:3]), denominator=tuple(numbers[3:]))
        for problem in section_problems(where, section):
            raise InvalidInput(problem)
        yield section


def _pairs(where: str, roots: np.ndarray) -> list[np.ndarray]:
    """Real polynomials of two roots, of growing size, and one of a single root where their number
    is odd.
    """
    upper, real = roots[roots.imag > 0], np.sort(roots[roots.imag == 0].real)
    lower = roots[roots.imag < 0]
    if len(upper) != len(lower) or not np.allclose(
        np.sort_complex(upper), np.sort_complex(lower.conj()), rtol=1e-6, atol=0
    ):
        raise InvalidInput(
            f"{where}: a complex zero or pole lacks its conjugate; give both of every pair"
        )

    # real roots in their order by twos; one that is left over stays alone
    single = [np.array([1.0, -root]) for root in real[len(real) // 2 * 2 :]]
    couples = [np.array([1.0, -2 * root.real, abs(root) ** 2]) for root in upper]
    couples += [np.poly(real[i : i + 2]) for i in range(0, len(real) - 1, 2)]
    return [*sorted(couples, key=lambda c: abs(float(c[2]))), *single]


def _depth(values: Any) -> int:
    return (
        1 + _depth(values[0])
        if isinstance(values, list) and values
        else int(isinstance(values, list))
    )


def _flat(values: Any) -> list[Any]:
    """A vector: a list, a matrix of one row or column, or a single number; pairs [re, im] of
    complex numbers stay.
    """
    if not isinstance(values, list):
        return [values]
    if len(values) == 1 and isinstance(values[0], list):
        return list(values[0])
    return [value[0] if isinstance(value, list) and len(value) == 1 else value for value in values]


def _listed(where: str, values: Any) -> Sequence[Any]:
    if not isinstance(values, list):
        raise InvalidInput(
            f"{where}: {quoted(values)} is not a list; write coefficients, zeros, poles and "
            "rows in "
            "brackets"
        )
    return values


def _scalar(where: str, value: Any) -> float:
    while isinstance(value, list) and len(value) == 1:
        value = value[0]
    return _real(where, value)


def _real(where: str, value: Any) -> float:
    number = _number(where, value)
    if number.imag:
        raise InvalidInput(
            f"{where}: {quoted(value)} is complex, but a coefficient is real; write both roots of "
            "a pair into one"
        )
    return number.real


def _number(where: str, value: Any) -> complex:
    """A number, real or complex: 3.5, "-20+5j" or [-20, 5]."""
    try:
        pair = isinstance(value, list) and len(value) == 2
        number = (
            complex(*map(float, value))
            if pair
            else complex(value.replace("i", "j") if isinstance(value, str) else value)
        )
    except (TypeError, ValueError, OverflowError):
        number = complex(np.nan)
    if isinstance(value, bool) or not np.isfinite(number):
        raise InvalidInput(
            f"{where}: {quoted(value)} is not a finite number; write it as 3.5, or a complex "
            "one as "
            '"-20+5j"'
        )
    return number
