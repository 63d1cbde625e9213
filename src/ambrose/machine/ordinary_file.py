"""Which files are read and replaced: ordinary ones. A pipe or a device would never end, or would be
lost under a new file.
"""

import io
import json
import math
import os
import re
import shutil
import stat
import sys
import unicodedata
import uuid
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, as_several, check_path, invalid
from ambrose.core.presentation import json_text
from ambrose.machine.units import quoted

_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe (FIFO)",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a symbolic link",
}
_LONGEST_NAME = 60  # characters, of at most four bytes each: file systems take 255


def check_source(path: Any, what: str) -> Path:
    """``path``, after refusing what is no ordinary file or a link to one; ``what`` it holds, for
    the message.

    Raises InvalidInput; where there is nothing at all, its cause is a FileNotFoundError.
    """
    path = check_path(path, what)
    try:
        status = path.stat()
        endless = stat.S_ISREG(status.st_mode) and not status.st_size and bool(_start(path, 1))
    except FileNotFoundError as error:
        raise InvalidInput(f"{path} is not a file; check the name") from error
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if not stat.S_ISREG(status.st_mode):
        raise InvalidInput(
            f"{path} is {_kind(status.st_mode)}, but must be a file; give the path of a {what}"
        )
    if endless:
        raise InvalidInput(
            f"{path} is a file of the system that states no size; copy its content into a file "
            "first"
        )
    return path


def read_text(path: Any, what: str, largest: int = 10_000_000) -> str:
    """The UTF-8 text, without a byte order mark, of an ordinary file of at most ``largest`` bytes.
    Raises InvalidInput.
    """
    path = check_source(path, what)
    try:
        data = _start(path, largest + 1)
    except OSError as error:
        raise _unreadable(path, error) from error
    if len(data) > largest:
        raise InvalidInput(f"{path} has more than {largest} bytes; that is no {what}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{error.object[error.start]:02x}"
        raise InvalidInput(f"{path} is not UTF-8 text ({byte}); save it as UTF-8 text") from None


def refuse_special(target: Path, what: str) -> None:
    """Raises InvalidInput where something stands at ``target`` that a new file would destroy: a
    link, a pipe, a device.
    """
    try:
        mode = target.lstat().st_mode
    except (OSError, ValueError):
        return  # nothing there, or writing will say why not
    if not stat.S_ISREG(mode):
        remedy = (
            "give the path of the file itself"
            if stat.S_ISLNK(mode)
            else "give another path, or remove it"
        )
        raise InvalidInput(
            f"cannot write the {what} {target}: it is {_kind(mode)}, and no file replaces one; "
            f"{remedy}"
        )


def file_name(text: str) -> str:
    """A name that users chose, fit to be (part of) the name of a file anywhere: letters, digits,
    ``_``, ``-``, ``.`` inside.
    """
    plain = re.sub(r"[^\w.-]+", "-", unicodedata.normalize("NFC", text))
    return re.sub(r"\.{2,}", ".", plain)[:_LONGEST_NAME].strip(".-") or "unnamed"


def _start(path: Path, size: int) -> bytes:
    """The first bytes of a file, without waiting: a pipe may have come there since it was looked
    at.
    """
    with open(
        path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
    ) as file:
        return file.read(size) or b""


def _kind(mode: int) -> str:
    return _KINDS.get(stat.S_IFMT(mode), "no ordinary file")


def _unreadable(path: Path, error: Exception) -> InvalidInput:
    return InvalidInput(
        f"{path} cannot be read: {getattr(error, 'strerror', None) or error}; check its name and "
        "permissions"
    )


# Files that appear complete or not at all: written under a temporary name, then renamed. Several
# together: all or none.


# in a folder: old and new files of a write that was killed while it replaced them
INTERRUPTED = "interrupted-write"


@contextmanager
def draft_of(path: str | os.PathLike[str], what: str, new: bool = False) -> Iterator[Path]:
    """A temporary name beside ``path``; after the block it replaces ``path``, or is removed if the
    block failed.

    What was written is on the disk before it gets its name. what: the kind of file, for the
    message; new: nothing that stands there by then is replaced. Raises InvalidInput where the place
    cannot be written.
    """
    target = check_file(path, what)
    draft = _beside(target)
    try:
        yield draft
        with draft.open("rb+") as written:
            os.fsync(written.fileno())
        if new:
            os.link(draft, target)
        else:
            os.replace(draft, target)
    except FileExistsError as error:
        raise InvalidInput(
            f"{target.name} was written by another program during this run and is kept; run the "
            "command again"
        ) from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write the {what} {target}: {reason}; give a file in an existing, writable "
            "folder"
        ) from error
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
    _settle(target.parent)


