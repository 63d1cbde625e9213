"""Filter tables of others as a controller: per channel second-order sections, or zeros, poles and a gain, in CSV or JSON.

Coefficients stand by falling powers, of s [rad/s] or with a rate of z, which are those of rising powers of z^-1. Displacements
are in m, currents in A. A digital table stays as it is: a sampled controller, not an analog one that resembles it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.machine.controller import Section
from ambrose.machine.limits import SAMPLE_TIME, STATES
from ambrose.machine.messages import quoted
from ambrose.machine.validation.controller import section_problems
from ambrose.synthesis.filters import bank, chain, section_matrix
from ambrose.synthesis.pid import theta_system

SOS = ("b0", "b1", "b2", "a0", "a1", "a2")
ZPK = ("zeros", "poles", "gain")
_HEADER = f'"channel", then {", ".join(SOS)} or {", ".join(ZPK)}, and "rate_hz" where it is digital'


def controller_of_csv(text: str) -> StateSpace:
    """A row for each section: channel (an axis), coefficients or zeros, poles and gain, rate_hz. Raises InvalidInput."""
    try:
        rows = list(csv.DictReader(io.StringIO(text), skipinitialspace=True, restkey="", restval=""))
    except csv.Error as error:
        raise InvalidInput(f"it is no table in CSV ({error}); its first line must name the columns {_HEADER}") from None
    columns = {str(name).strip() for name in (rows[0] if rows else {})}
    kind = max((SOS, ZPK), key=lambda names: len(columns & {*names}) / len(names))
    if missing := [name for name in ("channel", *kind) if name not in columns]:
        lacks = f"it lacks {', '.join(missing)}" if columns & {"channel", *SOS, *ZPK} else "it is no table of filters"
        raise InvalidInput(f"{lacks}; its first line must name the columns {_HEADER}")
    rates, chains = set[str](), dict[str, list[Section]]()
    for number, row in enumerate(rows, 2):
        cells = {str(key).strip(): value.strip() for key, value in row.items() if isinstance(value, str)}
        where = f"line {number}"
        rates.add(cells.get("rate_hz", ""))
        sos = all(cells.get(key) for key in SOS)
        values: Any = [cells[key] for key in SOS] if sos else {key: cells.get(key, "") for key in ZPK}
        if not sos:
            values |= {key: values[key].replace(",", " ").split() for key in ("zeros", "poles")}
        chains.setdefault(cells["channel"], []).extend(_sections(where, [values] if sos else values))
    if len(rates) > 1:
        raise InvalidInput(f"rate_hz is {' and '.join(sorted(map(quoted, rates)))}; give all sections one rate")
    return _controller({name: (1.0, sections) for name, sections in chains.items()}, next(iter(rates)) or None)


def controller_of_json(content: Mapping[str, Any]) -> StateSpace:
    """{"rate_hz": ..., "channels": {"A_zeta": {"sos": [[b0, b1, b2, a0, a1, a2], ...], "gain": 1}}}, or of a channel "zeros",
    "poles" and "gain". Raises InvalidInput.
    """
    for key in content:
        if key not in {"rate_hz", "channels"}:
            raise InvalidInput(f"unknown key {quoted(key)}; a table of filters has rate_hz and channels")
    channels, chains = content["channels"], {}
    if not isinstance(channels, dict):
        raise InvalidInput("channels is no table; write the axes' names as its keys")
    for name, item in channels.items():
        where = f"channel {quoted(name)}"
        known = ("sos", "gain") if isinstance(item, dict) and "sos" in item else ZPK
        if not isinstance(item, dict) or not {*item} <= {*known} or not {*known} - {"gain"} <= {*item}:
            raise InvalidInput(f"{where} must be a table with sos (and gain), or with {', '.join(ZPK)}; write one of the two")
        sos = "sos" in item
        gain = _number(where, item.get("gain", 1.0)).real if sos else 1.0
        chains[name] = (gain, _sections(where, item["sos"] if sos else item))
    return _controller(chains, content.get("rate_hz"))


def _sections(where: str, values: Any) -> list[Section]:
    """The sections of rows of six coefficients, or of a table of zeros, poles and gain."""
    if isinstance(values, Mapping):
        zeros, poles = (np.array([_number(where, v) for v in _listed(where, values[key])]) for key in ("zeros", "poles"))
        gain = _number(where, values.get("gain", 1.0)).real
        if len(zeros) > len(poles):
            raise InvalidInput(f"{where}: there are {len(zeros)} zeros and {len(poles)} poles, which cannot run; add poles")
        above, below = _pairs(where, zeros), _pairs(where, poles) or [np.ones(1)]
        above += [np.ones(1)] * (len(below) - len(above))  # of as many roots as the poles' pair, or fewer
        above[0] = gain * above[0]
        values = [[*[0.0] * (3 - len(b)), *b, *[0.0] * (3 - len(a)), *a] for b, a in zip(above, below, strict=True)]
    found = []
    for row in _listed(where, values):
        numbers = [_number(where, value).real for value in _listed(where, row)]
        if len(numbers) != len(SOS):
            raise InvalidInput(f"{where}: a section has {len(numbers)} numbers, but must have six; give {', '.join(SOS)}")
        section = Section("sos", numerator=tuple(numbers[:3]), denominator=tuple(numbers[3:]))
        for problem in section_problems(where, section):
            raise InvalidInput(problem)
        found.append(section)
    return found


def _pairs(where: str, roots: np.ndarray) -> list[np.ndarray]:
    """Real polynomials of two roots, of growing size, and one of a single root where their number is odd."""
    upper, real = roots[roots.imag > 0], np.sort(roots[roots.imag == 0].real)
    lower = roots[roots.imag < 0]
    if len(upper) != len(lower) or not np.allclose(np.sort_complex(upper), np.sort_complex(lower.conj()), rtol=1e-6, atol=0):
        raise InvalidInput(f"{where}: a complex zero or pole lacks its conjugate; give both of every pair")
    single = [np.array([1.0, -root]) for root in real[len(real) // 2 * 2 :]]
    couples = [np.array([1.0, -2 * root.real, abs(root) ** 2]) for root in upper]
    couples += [np.poly(real[i : i + 2]) for i in range(0, len(real) - 1, 2)]
    return [*sorted(couples, key=lambda c: abs(float(c[2]))), *single]


def _listed(where: str, values: Any) -> Sequence[Any]:
    if not isinstance(values, list):
        raise InvalidInput(f"{where}: {quoted(values)} is no list; write zeros, poles and sections in brackets")
    return values


def _number(where: str, value: Any) -> complex:
    """A number, real or complex: 3.5, "-20+5j" or [-20, 5]."""
    try:
        pair = isinstance(value, list) and len(value) == 2
        number = complex(*map(float, value)) if pair else complex(value.replace("i", "j") if isinstance(value, str) else value)
    except (TypeError, ValueError, OverflowError):
        number = complex(np.nan)
    if isinstance(value, bool) or not np.isfinite(number):
        raise InvalidInput(f'{where}: {quoted(value)} is no finite number; write it as 3.5, or a complex one as "-20+5j"')
    return number


def _controller(chains: Mapping[str, tuple[float, list[Section]]], rate: Any) -> StateSpace:
    if "" in chains or not chains:
        raise InvalidInput("a channel has no name; name the axes, such as A_zeta")
    states = sum(2 - (not item.denominator[0]) for _, sections in chains.values() for item in sections if item.denominator)
    if states > STATES:
        raise InvalidInput(f"its filters have {states} states, but at most {STATES} are allowed; leave sections out")
    parts = [chain(gain, [section_matrix(item) for item in sections]) for gain, sections in chains.values()]
    dt = None
    if rate is not None:
        hertz = _number("rate_hz", rate).real
        if not 0 < hertz <= 1 / SAMPLE_TIME:
            raise InvalidInput(
                f"rate_hz is {hertz:g}, but must be above 0 and at most {1 / SAMPLE_TIME:g} Hz; leave it out for s"
            )
        dt = 1 / hertz
    one = np.eye(len(parts))
    return theta_system(bank(parts, one, one), tuple(chains), dt)
