"""Control of rotors on active magnetic bearings with destabilising seal forces:
help(ambrose.api).
"""

from __future__ import annotations

from importlib import import_module

from ambrose.registry import registered
from ambrose.version import __version__

# as type checkers understand it; typing itself is most of the time that this import takes
TYPE_CHECKING = False

# public name -> module[:name there]; imported on first use, so that ``import ambrose`` stays fast
_HOME = {
    **dict.fromkeys(
        (
            "assemble",
            "check_record",
            "design",
            "export",
            "identify",
            "identify_generic",
            "plot",
            "reduce",
            "simulate",
            "study",
            "verify",
        ),
        "api",
    ),
    **dict.fromkeys(("bundled_machines", "load_machine"), "machine.file.toml"),
    **dict.fromkeys(("read_record", "write_record"), "record.files"),
    **dict.fromkeys(("read_controller", "write_controller"), "judge.controller_file"),
    **dict.fromkeys(("bundled_scenarios", "load_scenario", "Scenario"), "rig.scenario"),
    **dict.fromkeys(("RealBlock", "ComplexBlock", "FullBlock", "GeneralizedPlant"), "core.lft"),
    **dict.fromkeys(
        ("AmbroseError", "InvalidInput", "NumericalFailure", "UnstableSystem"), "core.checks"
    ),
    "Machine": "machine.machine",
    "OperatingPoint": "machine.description",
    "save_machine": "machine.file.update",
    **dict.fromkeys(("machine_from_ross", "new_machine"), "chain.new_machine"),
    "Record": "record.record",
    "StateSpace": "core.statespace",
    "Plant": "model.plant",
    "Synthesis": "judge.result",
    "Verification": "judge.checks",
    "Trace": "rig.trace",
    "Identification": "identification.result",
    "RecordCheck": "identification.record_check",
    "GenericIdentification": "identification.one_axis.identify",
    **dict.fromkeys(("Tuned", "Pid", "Hinf", "Mu", "Polish"), "synthesis.methods"),
    **dict.fromkeys(("ClosedLoop", "Youla", "StaticLoads"), "identification.methods"),
    **dict.fromkeys(("C", "Mat", "Fmu", "St"), "code.targets"),
    "Study": "chain.study",
    "hinf_synthesis": "synthesis.hinf",
    "mu_synthesis": "synthesis.mu",
    "mu_bounds": "core.mu.bounds",
    "hinf_norm": "core.norms",
    "worst_case_gain": "core.worst_case",
    "frequency_response": "core.frequency",
    "time_response": "core.response:simulate",
    **dict.fromkeys(("connect", "poles", "select", "spectral_abscissa"), "core.statespace"),
    **dict.fromkeys(
        ("coprime_factors", "injection_gain", "observer_controller", "residual_system"),
        "core.realisation",
    ),
    "trade_off": "synthesis.trade_off",
    "minimal": "core.realisation",
    "delayed": "core.sampling",
    "lft": "core.lft",
    "mu_peak": "core.mu.bounds",
    "Tolerance": "machine.description",
    **dict.fromkeys(
        ("finite_element_rotor", "free_bending_frequencies", "mass_properties"),
        "model.effects.rotor",
    ),
    "closed_loop": "law.loop",
    "free_mode_reduction": "model.uncertainty",
    "perturbed": "model.uncertainty",
    "identify_residual": "identification.youla:identify_injected",
    "finite_response": "identification.youla",
    "run_up_steps": "rig.trial:steps",
    "with_performance_block": "law.design_problem",
    "performance_weight": "law.design_problem",
    **dict.fromkeys(("CompiledBlock", "read_law"), "code.c.compiled"),
    "simulate_on_target": "code.in_loop",
    # what the annexes of this installation add, such as ``accept``, ``campaign``, ``size``
    **{name: place.removeprefix("ambrose.") for name, place in registered("public").items()},
}

__all__ = ["__version__", *_HOME]  # noqa: PLE0604

if TYPE_CHECKING:
    from typing import Any

    from ambrose.annexes.campaigns.result import campaign as campaign
    from ambrose.annexes.scheduled.monitor import monitor as monitor
    from ambrose.api import (
        assemble as assemble,
        design as design,
        export as export,
        identify as identify,
        plot as plot,
        reduce as reduce,
        simulate as simulate,
        study as study,
        verify as verify,
    )


def __getattr__(name: str) -> Any:
    """Public names are imported on first use."""
    if name in _HOME:
        module, _, there = _HOME[name].partition(":")
        item = getattr(import_module(f"ambrose.{module}"), there or name)
        if not isinstance(item, type):
            # A function: its linear algebra runs in one thread (what reads and writes files has
            # none), wrong types are named, and it pickles as what it is called here.
            if not module.startswith(("machine.", "record.")):
                item = import_module("ambrose.core.processes").in_one_thread(item)
            item = import_module("ambrose.core.checks").checks_plain_types(item)
            item.__module__ = "ambrose"
            item.__name__ = name
            item.__qualname__ = name
        globals()[name] = item
        return item
    raise AttributeError(
        f"module 'ambrose' has no attribute {name!r}; dir(ambrose) lists what it has"
    )


def __dir__() -> list[str]:
    return sorted(__all__)
