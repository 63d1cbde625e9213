"""An FMU (FMI 2.0 or 3.0, co-simulation) around the generated C: sources, and a binary for this
computer.

One communication step is a whole number of samples. The computing delay of the design is inside: at
a communication point the outputs are the currents that reach the amplifiers there, so the FMU is
connected to a model of the plant without any delay.
"""

import html
import io
import platform
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from ambrose.code.block.block import Block, check_identifier, render
from ambrose.code.c.code import Arithmetic, block_facts, law_files
from ambrose.code.c.compiled import COMPILERS, build_library, build_probe, find_compiler
from ambrose.code.interface import Law, interface_of, parts_of
from ambrose.core.checks import InvalidInput, invalid
from ambrose.version import __version__

# The model description of an FMU (FMI 2.0.4 sections 2.2 and 4.3, FMI 3.0.2 sections 2.4 and 4.4):
# variables, units, step.
#
# Value references count from 0 in the order of ``variables``; the C of templates/fmu_memory.h.j2
# uses the same.


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


def transfers(law: Law) -> bool:
    """Whether it can follow given currents: a unit of all axes has no such step."""
    return law.base.transfers and law.axial is None


def flags(block: Block) -> tuple[tuple[str, str], ...]:
    """The status flags in the order of their bits, each with what it says."""
    if not block.told:
        return FLAGS
    name = block.told[0]
    return (
        *FLAGS,
        ("clamped", f"the {name} is outside the range; the law is that of the nearer end"),
        (f"{name}_held", f"the {name} is among what was replaced"),
        ("behind", f"the schedule has not reached the {name}: it moves at its largest rate"),
    )


def variables(law: Law) -> tuple[Variable, ...]:
    """Time, errors, their flags, [speed or pressure], [the rotor's angle, contact, blocks off],
    [tracking, given currents], currents, status flags, [faults of the blocks], [status flags of the
    axis along the shaft], in the order of value references; errors, their flags and currents of
    that axis come last among theirs.
    """
    block, beside = law.base, law.beside
    errors = [
        one for item in parts_of(law) for one in zip(item.inputs, item.error_limit, strict=True)
    ]
    currents = [
        one for item in parts_of(law) for one in zip(item.outputs, item.current_limit, strict=True)
    ]
    found = [Variable("time", "real", "independent", "s", "simulation time")]
    for name, limit in errors:
        text = f"reference - displacement, plausible within +-{limit:.9g} m"
        found.append(Variable(name, "real", "input", "m", text, "0", nominal=float(limit)))
    found += [
        Variable(f"valid_{name}", "boolean", "input", "", f"{name} may be used", "true")
        for name, _ in errors
    ]
    for one, axis, limit, _ in block.alone:
        low, high = axis[[0, -1]].tolist()
        text = (
            f"what the controller is scheduled over, from {low:.9g} to {high:.9g}, plausible "
            f"within +-{limit:.9g}"
        )
        found.append(Variable(one.name, "real", "input", one.unit, text, repr(low), nominal=high))
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


def axial_flags(law: Law) -> tuple[tuple[str, str], ...]:
    """The status flags of the axis along the shaft, where there is one."""
    if law.axial is None:
        return ()
    return tuple((f"axial_{name}", f"along the shaft: {text}") for name, text in FLAGS)


def references(law: Law) -> dict[str, int]:
    """The first value reference of each group of variables, by the label that the C uses."""
    block, order = law.base, {v.name: i for i, v in enumerate(variables(law))}
    first = {"ERROR": block.inputs[0], "VALID": f"valid_{block.inputs[0]}", "TRACKING": "tracking"}
    first |= {"GIVEN": f"given_{block.outputs[0]}", "CURRENT": block.outputs[0]}
    first |= {name.upper(): name for name, _ in FLAGS}
    first["LAST"] = flags(block)[-1][0]
    if block.told:
        first["TOLD"] = block.told[0]
    if law.beside:
        first |= {"ANGLE": "angle", "TOUCHING": "contact", "BLOCKS_OFF": "blocks_off"}
        first |= {"FAULT": FAULTS[0][0], "FAULT_LAST": FAULTS[-1][0]}
    if along := axial_flags(law):
        first |= {"AXIAL": along[0][0], "AXIAL_LAST": along[-1][0]}
    return {label: order[name] for label, name in first.items() if name in order}


