"""The model description of an FMU (FMI 2.0.4 sections 2.2 and 4.3, FMI 3.0.2 sections 2.4 and 4.4):
variables, units, step.

Value references count from 0 in the order of ``variables``; the C of templates/fmu_memory.h.j2 uses
the same.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Literal

from ambrose.code.all_axes import AllAxes
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.synchronous import RunUnit
from ambrose.version import __version__

Version = Literal["2.0", "3.0"]
FLAGS = (
    ("held", "an input was replaced by its last good value"),
    ("fault", "an input has been replaced for too long"),
    ("limited", "a current was cut at its limit"),
)
_BASE = {
    "s": {"s": "1"},
    "m": {"m": "1"},
    "A": {"A": "1"},
    "rad": {"rad": "1"},
    "rad/s": {"s": "-1", "rad": "1"},
    "Pa": {"kg": "1", "m": "-1", "s": "-2"},
}
# of the synchronous blocks, in the order of their bits
FAULTS = (
    ("sync_lost", "no pulse of the key phasor for too long"),
    ("sync_jump", "the speed jumps"),
    ("sync_contact", "the rotor touches"),
    ("sync_saturated", "a current is at its limit"),
    ("sync_limit", "an amplitude is at its limit"),
    ("sync_outside", "the speed is outside the table"),
    ("sync_disabled", "the blocks are switched off"),
    ("sync_input", "a reading is not usable"),
)
AnyBlock = ControlBlock | ScheduledBlock
Beside = AnyBlock | RunUnit  # the latter with synchronous blocks beside it
AnyLaw = Beside | AllAxes


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable of an FMU. limit: of an output, the largest magnitude; nominal: what is a usual
    size.
    """

    name: str
    kind: Literal["real", "boolean"]
    causality: Literal["independent", "input", "output"]
    unit: str
    description: str
    start: str | None = None
    limit: float | None = None
    nominal: float | None = None


def radial_of(law: AnyLaw) -> Beside:
    """The law of the radial axes: all of it where there is no axis along the shaft."""
    return law.radial if isinstance(law, AllAxes) else law


def axial_of(law: AnyLaw) -> ControlBlock | None:
    """The block of the axis along the shaft; None: there is none."""
    return law.axial if isinstance(law, AllAxes) else None


def base_of(law: AnyLaw) -> AnyBlock:
    """The (radial) controller's block."""
    radial = radial_of(law)
    return radial.base if isinstance(radial, RunUnit) else radial


def blocks_of(law: AnyLaw) -> tuple[AnyBlock, ...]:
    """The blocks whose errors and currents are the FMU's, in their order."""
    axial = axial_of(law)
    return (base_of(law),) if axial is None else (base_of(law), axial)


def transfers(law: AnyLaw) -> bool:
    """Whether it can follow given currents: a unit of all axes has no such step."""
    return base_of(law).transfers and axial_of(law) is None


def flags(block: AnyBlock) -> tuple[tuple[str, str], ...]:
    """The status flags in the order of their bits, each with what it says."""
    if not isinstance(block, ScheduledBlock):
        return FLAGS
    name = block.along.name
    return (
        *FLAGS,
        ("clamped", f"the {name} is outside the range; the law is that of the nearer end"),
        (f"{name}_held", f"the {name} is among what was replaced"),
        ("behind", f"the schedule has not reached the {name}: it moves at its largest rate"),
    )


