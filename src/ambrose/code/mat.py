"""A controller for MATLAB, Simulink and Octave: one struct in a MAT-file (version 5), and a script
that reads and checks it.

The struct holds the sampled controller as it runs, the continuous one it was made from, the block
(scaled states, limits, anti-windup), test vectors and what the loop was verified on. ``K = ss(c.A,
c.B, c.C, c.D, c.dt)`` is the controller in m and A.
"""

import io
import math
import re
from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import Any, cast

import numpy as np

from ambrose.code.block.block import ControlBlock, as_comment, render
from ambrose.code.block.run import Vectors, as_csv, vectors_of
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import block_facts
from ambrose.code.sampled import Deployment, ScheduledDeployment
from ambrose.core.checks import invalid
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import Status, Synthesis
from ambrose.version import __version__

FORMAT = "ambrose-controller-mat"
VERSION = 1  # of the struct's fields
_WORDS = """
break case catch classdef continue else elseif end for function global if otherwise parfor
persistent return spmd switch try while ans pi eps inf nan i j do until unwind_protect end_try_catch
endfunction endif endwhile endfor
"""  # MATLAB's keywords, Octave's, and names whose meaning everybody relies on
_RESERVED = frozenset(_WORDS.split())
_LONGEST_NAME = 63  # MATLAB's namelengthmax
_FIELD = re.compile(rf"[A-Za-z][A-Za-z0-9_]{{0,{_LONGEST_NAME - 1}}}")
_NONE = (0, 0)  # shape of MATLAB's empty matrix [], which stands for "there is none"


def generate_mat(
    block: ControlBlock | ScheduledBlock,
    deployment: Deployment | ScheduledDeployment,
    synthesis: Synthesis,
    provenance: Sequence[str] = (),
) -> dict[str, str | bytes]:
    """<name>.mat, <name>_load.m (not of a schedule) and <name>_vectors.csv.

    synthesis: where the controller comes from. provenance: the lines that other targets put into
    their headers. Raises InvalidInput.
    """
    if block.name.lower() in _RESERVED:
        raise invalid(
            "the name of the block",
            repr(block.name),
            "no word of MATLAB or Octave",
            "give another --name",
        )
    run, comments = vectors_of(block), [as_comment(line) for line in provenance]
    struct = content(block, deployment, synthesis, provenance, run)
    facts = {"provenance": comments, "continuous": deployment.source.dt is None}
    # the script is of one law
    load = {} if block.told else {"_load.m": render("load.m.j2", block_facts(block) | facts)}
    texts: dict[str, str | bytes] = {
        ".mat": _bytes({block.name: struct}),
        **load,
        "_vectors.csv": as_csv(block, run),
    }
    return {f"{block.name}{end}": text for end, text in texts.items()}


@singledispatch
def content(
    block: ControlBlock | ScheduledBlock,
    deployment: Any,
    synthesis: Synthesis,
    provenance: Sequence[str],
    run: Vectors,
) -> dict[str, Any]:
    """The struct's fields, by the kind of block."""
    K, source = deployment.controller, deployment.source
    return {
        **_head(K, block),
        **_matrices(K),
        "increment": deployment.increment,
        "continuous": {
            **_matrices(source),
            "inputs": _cells(source.inputs),
            "outputs": _cells(source.outputs),
        }
        if source.dt is None
        else np.zeros(_NONE),
        "limits": {"error": _column(block.error_limit), "current": _column(block.current_limit)},
        "block": _block(cast(ControlBlock, block)),
        **_tail(deployment, synthesis, provenance, run),
    }


@content.register
def _(
    block: ScheduledBlock,
    deployment: ScheduledDeployment,
    synthesis: Synthesis,
    provenance: Sequence[str],
    run: Vectors,
) -> dict[str, Any]:
    # A (n, n, k) and so on over the k values of ``scheduling.grid``, linear in between
    K = deployment.sampled
    source = deployment.source
    along = block.along
    limits = {"error": _column(block.error_limit), "current": _column(block.current_limit)}
    parts = {
        name: _pages(getattr(block, name))
        for name in ("increment", "B", "C", "D", "unwind", "steady", "pick")
    }
    return {
        **_head(K.systems[0], block),
        **_over(K),
        "scheduling": {
            "parameter": along.name,
            "unit": along.unit,
            "grid": _column(K.grid),
            "interpolation": "linear",
        },
        "increment": _pages(deployment.increments),
        "continuous": _over(source) if source.dt is None else np.zeros(_NONE),
        "limits": {**limits, along.name: block.told_limit, f"{along.name}_rate": block.rate_limit},
        "block": {
            **parts,
            "passes": float(block.passes),
            "hold_samples": float(block.hold_samples),
            "windup_time": block.windup_time,
        },
        **_tail(deployment, synthesis, provenance, run),
    }


