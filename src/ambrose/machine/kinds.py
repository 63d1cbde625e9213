"""Kinds of value in a machine file: how each is read, what to say when it is wrong, and how an
editor's schema describes it.

A kind is a pydantic annotation: ``length: Annotated[float, Quantity("length")]``. Its ``read``
raises ValueError with a text that follows the key's name; the schema adds table, entry and key.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from ambrose.machine.units import DIMENSIONS, meant, read_quantity, shown

# for an editor: a number, signed or not, with or without an exponent, then anything that begins
# with a letter, a degree sign or %; whether it is a unit, ``read_quantity`` knows
UNIT_STRING = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[A-Za-zµμ°%].*$"
# of anything that a file counts (poles, states, samples); assumed, so that a slip of the keyboard
# is refused and does not fill the memory
_LARGEST_COUNT = 1_000_000
_DEEPEST = 3  # lists in lists of a table: the axes that a table may have
# stands for a reference until pydantic has made the schema, which knows only its own definitions
PLACEHOLDER = "x-quantity"


class _Kind:
    """What all kinds share: the two hooks by which pydantic finds them in an annotation."""

    __slots__ = ()

    @property
    def expects(self) -> str:
        """What belongs here, after "give": "a length [m], for example "0.5 mm""."""
        raise NotImplementedError

    def read(self, value: object) -> Any:
        """``value`` as written -> as stored; raises ValueError."""
        raise NotImplementedError

    def schema(self) -> dict[str, Any]:
        """JSON schema of the value as written."""
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return self.schema()

    def _validate(self, value: object) -> Any:
        from pydantic_core import PydanticCustomError

        try:
            return self.read(value)
        except ValueError as error:
            raise PydanticCustomError("value", "{problem}", {"problem": str(error)}) from None


@dataclass(frozen=True, slots=True)
class Quantity(_Kind):
    """A number of a dimension (a key of units.DIMENSIONS): float in SI."""

    dimension: str

    @property
    def expects(self) -> str:
        dimension = DIMENSIONS[self.dimension]
        return dimension.phrase + (
            f', for example "{dimension.example}"' if dimension.example else ""
        )

    def read(self, value: object) -> float:
        return read_quantity(value, DIMENSIONS[self.dimension])

    def schema(self) -> dict[str, Any]:
        return {PLACEHOLDER: _definition(self.dimension)}


@dataclass(frozen=True, slots=True)
class PairOf(_Kind):
    """Two quantities; ``names`` says which. A scalar stands for both where ``scalar`` allows it."""

    dimension: str
    names: str = "zeta, eta"
    scalar: bool = True

    @property
    def expects(self) -> str:
        one = Quantity(self.dimension).expects
        return f"[{self.names}], each {one}" + (", or one value for both" if self.scalar else "")

    def read(self, value: object) -> tuple[float, float]:
        if isinstance(value, list):
            if len(value) != 2:
                raise ValueError(
                    f"is {shown(value)}, a list of {len(value)}, but must have two elements; give "
                    f"{self.expects}"
                )
            first, second = _read_elements(value, self.dimension)
            return first, second
        if not self.scalar:
            raise ValueError(f"is {shown(value)}, but must be a list of two; give {self.expects}")
        both = read_quantity(value, DIMENSIONS[self.dimension])
        return both, both

    def schema(self) -> dict[str, Any]:
        one = Quantity(self.dimension).schema()
        pair = {"type": "array", "items": one, "minItems": 2, "maxItems": 2}
        return {"anyOf": [one, pair]} if self.scalar else pair


@dataclass(frozen=True, slots=True)
class ListOf(_Kind):
    """One quantity or more: a tuple; a scalar is a list of one where ``scalar`` allows it."""

    dimension: str
    scalar: bool = False

    @property
    def expects(self) -> str:
        return f"a list, each element {Quantity(self.dimension).expects}"

    def read(self, value: object) -> tuple[float, ...]:
        if not isinstance(value, list):
            if self.scalar:
                return (read_quantity(value, DIMENSIONS[self.dimension]),)
            raise ValueError(f"is {shown(value)}, but must be a list; give {self.expects}")
        if not value:
            raise ValueError(
                f"is an empty list, but must have at least one element; give {self.expects}"
            )
        return tuple(_read_elements(value, self.dimension))

    def schema(self) -> dict[str, Any]:
        one = Quantity(self.dimension).schema()
        many = {"type": "array", "items": one, "minItems": 1}
        return {"anyOf": [one, many]} if self.scalar else many


@dataclass(frozen=True, slots=True)
class NestedOf(_Kind):
    """Quantities in lists nested one to three deep (a table over as many axes): nested tuples."""

    dimension: str

    @property
    def expects(self) -> str:
        return (
            "lists nested in the order of the table's axes, each element "
            f"{Quantity(self.dimension).expects}"
        )

    def read(self, value: object) -> Any:
        if not isinstance(value, list):
            raise ValueError(f"is {shown(value)}, but must be a list; give {self.expects}")
        return self._read_level(value, 1)

    def _read_level(self, value: list[object], depth: int) -> Any:
        if depth > _DEEPEST:
            raise ValueError(f"is nested deeper than three lists; give {self.expects}")
        rows = []
        for i, element in enumerate(value):
            try:
                one = Quantity(self.dimension)
                rows.append(
                    self._read_level(element, depth + 1)
                    if isinstance(element, list)
                    else one.read(element)
                )
            except ValueError as error:
                raise ValueError(f"(element {i + 1}) {error}") from None
        return tuple(rows)

    def schema(self) -> dict[str, Any]:
        level: dict[str, Any] = Quantity(self.dimension).schema()
        levels = []
        for _ in range(_DEEPEST):
            level = {"type": "array", "items": level, "minItems": 1}
            levels.append(level)
        return {"anyOf": levels}


@dataclass(frozen=True, slots=True)
class Text(_Kind):
    """A string."""

    what: str = "text"

    @property
    def expects(self) -> str:
        return f"{self.what} in quotes"

    def read(self, value: object) -> str:
        if not isinstance(value, str):
            raise ValueError(f"is {shown(value)}, but must be a string; give {self.expects}")
        return value

    def schema(self) -> dict[str, Any]:
        return {"type": "string"}


@dataclass(frozen=True, slots=True)
class Choice(_Kind):
    """One of a few strings."""

    options: tuple[str, ...]

    @property
    def expects(self) -> str:
        return "one of " + ", ".join(f'"{option}"' for option in self.options)

    def read(self, value: object) -> str:
        if not isinstance(value, str) or value not in self.options:
            close = meant(value, self.options) if isinstance(value, str) else ""
            remedy = f'did you mean "{close}"?' if close else "choose one of them"
            raise ValueError(f"is {shown(value)}, but must be {self.expects}; {remedy}")
        return value

    def schema(self) -> dict[str, Any]:
        return {"enum": list(self.options)}


@dataclass(frozen=True, slots=True)
class Texts(_Kind):
    """A list of texts."""

    @property
    def expects(self) -> str:
        return "a list of labels"

    def read(self, value: object) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(element, str) for element in value):
            raise ValueError(f"is {shown(value)}, but must be a list of texts; give {self.expects}")
        return tuple(value)

    def schema(self) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "string"}}


@dataclass(frozen=True, slots=True)
class Choices(_Kind):
    """A list of different strings out of a few."""

    options: tuple[str, ...]

    @property
    def expects(self) -> str:
        return f"a list out of {', '.join(self.options)}"

    def read(self, value: object) -> tuple[str, ...]:
        if not isinstance(value, list):
            raise ValueError(f"is {shown(value)}, but must be a list; give {self.expects}")
        return tuple(Choice(self.options).read(element) for element in value)

    def schema(self) -> dict[str, Any]:
        return {"type": "array", "items": Choice(self.options).schema(), "uniqueItems": True}


@dataclass(frozen=True, slots=True)
class Count(_Kind):
    """A whole number."""

    @property
    def expects(self) -> str:
        return "a whole number"

    def read(self, value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(
                f"is {shown(value)}, but must be a whole number; write it without decimals, "
                "quotes or unit"
            )
        if abs(value) > _LARGEST_COUNT:
            raise ValueError(f"is {shown(value)}, but must be at most {_LARGEST_COUNT}; correct it")
        return value

    def schema(self) -> dict[str, Any]:
        return {"type": "integer"}


@dataclass(frozen=True, slots=True)
class Version(_Kind):
    """The version of the file format, one number."""

    only: int

    @property
    def expects(self) -> str:
        return f"{self.only}, the version of the file format"

    def read(self, value: object) -> int:
        if isinstance(value, bool) or value != self.only:
            remedy = (
                f"this version of ambrose reads schema {self.only} only; update ambrose, or write "
                f"schema = {self.only}"
            )
            raise ValueError(f"is {shown(value)}, but must be {self.only}; {remedy}")
        return self.only

    def schema(self) -> dict[str, Any]:
        return {"const": self.only}


Length = Annotated[float, Quantity("length")]
Mass = Annotated[float, Quantity("mass")]
Inertia = Annotated[float, Quantity("moment of inertia")]
Angle = Annotated[float, Quantity("angle")]
Rate = Annotated[float, Quantity("angular rate")]
Time = Annotated[float, Quantity("time")]
Current = Annotated[float, Quantity("current")]
Pressure = Annotated[float, Quantity("pressure")]
Stiffness = Annotated[float, Quantity("stiffness")]
Damping = Annotated[float, Quantity("damping")]
Ratio = Annotated[float, Quantity("ratio")]
ForcePerCurrentPair = Annotated[tuple[float, float], PairOf("force per current")]
StiffnessPair = Annotated[tuple[float, float], PairOf("stiffness")]
Words = Annotated[str, Text()]
Name = Annotated[str, Text("a name")]


def quantity_schemas() -> dict[str, Any]:
    """The JSON schema of every dimension: a number in SI or a string with a unit."""
    return {_definition(name): _quantity_schema(name) for name in DIMENSIONS}


def _definition(dimension: str) -> str:
    return dimension.replace(" ", "_")


def _quantity_schema(name: str) -> dict[str, Any]:
    dimension = DIMENSIONS[name]
    if not dimension.units:
        return {"description": "a plain number", "type": "number"}
    return {
        "description": f"{name}: a plain number in {dimension.unit}, or a string with a unit such "
        f'as "{dimension.example}"',
        "anyOf": [
            {"type": "number"},
            {"type": "string", "pattern": UNIT_STRING, "examples": [dimension.example]},
        ],
    }


def _read_elements(values: list[object], dimension: str) -> list[float]:
    elements = []
    for i, value in enumerate(values):
        try:
            elements.append(read_quantity(value, DIMENSIONS[dimension]))
        except ValueError as error:
            raise ValueError(f"(element {i + 1}) {error}") from None
    return elements
