"""What the tables of a machine file are made of: the base of their pydantic models, and the kinds of value they take."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from ambrose.machine.file.fields import PairOf, Quantity, Text

Length = Annotated[float, Quantity("length")]
Mass = Annotated[float, Quantity("mass")]
Inertia = Annotated[float, Quantity("moment of inertia")]
Angle = Annotated[float, Quantity("angle")]
Rate = Annotated[float, Quantity("angular rate")]
Time = Annotated[float, Quantity("time")]
Current = Annotated[float, Quantity("current")]
Force = Annotated[float, Quantity("force")]
Pressure = Annotated[float, Quantity("pressure")]
Stiffness = Annotated[float, Quantity("stiffness")]
Damping = Annotated[float, Quantity("damping")]
Ratio = Annotated[float, Quantity("ratio")]
ForcePerCurrentPair = Annotated[tuple[float, float], PairOf("force per current")]
StiffnessPair = Annotated[tuple[float, float], PairOf("stiffness")]
Words = Annotated[str, Text()]
Name = Annotated[str, Text("a name")]


def required(doc: str) -> Any:
    return Field(description=doc)


def optional(doc: str) -> Any:
    """A key that may be left out; the noun's own default applies then."""
    return Field(default=None, description=doc)


class Table(BaseModel):
    """One table of the file; ``noun`` is what it becomes."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    noun: ClassVar[type | None] = None
    apart: ClassVar[frozenset[str]] = frozenset()  # keys that ``given`` leaves to the reader
    identity: ClassVar[str] = ""  # the key whose value tells the entries of a list apart; empty: their order does

    def given(self) -> dict[str, Any]:
        """The keys that the file has, nested tables turned into nouns and lists into tuples."""
        return {key: _built(getattr(self, key)) for key in self.model_fields_set - self.apart}

    def build(self) -> Any:
        """The noun, with its own defaults for what the file leaves out."""
        assert self.noun is not None
        return self.noun(**self.given())


def _built(value: Any) -> Any:
    if isinstance(value, Table):
        return value.build()
    if isinstance(value, list):
        return tuple(_built(element) for element in value)
    return value