def _pages(x: np.ndarray) -> np.ndarray:
    """(k, i, j) as MATLAB has it, (i, j, k)."""
    return np.moveaxis(np.asarray(x, float), 0, 2)


def _over(schedule: ScheduledSystem) -> dict[str, np.ndarray]:
    """A (n, n, k) to D of the k points of a schedule."""
    return {
        letter: _pages(np.array([getattr(system, letter) for system in schedule.systems]))
        for letter in "ABCD"
    }


def _head(K: StateSpace, block: ControlBlock | ScheduledBlock) -> dict[str, Any]:
    """Format, timing, signals, units and sign: the first fields of every struct."""
    return {
        "format": FORMAT,
        "version": float(VERSION),
        "dt": block.sample_time,
        "delay_samples": float(block.delay),
        "inputs": _cells(K.inputs),
        "outputs": _cells(K.outputs),
        "input_unit": "m",
        "output_unit": "A",
        "sign": "input = reference - displacement; a positive current pulls towards positive "
        "displacement",
    }


def _tail(
    deployment: Deployment | ScheduledDeployment,
    synthesis: Synthesis,
    provenance: Sequence[str],
    run: Vectors,
) -> dict[str, Any]:
    """Test vectors, method, certificate, verification and provenance: the last fields."""
    origin = synthesis.provenance
    parameter = {} if run.told is None else {run.parameters[0]: _column(run.told)}
    return {
        "vectors": {
            "errors": run.errors,
            "valid": run.valid.astype(float),
            **parameter,
            "currents": run.currents,
            "status": _column(run.status),
        },
        "method": synthesis.method,
        "status": str(synthesis.verdict),
        "gamma": float(synthesis.gamma),
        "certificate": _certificate(synthesis),
        "verified": deployment.verified,
        "verification": _verification(deployment),
        "provenance": {
            "package": "ambrose",
            "package_version": __version__,
            "machine": origin.machine or "",
            "machine_hash": origin.machine_hash or "",
            "date": origin.date,
            "lines": _cells(provenance),
        },
    }


def _matrices(system: StateSpace) -> dict[str, np.ndarray]:
    return {letter: np.asarray(getattr(system, letter), float) for letter in "ABCD"}


def _block(block: ControlBlock) -> dict[str, Any]:
    """What the generated code computes with, in scaled states; the formulas are those of
    block/block.py.
    """
    return {
        "increment": block.increment,
        "B": block.B,
        "C": block.C,
        "D": block.D,
        "unwind": block.unwind,
        "from_error": block.from_error,
        "from_output": block.from_output,
        "winding": float(block.winding),
        "hold_samples": float(block.hold_samples),
        "windup_time": block.windup_time,
    }


def _certificate(synthesis: Synthesis) -> Any:
    certificate = synthesis.certificate
    if synthesis.status is Status.UNCERTIFIED:
        return np.zeros(_NONE)
    return {
        "stable": certificate.stable,
        "spectral_abscissa": float(certificate.spectral_abscissa),
        "closed_loop_norm": float(certificate.closed_loop_norm),
        "fastest_pole": float(certificate.fastest_pole),
        "plant": certificate.plant,
        "margins": {_field(name): float(value) for name, value in certificate.margins.items()}
        or np.zeros(_NONE),
    }


def _verification(deployment: Deployment | ScheduledDeployment) -> Any:
    """One struct per operating point, and over the tolerances: stable, and every quantity with its
    value and limit.
    """
    checks = [*deployment.checks, *deployment.points, *deployment.box]
    if not checks:
        return np.zeros(_NONE)
    names = ("label", "stable", "quantity", "value", "unit", "limit")
    points = np.empty((len(checks), 1), [(name, object) for name in names])
    for i, point in enumerate(checks):
        limits = [math.nan if check.limit is None else check.limit for check in point.checks]
        points[i, 0] = (
            point.label,
            point.stable,
            _cells([check.title for check in point.checks]),
            _column([check.value for check in point.checks]),
            _cells([check.unit for check in point.checks]),
            _column(limits),
        )
    return points


def _field(name: str) -> str:
    """A name as a field of a struct: what is no letter or digit becomes _, and m_ goes before what
    does not begin with a letter.
    """
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    return (text if _FIELD.fullmatch(text) else f"m_{text}")[:_LONGEST_NAME]


def _cells(texts: Sequence[str]) -> np.ndarray:
    """A cell array (k, 1) of texts: savemat writes an array of objects as cells."""
    cells = np.empty((len(texts), 1), object)
    cells[:, 0] = list(texts)
    return cells


def _column(values: Any) -> np.ndarray:
    """A column (k, 1) of doubles."""
    return np.asarray(values, float).reshape(-1, 1)


def _bytes(variables: Mapping[str, Any]) -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(
        stream,
        dict(variables),
        format="5",
        do_compression=False,
        long_field_names=True,
        oned_as="column",
    )
    return stream.getvalue()