def model_description(law: Law, version: Version, token: str, text: str) -> str:
    """modelDescription.xml. token: the GUID (2.0) or instantiation token (3.0); text: the model in
    one line.
    """
    block = law.base
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


def build_description(law: Law) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=law.base.name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources(law, "3.0"):
        ET.SubElement(files, "SourceFile", name=name)
    return _text(root)


def sources(law: Law, version: Version) -> tuple[str, ...]:
    """The files to compile."""
    return (*interface_of(law, "double").sources, f"fmi{version[0]}.c")


def _units(root: ET.Element, law: Law) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(v.unit for v in variables(law) if v.unit):
        unit = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", _BASE[name])
        if name == "m":
            ET.SubElement(unit, "DisplayUnit", name="um", factor="1e6")


def _variables(root: ET.Element, law: Law, *, three: bool) -> None:
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


def _structure(root: ET.Element, law: Law, *, three: bool) -> None:
    """Outputs depend on inputs at the same instant only where the design assumes that currents are
    set at once.
    """
    listed, late = variables(law), law.base.delay
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


# in templates/fmu_memory.h.j2, fmi2.c.j2, fmi3.c.j2
_OWN = ("fmi2", "fmi3", "memory", "instance", "counts", "token", "refuse")
_REMEDY = "write an FMU of sources only (--sources-only)"
# of the tokens: equal code has an equal token
_SPACE = uuid.UUID("5d1b0e5e-8f0a-5c0e-9a55-6d1f2c8f2f10")
_FOLDERS = {  # (system, machine): folder of FMI 2.0, folder of FMI 3.0, suffix
    ("Linux", "x86_64"): ("linux64", "x86_64-linux", "so"),
    ("Linux", "aarch64"): (None, "aarch64-linux", "so"),  # FMI 2.0 has no name for it
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin", "dylib"),
    ("Darwin", "arm64"): ("darwin64", "aarch64-darwin", "dylib"),
    ("Windows", "AMD64"): ("win64", "x86_64-windows", "dll"),
}


def generate_fmus(
    law: Law,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    *,
    sources_only: bool = False,
) -> dict[str, bytes]:
    """<name>_fmi2.fmu and <name>_fmi3.fmu of a controller's block, of one with synchronous blocks
    beside it, which are told the rotor's angle once a sample, or of all axes.

    arithmetic: of the code inside; the FMU's variables are in m and A in every case. sources_only:
    without a binary, for an importer that compiles. Raises InvalidInput, also where there is no C
    compiler, or it fails.
    """
    return {
        f"{law.base.name}_fmi{v[0]}.fmu": generate_fmu(
            law, v, arithmetic, provenance, sources_only=sources_only
        )
        for v in get_args(Version)
    }


def generate_fmu(
    law: Law,
    version: Version,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    *,
    sources_only: bool = False,
) -> bytes:
    """One FMU as the bytes of its archive; equal input gives equal bytes where the compiler does.
    Arguments and errors: ``generate_fmus``.
    """
    _check_names(law)
    if arithmetic == "float":
        law = law.single()
    block, code = law.base, generate_sources(law, version, arithmetic, provenance)
    token = "{" + str(uuid.uuid5(_SPACE, "\n".join(code.values()))) + "}"
    code[f"fmi{version[0]}.c"] = code[f"fmi{version[0]}.c"].replace("TOKEN", token)
    text = (
        f"Controller of {sum(len(item.inputs) for item in parts_of(law))} errors to "
        f"{sum(len(item.outputs) for item in parts_of(law))} currents, sampled at "
        f"{1 / block.sample_time:.9g} Hz"
    )
    archive: dict[str, str | bytes] = {
        "modelDescription.xml": model_description(law, version, token, text)
    }
    if not sources_only:
        place, suffix = _place(version)
        archive[f"binaries/{place}/{block.name}.{suffix}"] = _compiled(law, version, code)
    archive |= {f"sources/{name}": content for name, content in code.items()}
    if version == "3.0":
        archive["sources/buildDescription.xml"] = build_description(law)
    archive["documentation/index.html"] = _page(law, text, provenance)
    return _zipped(archive)