def variables(law: AnyLaw) -> tuple[Variable, ...]:
    """Time, errors, their flags, [speed or pressure], [the rotor's angle, contact, blocks off],
    [tracking, given currents], currents, status flags, [faults of the blocks], [status flags of the
    axis along the shaft], in the order of value references; errors, their flags and currents of
    that axis come last among theirs.
    """
    block, beside = base_of(law), isinstance(radial_of(law), RunUnit)
    errors = [
        one for item in blocks_of(law) for one in zip(item.inputs, item.error_limit, strict=True)
    ]
    currents = [
        one for item in blocks_of(law) for one in zip(item.outputs, item.current_limit, strict=True)
    ]
    found = [Variable("time", "real", "independent", "s", "simulation time")]
    for name, limit in errors:
        text = f"reference - displacement, plausible within +-{limit:.9g} m"
        found.append(Variable(name, "real", "input", "m", text, "0", nominal=float(limit)))
    found += [
        Variable(f"valid_{name}", "boolean", "input", "", f"{name} may be used", "true")
        for name, _ in errors
    ]
    if isinstance(block, ScheduledBlock):
        (low, high), along = block.grid[[0, -1]].tolist(), block.along
        text = (
            f"what the controller is scheduled over, from {low:.9g} to {high:.9g}, plausible "
            f"within +-{block.told_limit:.9g}"
        )
        found.append(
            Variable(along.name, "real", "input", along.unit, text, repr(low), nominal=high)
        )
    if beside:
        text = "of the rotor, growing; a pulse of the key phasor comes at every whole turn"
        found.append(Variable("angle", "real", "input", "rad", text, "0"))
        text = "the rotor touches: the blocks let go"
        found.append(Variable("contact", "boolean", "input", "", text, "false"))
        text = "switch the synchronous blocks off"
        found.append(Variable("blocks_off", "boolean", "input", "", text, "false"))
    if transfers(law):
        text = "follow the given currents (bumpless transfer) instead of controlling"
        found.append(Variable("tracking", "boolean", "input", "", text, "false"))
        for name, limit in currents:
            text = f"{name} as another controller sets it; used while tracking"
            given = f"given_{name}"
            found.append(Variable(given, "real", "input", "A", text, "0", nominal=float(limit)))
    for name, limit in currents:
        most = float(limit)
        found.append(
            Variable(name, "real", "output", "A", "control current", limit=most, nominal=most)
        )
    shown = (*flags(block), *(FAULTS if beside else ()), *axial_flags(law))
    found += [Variable(name, "boolean", "output", "", text) for name, text in shown]
    return tuple(found)


def axial_flags(law: AnyLaw) -> tuple[tuple[str, str], ...]:
    """The status flags of the axis along the shaft, where there is one."""
    if axial_of(law) is None:
        return ()
    return tuple((f"axial_{name}", f"along the shaft: {text}") for name, text in FLAGS)


def references(law: AnyLaw) -> dict[str, int]:
    """The first value reference of each group of variables, by the label that the C uses."""
    block, order = base_of(law), {v.name: i for i, v in enumerate(variables(law))}
    first = {"ERROR": block.inputs[0], "VALID": f"valid_{block.inputs[0]}", "TRACKING": "tracking"}
    first |= {"GIVEN": f"given_{block.outputs[0]}", "CURRENT": block.outputs[0]}
    first |= {name.upper(): name for name, _ in FLAGS}
    first["LAST"] = flags(block)[-1][0]
    if isinstance(block, ScheduledBlock):
        first["TOLD"] = block.along.name
    if isinstance(radial_of(law), RunUnit):
        first |= {"ANGLE": "angle", "TOUCHING": "contact", "BLOCKS_OFF": "blocks_off"}
        first |= {"FAULT": FAULTS[0][0], "FAULT_LAST": FAULTS[-1][0]}
    if along := axial_flags(law):
        first |= {"AXIAL": along[0][0], "AXIAL_LAST": along[-1][0]}
    return {label: order[name] for label, name in first.items() if name in order}