class Steady(io.FileIO):
    """A new file for libraries that crash where a disk is full: they are told that all is well, and
    its end raises OSError.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self.failed: OSError | None = None

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        try:
            while done < len(view) and self.failed is None:
                done += super().write(view[done:]) or 0
        except OSError as error:
            self.failed = error
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.failed = self.failed or error
            return self.tell() if size is None else size

    def __exit__(self, *reason: Any) -> None:
        super().__exit__(*reason)
        if self.failed is not None:
            raise self.failed


def set_aside(path: Path) -> None:
    """What stands at ``path``, if anything, makes room and is called ``earlier-<name>``. Raises
    InvalidInput.
    """
    earlier = path.with_name(f"earlier-{path.name}")
    try:
        if os.path.lexists(path):
            if earlier.is_dir() and not earlier.is_symlink():
                shutil.rmtree(earlier)
            os.replace(path, earlier)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot rename {path} to {earlier.name}: {reason}; remove one of them"
        ) from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """The folder ``path``, made with those above it if absent. Raises InvalidInput."""
    path = check_path(path, "folder")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot make the folder {path}: {reason}; give one that can be written"
        ) from error
    return path


def check_file(path: str | os.PathLike[str], what: str) -> Path:
    """``path``, after refusing one that cannot become a file. Raises InvalidInput."""
    target = check_path(path, what)
    if not target.name or target.is_dir():
        raise invalid(
            f"the path of the {what}", repr(str(target)), "that of a file", "add a file name"
        )
    if not target.parent.is_dir():
        raise InvalidInput(
            f"cannot write the {what} {target}: {target.parent} is not a directory; "
            "give a file in an existing folder, or create the folder first"
        )
    refuse_special(target, what)
    return target


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write ``text`` (UTF-8) to ``path`` in one step. Returns the path. Raises InvalidInput."""
    with draft_of(path, what) as draft, draft.open("x", encoding="utf-8") as stream:
        stream.write(text)
    return Path(path)


def write_json(path: str | os.PathLike[str], content: Any, what: str = "result file") -> Path:
    """``content`` as a JSON file in one step, infinities and NaN as strings. Raises
    InvalidInput.
    """
    return write_text(path, json_text(content, indent=1) + "\n", what)


def write_files(
    directory: str | os.PathLike[str], files: Mapping[str, str | bytes], *, held: bool = False
) -> list[Path]:
    """Write texts (UTF-8) and bytes by name into ``directory``, made if absent (its parent must
    exist). Returns their paths.

    Everything is written and flushed beside the directory first, so that a full disk or an
    unwritable place leaves what was there before; then a new directory appears in one step. In one
    that exists the files are replaced one after the other, and put back where one cannot be; a kill
    meanwhile leaves all of them, old and new, in its folder ``interrupted-write``, and the next
    write into the directory first finishes that one. held: the caller has claimed the directory.
    Raises InvalidInput.
    """
    target = check_place(directory, files)
    with nullcontext() if held else claimed(target, "folder"):
        draft = _beside(target / INTERRUPTED if target.is_dir() else target)
        try:
            if not target.is_dir():
                _fill(draft, files)
                os.replace(draft, target)
                _settle(target.parent)
            else:
                _finish_interrupted(target, draft)
                draft.mkdir()
                _fill(draft / "new", files)
                (draft / "old").mkdir()
                for name in (name for name in files if (target / name).exists()):
                    shutil.copyfile(target / name, draft / "old" / name)
                _settle(draft)
                os.replace(draft, target / INTERRUPTED)
                _switch(target, files, draft)
        except OSError as error:
            reason = error.strerror or str(error)
            state = "nothing was changed there, give a writable folder"
            if (target / INTERRUPTED).exists():
                state = (
                    f"its files, old and new, stand in {target / INTERRUPTED}: repeat the write, "
                    "it is finished first"
                )
            raise InvalidInput(f"cannot write to {target}: {reason}; {state}") from error
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return [target / name for name in files]