def generate_sources(
    law: Law, version: Version, arithmetic: Arithmetic, provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The C of an FMU by name; in fmi2.c or fmi3.c the word TOKEN stands for the token."""
    block, axial = law.base, law.axial
    face = interface_of(law, arithmetic)
    written = law_files(law, arithmetic, provenance, provenance)
    sync = f"{block.name.upper()}_SYNC"
    facts = {
        **block_facts(block),
        "transfers": transfers(law),
        "fixed": arithmetic.startswith("fixed"),
        "token": "TOKEN",
        "references": references(law).items(),
        "beside": bool(law.beside),
        "axial": "" if axial is None else axial.name,
        "error_lsb": _counts(law, "inputs"),
        "current_lsb": _counts(law, "outputs"),
        "files": " ".join(sources(law, version)),
        "header": f"{face.name}.h",
        # the unit that is stepped, and what it is told besides: the pulse, and what the caller sees
        "unit": face.memory,
        "call": face.name,
        "size": "" if axial is None else "_AXES",
        "faults": "faults" if axial is None else "radial.faults",
        "pulse": "memory_pulse(m), " if law.beside else "",
        "marks": f"(m->contact ? {sync}_CONTACT : 0u) | (m->blocks_off ? {sync}_DISABLED : 0u), "
        if law.beside
        else "",
        "scheduled": bool(block.told),
        "parameter": block.told[0] if block.told else "",
    }
    wrapper = f"fmi{version[0]}.c"
    compiled = [name.replace(".c", end) for name in face.sources for end in (".h", ".c")]
    return {
        **{name: written[name] for name in compiled},
        f"{block.name}_fmu.h": render("fmu_memory.h.j2", facts),
        wrapper: render(f"{wrapper}.j2", facts),
    }


def _counts(law: Law, side: str) -> str:
    """The names of what one count is worth, of all errors or currents."""
    return ", ".join(
        f"{block.name.upper()}_{name.upper()}_LSB"
        for block in parts_of(law)
        for name in getattr(block, side)
    )


def _check_names(law: Law) -> None:
    """The variables' names differ from each other: a signal may not be called like a flag of the
    FMU.
    """
    block, names = law.base, [v.name for v in variables(law)]
    for name in names:
        if names.count(name) > 1:
            raise invalid(
                "a signal's name",
                repr(name),
                "unlike the FMU's own variables",
                "give the controller's signals other names",
            )
    if block.name in _OWN:
        raise invalid(
            "the name of the block",
            repr(block.name),
            "unlike the FMU's own files and words",
            "give another --name",
        )
    check_identifier(block.name, "the name of the block", "choose letters, digits and underscores")


def _place(version: Version) -> tuple[str, str]:
    """The folder of binaries for this computer, and their suffix."""
    here = (platform.system(), platform.machine())
    two, three, suffix = _FOLDERS.get(here, (None, None, ""))
    folder = two if version == "2.0" else three
    if folder is None:
        remedy = "write an FMU of sources only, and compile it where it is used"
        raise invalid(
            "this computer", " ".join(here), f"a platform that FMI {version} names", remedy
        )
    return folder, suffix


def _compiled(law: Law, version: Version, code: Mapping[str, str]) -> bytes:
    """The shared library that the sources make here. Raises InvalidInput."""
    flags = ["-fvisibility=hidden"]
    return build_library(check_compiler(), code, sources(law, version), flags, _REMEDY, "-lm")


def check_compiler() -> str:
    """The C compiler, after it has shown that it works. Raises InvalidInput."""
    compiler = find_compiler()
    if compiler is None:
        raise InvalidInput(
            f"no C compiler was found ({', '.join(COMPILERS)}): an FMU with a binary needs one; "
            "install one, or write "
            "an FMU of sources only (--sources-only)"
        )
    build_probe(compiler, _REMEDY)
    return compiler


def _page(law: Law, text: str, provenance: Sequence[str]) -> str:
    block = law.base
    late = "at once" if block.delay == 0 else f"{block.delay} sample(s) after the errors were set"
    step = "one sample," if law.beside else "a whole multiple of"
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in provenance)
    rows = "".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{v.causality}</td><td>{v.unit}</td><td>{html.escape(v.description)}</td></tr>"
        for v in variables(law)
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta '
        f'charset="utf-8"><title>{block.name}</title></head><body>'
        f"<h1>{block.name}</h1><p>{html.escape(text)}. Currents leave {late}: connect it to the "
        "plant without another delay. "
        f"Communication step: {step} {block.sample_time:.9g} s.</p>"
        f"<table><tr><th>variable</th><th>kind</th><th>unit</th><th></th></tr>{rows}</table><ul>{lines}</ul></body></html>\n"
    )


def _zipped(files: Mapping[str, str | bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)  # of 1980-01-01: equal files make an equal archive
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()
