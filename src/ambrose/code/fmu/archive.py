"""An FMU (FMI 2.0 or 3.0, co-simulation) around the generated C: sources, and a binary for this
computer.

One communication step is a whole number of samples. The computing delay of the design is inside: at
a communication point the outputs are the currents that reach the amplifiers there, so the FMU is
connected to a model of the plant without any delay.
"""

from __future__ import annotations

import html
import io
import platform
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

from ambrose.code.all_axes import AllAxes, all_axes_files
from ambrose.code.block.names import check_identifier
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import Arithmetic, block_facts, generate
from ambrose.code.c.compiler import COMPILERS, build_library, build_probe, find_compiler
from ambrose.code.c.run import generate_run
from ambrose.code.fmu.description import (
    AnyLaw,
    Version,
    axial_of,
    base_of,
    blocks_of,
    build_description,
    model_description,
    radial_of,
    references,
    sources,
    transfers,
    variables,
)
from ambrose.code.rendering import render
from ambrose.code.synchronous import RunUnit
from ambrose.core.checks import InvalidInput, invalid

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
    law: AnyLaw,
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
        f"{base_of(law).name}_fmi{v[0]}.fmu": generate_fmu(
            law, v, arithmetic, provenance, sources_only=sources_only
        )
        for v in get_args(Version)
    }


def generate_fmu(
    law: AnyLaw,
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
        law = _single(law)
    block, code = base_of(law), generate_sources(law, version, arithmetic, provenance)
    token = "{" + str(uuid.uuid5(_SPACE, "\n".join(code.values()))) + "}"
    code[f"fmi{version[0]}.c"] = code[f"fmi{version[0]}.c"].replace("TOKEN", token)
    text = (
        f"Controller of {sum(len(item.inputs) for item in blocks_of(law))} errors to "
        f"{sum(len(item.outputs) for item in blocks_of(law))} currents, sampled at "
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


def _single(law: AnyLaw) -> AnyLaw:
    """With the controller's tables in single precision."""
    if isinstance(law, AllAxes):
        return AllAxes(_single(law.radial), law.axial.single())  # type: ignore[arg-type]
    if isinstance(law, RunUnit):
        return replace(law, base=law.base.single())
    return law.single()


def generate_sources(
    law: AnyLaw, version: Version, arithmetic: Arithmetic, provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The C of an FMU by name; in fmi2.c or fmi3.c the word TOKEN stands for the token."""
    block, axial = base_of(law), axial_of(law)
    radial = radial_of(law)
    beside = isinstance(radial, RunUnit)
    if isinstance(radial, RunUnit):
        written = generate_run(radial, arithmetic, provenance)
    else:
        written = generate(radial, arithmetic, provenance)
    if axial is not None:
        written |= generate(axial, arithmetic, provenance)
        written |= all_axes_files(radial, axial, arithmetic)
    name, sync = block.name, f"{block.name.upper()}_SYNC"
    end = "_run" if beside else ""
    whole = end if axial is None else "_axes"
    facts = {
        **block_facts(block),
        "transfers": transfers(law),
        "fixed": arithmetic.startswith("fixed"),
        "token": "TOKEN",
        "references": references(law).items(),
        "beside": beside,
        "axial": "" if axial is None else axial.name,
        "error_lsb": _counts(law, "inputs"),
        "current_lsb": _counts(law, "outputs"),
        "files": " ".join(sources(law, version)),
        "header": f"{name}{whole}.h",
        # the unit that is stepped, and what it is told besides: the pulse, and what the caller sees
        "unit": f"{name}{whole or '_block'}",
        "call": f"{name}{whole}",
        "size": "" if axial is None else "_AXES",
        "faults": "faults" if axial is None else "radial.faults",
        "pulse": "memory_pulse(m), " if beside else "",
        "marks": f"(m->contact ? {sync}_CONTACT : 0u) | (m->blocks_off ? {sync}_DISABLED : 0u), "
        if beside
        else "",
        "scheduled": isinstance(block, ScheduledBlock),
        "parameter": block.along.name if isinstance(block, ScheduledBlock) else "",
    }
    wrapper = f"fmi{version[0]}.c"
    return {
        **{file: written[file] for file in _files(law)},
        f"{block.name}_fmu.h": render("fmu_memory.h.j2", facts),
        wrapper: render(f"{wrapper}.j2", facts),
    }


def _counts(law: AnyLaw, side: str) -> str:
    """The names of what one count is worth, of all errors or currents."""
    return ", ".join(
        f"{block.name.upper()}_{name.upper()}_LSB"
        for block in blocks_of(law)
        for name in getattr(block, side)
    )


def _files(law: AnyLaw) -> tuple[str, ...]:
    """The controller's files that are compiled, or included."""
    name, axial = base_of(law).name, axial_of(law)
    ends = ("", "_sync", "_run") if isinstance(radial_of(law), RunUnit) else ("",)
    stems = [f"{name}{end}" for end in ends]
    if axial is not None:
        stems += [axial.name, f"{name}_axes"]
    return tuple(f"{stem}.{kind}" for stem in stems for kind in "hc")


def _check_names(law: AnyLaw) -> None:
    """The variables' names differ from each other: a signal may not be called like a flag of the
    FMU.
    """
    block, names = base_of(law), [v.name for v in variables(law)]
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


def _compiled(law: AnyLaw, version: Version, code: Mapping[str, str]) -> bytes:
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


def _page(law: AnyLaw, text: str, provenance: Sequence[str]) -> str:
    block = base_of(law)
    late = "at once" if block.delay == 0 else f"{block.delay} sample(s) after the errors were set"
    step = "one sample," if isinstance(radial_of(law), RunUnit) else "a whole multiple of"
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