def _fill(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """A new folder with these files, all on the disk."""
    folder.mkdir()
    for name, content in files.items():
        with (folder / name).open("xb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
    _settle(folder)


def _switch(target: Path, names: Iterable[str], away: Path) -> None:
    """The new files of an interrupted write get their places, or the old ones back; what is left of
    it goes ``away``.
    """
    interrupted, done = target / INTERRUPTED, []
    try:
        for name in names:
            os.replace(interrupted / "new" / name, target / name)
            done.append(name)
        _settle(target)
    except BaseException:
        for name in done:  # at every moment each new file is whole, here or there, for a kill now
            os.replace(target / name, interrupted / "new" / name)
            if (interrupted / "old" / name).exists():
                os.replace(interrupted / "old" / name, target / name)
        os.replace(interrupted, away)
        raise
    with suppress(OSError):  # it is empty, and in nobody's way
        os.replace(interrupted, away)


def _finish_interrupted(target: Path, away: Path) -> None:
    """A write that was killed while it replaced files: the rest of them."""
    interrupted = target / INTERRUPTED
    if (interrupted / "new").is_dir() and (interrupted / "old").is_dir():
        for path in (interrupted / "new").iterdir():
            os.replace(path, target / path.name)
        _settle(target)
        os.replace(interrupted, away)
        shutil.rmtree(away)


def _beside(path: Path) -> Path:
    """A name for what becomes ``path``."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.tmp")


def _settle(folder: Path) -> None:
    """The names in a folder onto the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def check_place(directory: str | os.PathLike[str], names: Iterable[str] = ()) -> Path:
    """``directory`` as a path, after refusing one that cannot become or hold these files. Raises
    InvalidInput.
    """
    target = check_path(directory, "folder")
    if os.path.lexists(target) and not target.is_dir():
        raise InvalidInput(
            f"cannot write to {target}: it is not a folder; give the path of a folder"
        )
    if not target.parent.is_dir():
        raise InvalidInput(
            f"cannot write to {target}: {target.parent} is not a directory; create it first"
        )
    for name in names:
        refuse_special(target / name, "file")
    return target


# One run at a time into a file or a folder: the second is refused, and nothing that a killed run
# leaves is in the way.
#
# The lock is the operating system's, on an empty file beside the place: it ends with the process
# that holds it, also by a kill. Where a file system has no locks (some network folders), two runs
# are not told apart.


_ATTEMPTS = 100  # to open a lock file that others are removing
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)

if sys.platform == "win32":
    import msvcrt

    def _held_by_another(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return True
        return False

else:
    import fcntl

    def _held_by_another(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            pass
        return False


@contextmanager
def claimed(path: str | os.PathLike[str], what: str, held: str = "") -> Iterator[None]:
    """Holds the file or folder ``path`` against every other run that claims it, until the block
    ends.

    what: the kind of file, for the message; held: what is said where another run holds it. The lock
    file is ``.<name>.lock`` beside it; ``.lock`` in a folder whose own cannot be written. Raises
    InvalidInput where another run holds it, and where no file can be made there.
    """
    target = Path(os.path.realpath(check_path(path, what)))
    lock = target.with_name(f".{target.name}.lock")
    try:
        try:
            descriptor = _hold(lock)
        except PermissionError:
            if not target.is_dir():
                raise
            descriptor = _hold(lock := target / ".lock")
    except BlockingIOError:
        remedy = f"wait until it ends, or write the {what} elsewhere"
        raise InvalidInput(held or f"another run is writing {path}; {remedy}") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write the {what} {path}: {reason}; give a place in a writable folder"
        ) from error
    try:
        yield
    finally:
        try:
            if sys.platform != "win32":  # there a file that is open cannot be removed
                _remove(lock)
        finally:
            os.close(descriptor)
        if sys.platform == "win32":
            _remove(lock)


def _hold(lock: Path) -> int:
    """The descriptor of the lock file, locked. Raises OSError where it cannot be made,
    BlockingIOError where it is held.
    """
    for _ in range(_ATTEMPTS):
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o666)
        except PermissionError:
            if not lock.is_file():
                raise
            descriptor = os.open(lock, os.O_RDONLY | _NO_LINK)  # somebody else's run left it
        if _held_by_another(descriptor):
            os.close(descriptor)
            break
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                return descriptor
        os.close(descriptor)  # removed by its holder in between
    raise BlockingIOError


def _remove(lock: Path) -> None:
    with suppress(OSError):  # another run may have opened it, or it is gone: harmless either way
        lock.unlink()


# What a file may hold at most; beyond it is refused before anything is built. Stated for users in
# docs/reference/machine-file.md and docs/reference/records.md.
#
# Machine: what a real machine needs with room to spare, and what all commands still do in minutes.
# Records: what a computer's memory holds.


TOML_BYTES = 1_000_000  # of a machine file, a column map, a scenario: a thousand tables
TOML_DEPTH = 12  # of brackets, and of dotted keys
TOML_ENTRIES = 100_000  # keys, list elements and tables together
TEXT, NAME = 10_000, 100  # characters of a text, and of a key, a name or a label
_NAMES = {"name", "label", "bearing", "material"}
# of the whole shaft: so many elements of equal length leave nine digits of the bending frequencies
ELEMENTS = 800
# bending modes per plane in the full model, at most and at least (``model.assemble``)
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


# JSON that somebody wrote -> plain data, by one gate: every number is one that a calculation bears.
#
# NaN, infinities, numbers whose square overflows, keys given twice and endless nesting are refused;
# ``check_form`` holds the data against its JSON schema.


_TYPES: Mapping[str, tuple[type, ...]] = {
    "object": (Mapping,),
    "array": (list, tuple),
    "string": (str,),
    "boolean": (bool,),
    "number": (int, float),
    "integer": (int,),
    "null": (type(None),),
}


def parse_json(text: str | bytes, again: str, largest: float = LARGEST_NUMBER) -> Any:
    """The content of a JSON text. again: how to make it anew, for the refusals; largest: size of a
    number. Raises InvalidInput, which names no file.
    """

    def number(digits: str) -> float:
        value = float(digits)
        if not abs(value) <= largest:
            most = f"finite, at most {largest:g} in size"
            raise invalid("a number", quoted(digits), most, again)
        return value

    def whole(digits: str) -> int:
        number(digits)
        return int(digits)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(pairs)
        if len(pairs) > JSON_KEYS:
            most = f"at most {JSON_KEYS}"
            raise invalid(
                "the number of keys of a table", len(pairs), most, "is this the right file?"
            )
        if len(result) != len(pairs):
            (twice, _), *_ = Counter(name for name, _ in pairs).most_common(1)
            raise invalid(f"key {quoted(twice)}", "given twice", "given once", again)
        return result

    content = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    if _depth(content) > JSON_DEPTH:
        raise InvalidInput(f"is JSON that is nested more than {JSON_DEPTH} times; {again}")
    try:
        return json.loads(
            content,
            parse_constant=number,
            parse_float=number,
            parse_int=whole,
            object_pairs_hook=unique,
        )
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InvalidInput(
            f"is not complete JSON ({error.msg} at {where}); {again}, it may be truncated"
        ) from error
    except (RecursionError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"is not JSON that can be read ({error}); {again}") from error


def _depth(text: str) -> int:
    if text.count("[") + text.count("{") <= JSON_DEPTH:
        return 0
    marks = re.findall(r"[][{}]", re.sub(r'"(?:[^"\\]|\\.)*+"?', "", text))
    return max(accumulate(1 if mark in "[{" else -1 for mark in marks), default=0)


def check_form(data: Any, schema: Mapping[str, Any], again: str) -> None:
    """Raises InvalidInput for the first place at which data is not what its schema says (type,
    enum, const, required, properties, additionalProperties, items, minimum, exclusiveMinimum).
    """
    for place, problem in _faults(data, schema, ""):
        raise InvalidInput(f"{place or 'the whole'} {problem}; {again}")


def _faults(data: Any, schema: Mapping[str, Any], place: str) -> Iterator[tuple[str, str]]:
    allowed = schema.get("type", ())
    names = as_several(allowed)
    if names and not any(_is(data, name) for name in names):
        yield place, f"is {_shown(data)}, but must be {' or '.join(names)}"
    elif "const" in schema and data != schema["const"]:
        yield place, f"is {_shown(data)}, but must be {_shown(schema['const'])}"
    elif "enum" in schema and data not in schema["enum"]:
        yield place, f"is {_shown(data)}, but must be one of {', '.join(schema['enum'])}"
    elif isinstance(data, Mapping):
        properties, rest = schema.get("properties", {}), schema.get("additionalProperties", True)
        for key in schema.get("required", ()):
            if key not in data:
                yield f"{place}.{key}".lstrip("."), "is missing"
        for key, value in data.items():
            below = properties.get(key, rest)
            if below is False:
                yield f"{place}.{key}".lstrip("."), "is unknown"
            elif isinstance(below, Mapping):
                yield from _faults(value, below, f"{place}.{key}".lstrip("."))
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            yield from _faults(value, schema.get("items", {}), f"{place}[{i}]")
    elif isinstance(data, int | float) and not isinstance(data, bool):
        least, above = schema.get("minimum", -math.inf), schema.get("exclusiveMinimum", -math.inf)
        if not math.isfinite(data) or abs(data) > LARGEST_NUMBER:
            yield place, f"is {data}, but must be finite, at most {LARGEST_NUMBER:g} in size"
        elif data < least or data <= above:
            yield place, f"is {data:g}, but must be {'at least' if data < least else 'above'} 0"


def _is(data: Any, name: str) -> bool:
    if isinstance(data, bool):
        return name == "boolean"
    return isinstance(data, _TYPES[name])


def _shown(data: Any) -> str:
    if isinstance(data, Mapping | list | tuple):
        return "a table" if isinstance(data, Mapping) else "a list"
    return quoted(data)
