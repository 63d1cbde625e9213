"""What a file may hold at most; beyond it is refused before anything is built. Stated for users in
docs/machine-file.md and docs/records.md.

Machine: what a real machine needs with room to spare, and what all commands still do in minutes.
Records: what a computer's memory holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

TOML_BYTES = 1_000_000  # of a machine file, a column map, a scenario: a thousand tables
TOML_DEPTH = 12  # of brackets, and of dotted keys
TOML_ENTRIES = 100_000  # keys, list elements and tables together
TEXT, NAME = 10_000, 100  # characters of a text, and of a key, a name or a label
_NAMES = {"name", "label", "bearing", "material"}
# of the whole shaft: so many elements of equal length leave nine digits of the bending frequencies
ELEMENTS = 800
# bending modes per plane in the full model, at most and at least (``model.basis``)
FINE_MESH_MODES, LEAST_MODES = 64, 24
SEAL_POLES = 60  # of all seals with states together; two to four states each
DELAY_SAMPLES = 100  # of a controller, at most; a longer delay is a slip of the unit
SAMPLE_TIME = 1e-7  # [s] the least
LONGEST_SAMPLE = 1e4  # [s] of a record; a value every three hours
LARGEST_OF_A_POINT: Mapping[str, tuple[float, str]] = {
    "speed": (1e9, "rad/s"),
    "seal_pressure": (1e12, "Pa"),
    "bias_current": (1e9, "A"),
    "whirl_frequency": (1e9, "rad/s"),
}
LARGEST_TIME = 1e12  # [s] at which a record starts
LARGEST_SAMPLE = 1e15  # of any signal, in its SI unit; powers of far larger ones overflow
TABLES: Mapping[str, int] = {
    "shaft": ELEMENTS,
    "material": 100,
    "disc": 100,
    "bending_mode": 20,
    "bearing": 8,
    "sensor": 32,
    "seal": 40,
    "coupling": 20,
    "support": 8,
    "casing_mode": 20,
    "chain": 20,
    "tolerance": 60,
    "operation.point": 50,
    "operation.range": 10,
    "controller.notch": 20,
    "controller.synchronous": 16,
    "controller.channel": 16,
    "controller.channel.section": 20,
    "bearing.measured": 20,
    "sensor.runout": 20,
    "signal": 1000,
}  # and at most ENTRIES_EACH in any other list
ENTRIES_EACH = 1000

# samples times signals of one record: 1 GB, 10 minutes of 20 signals at 10 kHz
NUMBERS = 125_000_000
# numbers beyond which a file is read once to check it before memory is taken for it
CHECKED_FIRST = 40_000_000
# of one variable or channel of a MAT or TDMS file, whose readers take it several times
FOREIGN_NUMBERS = 30_000_000
PACKED = 100  # times as many bytes as its file a record may unpack to,
UNPACKED = 80_000_000  # ... or so many in any case
CHUNK_BYTES = 64_000_000  # of one chunk of an HDF5 dataset, which is unpacked as a whole
BESIDE = 50_000_000  # bytes of an HDF5 record beside its signals: attributes, other groups
SIGNALS, NOTES = 1000, 1000  # of a record


# of a controller file; one with 500 states and 4 axes: 6 MB
CONTROLLER_BYTES, CONTROLLER_NUMBERS = 64_000_000, 1_000_000
STATES, GRID_POINTS = 500, 200  # of a controller, and of its schedule
LARGEST_NUMBER = 1e150  # of a number in JSON: the square of a larger one overflows
JSON_KEYS, JSON_DEPTH = 1000, 20  # of one table, and within each other


def excess(tables: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """A complaint for everything of which the tables of a file, or a machine's parts by their keys,
    hold too much.
    """
    for key, value in tables.items():
        if len(key) > NAME:
            yield (
                f'the key "{above}{key[:20]} ..." has {len(key)} characters, but at most {NAME} '
                "are allowed; shorten it"
            )
        else:
            yield from _excess(f"{above}{key}", value)


def _excess(path: str, value: Any) -> Iterator[str]:
    if isinstance(value, str):
        # the keys of [machine.assumed] are the user's, its values are reasons
        table, _, key = path.rpartition(".")
        most = NAME if key in _NAMES and not table.startswith("machine.assumed") else TEXT
        if len(value) > most:
            yield f"{path} has {len(value)} characters, but at most {most} are allowed; shorten it"
    elif isinstance(value, (Mapping, Sequence)):
        most = TABLES.get(path, ENTRIES_EACH)
        if len(value) > most:
            what = f"entries of [[{path}]]" if path in TABLES else f"entries in {path}"
            yield (
                f"there are {len(value)} {what}, but at most {most} are allowed; leave some out or "
                "merge them"
            )
            return
        if isinstance(value, Mapping):
            yield from excess(value, f"{path}.")
            return
        for entry in value:
            yield from (
                excess(entry, f"{path}.") if isinstance(entry, Mapping) else _excess(path, entry)
            )
        elements = sum(max(_elements(section), 0) for section in value) if path == "shaft" else 0
        if elements > ELEMENTS:
            remedy = "one element per diameter of length is a good start"
            yield (
                f"the shaft has {elements} elements in all, but at most {ELEMENTS} are allowed; "
                f"{remedy}"
            )


def _elements(section: Any) -> int:
    count = (
        section.get("elements", 1)
        if isinstance(section, Mapping)
        else getattr(section, "elements", 1)
    )
    return count if type(count) is int else 1