def model_description(law: AnyLaw, version: Version, token: str, text: str) -> str:
    """modelDescription.xml. token: the GUID (2.0) or instantiation token (3.0); text: the model in
    one line.
    """
    block = base_of(law)
    three, step = version == "3.0", repr(block.sample_time)
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": block.name,
            "instantiationToken" if three else "guid": token,
        },
        description=text,
        generationTool=f"ambrose {__version__}",
        variableNamingConvention="flat",
    )
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=block.name,
        canHandleVariableCommunicationStepSize="false",
    )
    state = (
        ("canGetAndSetFMUState", "canSerializeFMUState")
        if three
        else ("canGetAndSetFMUstate", "canSerializeFMUstate")
    )
    for name in state:
        simulation.set(name, "true")
    if three:
        simulation.set("fixedInternalStepSize", step)
    else:
        files = ET.SubElement(simulation, "SourceFiles")
        for name in sources(law, version):
            ET.SubElement(files, "File", name=name)
    _units(root, law)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(
        categories, "Category", name="logStatusError", description="what was refused, and why"
    )
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=step)
    _variables(root, law, three=three)
    _structure(root, law, three=three)
    return _text(root)


def build_description(law: AnyLaw) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=base_of(law).name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources(law, "3.0"):
        ET.SubElement(files, "SourceFile", name=name)
    return _text(root)


def sources(law: AnyLaw, version: Version) -> tuple[str, ...]:
    """The files to compile."""
    name, axial = base_of(law).name, axial_of(law)
    beside = (f"{name}_sync.c", f"{name}_run.c") if isinstance(radial_of(law), RunUnit) else ()
    along = () if axial is None else (f"{axial.name}.c", f"{name}_axes.c")
    return (f"{name}.c", *beside, *along, f"fmi{version[0]}.c")


def _units(root: ET.Element, law: AnyLaw) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(v.unit for v in variables(law) if v.unit):
        unit = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", _BASE[name])
        if name == "m":
            ET.SubElement(unit, "DisplayUnit", name="um", factor="1e6")


def _variables(root: ET.Element, law: AnyLaw, *, three: bool) -> None:
    """The variables with their types: attributes of one element in FMI 3.0, a child element in FMI
    2.0.
    """
    listed = ET.SubElement(root, "ModelVariables")
    for reference, v in enumerate(variables(law)):
        common = {
            "name": v.name,
            "valueReference": str(reference),
            "causality": v.causality,
            "variability": _variability(v),
            "description": v.description,
        }
        if three:
            ET.SubElement(
                listed, "Float64" if v.kind == "real" else "Boolean", {**_attributes(v), **common}
            )
        else:
            scalar = ET.SubElement(listed, "ScalarVariable", common)
            ET.SubElement(scalar, "Real" if v.kind == "real" else "Boolean", _attributes(v))


def _variability(v: Variable) -> str:
    """Errors, speed and pressure are sampled from continuous signals; currents and flags change at
    samples.
    """
    return (
        "continuous"
        if v.causality == "independent" or v.unit in {"m", "rad", "rad/s", "Pa"}
        else "discrete"
    )


def _attributes(v: Variable) -> dict[str, str]:
    found = {} if v.start is None else {"start": v.start}
    if v.unit:
        found["unit"] = v.unit
    if v.unit == "m":
        found["displayUnit"] = "um"
    if v.limit is not None:
        found |= {"min": repr(-v.limit), "max": repr(v.limit)}
    if v.nominal is not None:
        found["nominal"] = repr(v.nominal)
    return found


def _structure(root: ET.Element, law: AnyLaw, *, three: bool) -> None:
    """Outputs depend on inputs at the same instant only where the design assumes that currents are
    set at once.
    """
    listed, late = variables(law), base_of(law).delay
    direct = [i for i, v in enumerate(listed) if v.causality == "input"] if late == 0 else []
    outputs = [i for i, v in enumerate(listed) if v.causality == "output"]
    structure = ET.SubElement(root, "ModelStructure")
    if three:
        for tag in ("Output", "InitialUnknown"):
            for i in outputs:
                ET.SubElement(
                    structure, tag, valueReference=str(i), dependencies=" ".join(map(str, direct))
                )
        return
    for tag in ("Outputs", "InitialUnknowns"):
        group = ET.SubElement(structure, tag)
        for i in outputs:
            ET.SubElement(
                group,
                "Unknown",
                index=str(i + 1),
                dependencies=" ".join(str(j + 1) for j in direct),
            )


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
