"""Every command against the function behind it: what a flag or an option class has, the function
takes, with the same default; what it takes besides is named here, and in its own words.
"""

import inspect
import re
from dataclasses import MISSING, dataclass, field, fields
from importlib import import_module

import pytest

import ambrose as amb
from ambrose import api
from ambrose.cli import main
from ambrose.cli.run_commands import OnTarget
from ambrose.code.targets import TARGETS
from ambrose.identification.methods import METHODS
from ambrose.judge.exploration import explore
from ambrose.options import AsItRuns, Exploring, Rejecting, Simulating, Verifying, option_of
from ambrose.synthesis.methods import methods

# where results go and how they are shown, the group of axes, which every command narrows alike
SHOWN = {"output", "report", "page", "docx", "table", "as_json", "details", "everything", "axes"}
GIVEN = inspect.Parameter.empty


@dataclass(frozen=True)
class Door:
    """The functions behind a command, "module:function" each; the classes of options that they take
    whole; renamed: flag -> parameter. What has no counterpart: flags, parameters.
    """

    places: tuple[str, ...]
    kinds: tuple[type, ...] = ()
    renamed: dict[str, str] = field(default_factory=dict)
    flags: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    def functions(self):
        for place in self.places:
            module, _, name = place.partition(":")
            yield getattr(import_module(f"ambrose.{module}"), name)

    def signature(self):
        """{parameter: its default} of all of them, those of the classes as well."""
        found = dict(
            (item.name, GIVEN if item.default is MISSING else item.default)
            for kind in self.kinds
            for item in fields(kind)
        )
        for function in self.functions():
            for name, item in inspect.signature(function).parameters.items():
                if item.kind is not item.VAR_KEYWORD and name != "progress":
                    found[name] = item.default
        return found


def door(*places, **rest):
    return Door(places, **rest)


SIGNALS = ("displacement", "drive", "reference", "voltage", "time")  # columns of a record
OF_ONE_AXIS = {name: "columns" for name in SIGNALS} | {"rate_hz": "sample_rate_hz"}
DOORS = {
    "accept": door("annexes.site.acceptance:accept"),
    "balance": door(
        "annexes.site.balancing:balance",
        "annexes.site.balancing_vectors:balance_amplitudes",
        renamed={"since": "before"},
        parameters=("pressure",),
    ),
    "bias": door("annexes.site.bias:identify_over_bias"),
    "calibrate": door("annexes.site.calibration:calibrate"),
    "campaign": door(
        "annexes.campaigns.run:run_plan",
        renamed={"engine": "make", "output": "directory"},
        flags=("pages",),
    ),
    "check": door("chain.check:facts", parameters=("file",)),
    "compare": door("annexes.rotordynamics.comparison:compare"),
    "export": door(
        "api:export",
        kinds=tuple(TARGETS.values()),
        renamed={"target": "to", "output": "directory"},
        flags=("axial",),
        parameters=("windup_time", "hold_samples"),
    ),
    "frf": door("annexes.site.frf:respond", renamed=dict.fromkeys(("from_hz", "to_hz"), "band")),
    "identify": door(
        "api:identify",
        "identification.pipeline:identify",
        kinds=tuple(METHODS.values()),
        flags=("compare",),
        parameters=(
            *("initial_state", "offset", "max_iterations", "weights", "period", "drift"),
            "provenance",
        ),
    ),
    "identify --generic": door(
        "identification.one_axis.identify:identify_generic", renamed=OF_ONE_AXIS, flags=("bias",)
    ),
    "landing": door(
        "annexes.touchdown.analysis:landing",
        renamed={"controller": "law", "source": "record"},
        parameters=("bending_modes",),
    ),
    "lateral": door(
        "annexes.rotordynamics.analysis:lateral",
        kinds=(AsItRuns,),
        renamed={"trip_rpm": "trip", "nominal": "tolerances"},
        flags=("beside", "data"),
    ),
    "magnet": door("annexes.magnets.analysis:magnet_sheets", flags=("tolerances",)),
    "map": door("judge.exploration:explore", kinds=(Exploring,)),
    "monitor": door(
        "annexes.scheduled.seal_watch:monitor",
        "annexes.scheduled.seal_watch:seal_monitor",
        renamed={"delay_samples": "computing_delay"}
        | dict.fromkeys(("current_gain", "stiffness", "amplifier"), "doubts"),
        flags=("code",),
        parameters=("point", "dt"),
    ),
    "new": door(
        "chain.new_machine:new_machine",
        renamed={"rate_hz": "rate"},
        flags=(
            *("file", "force", "load", "gap", "bias_current"),
            *("force_per_current", "negative_stiffness"),
        ),
    ),
    "record check": door("api:check_record", flags=(*SIGNALS, "rate_hz", "current", "travel")),
    "retune": door(
        "annexes.site.retuning:retune", renamed={"after": "accept_from", "output": "directory"}
    ),
    "seal": door("identification.seal.by_frequency:identify_by_frequency"),
    "simulate": door(
        "api:simulate",
        kinds=(OnTarget,),
        renamed={"path": "controller", "output": "path"},
        parameters=("every", "dt", "computing_delay"),
    ),
    "size": door(
        "annexes.sizing.least:size",
        "annexes.sizing.least:least",
        kinds=(AsItRuns,),
        renamed={"order": "method"},
        flags=("tolerance", "widths", "unverified", "machine_out"),
        parameters=("time_limit",),
    ),
    "study": door("api:study", renamed={"output": "directory"}),
    "synthesize": door("api:design", kinds=tuple(methods().values()), flags=("machine_file",)),
    "trade-off": door(
        "synthesis.trade_off:trade_off",
        kinds=(AsItRuns,),
        renamed=dict.fromkeys(("order", "structure"), "method"),
        parameters=("time_limit",),
    ),
    "verify": door(
        "api:verify",
        kinds=(Verifying,),
        renamed={"path": "controller"},
        parameters=("points", "tolerances", "informed"),
    ),
    "review": door(
        "annexes.dossier.review:review",
        renamed={"rotor": "machine"},
        flags=("speed", "bearings", "project", "revision", "author", "logo"),
    ),
}
# what they do stands with the command: files from files, lists, a server
WITHOUT = {"convert", "convert controller", "machines", "scenarios", "workbench"}


def test_every_command_has_its_door_here():
    assert set(main.commands) <= set(DOORS) | WITHOUT
    assert not WITHOUT & set(DOORS)


# an annex that is off the tree has taken its commands with it
@pytest.mark.parametrize("verb", [verb for verb in DOORS if verb in main.commands])
def test_flags_are_what_the_function_takes(verb):
    """verify's flags had one that the function did not take, and every call of it broke down."""
    known = DOORS[verb]
    signature, flags = known.signature(), {p.name: p for p in main.commands[verb].params}
    free = {*SHOWN, *known.flags} - set(known.renamed)
    lost = [name for name in flags if known.renamed.get(name, name) not in signature]
    assert [name for name in lost if name not in free] == []
    reached = {known.renamed.get(name, name) for name in flags if name not in lost}
    silent = set(signature) - reached - {"axes"}
    assert silent == set(known.parameters)
    told = (*known.functions(), *(base for kind in known.kinds for base in kind.__mro__))
    words = " ".join(item.__doc__ or "" for item in told)
    assert [name for name in known.parameters if not re.search(rf"\b{name}\b", words)] == []
    # what the command shows as its default is what the function takes for it
    stated = {
        name: flag.default
        for name, flag in flags.items()
        if isinstance(flag.default, int | float | str)
        and not flag.is_flag
        and known.renamed.get(name, name) == name in signature
        and signature[name] is not GIVEN
    }
    assert {name: signature[name] for name in stated} == stated


class Asked(Exception):
    """The options that reached their class."""


def asked(*given, **options):
    """In place of a class of options, or of ``choose``, which makes one of several."""
    raise Asked(given[3] if given else options)


OF_CLASSES = [
    ("judge.verdict.Verifying", Verifying, lambda m, c, o: api.verify(m, c, **o)),
    ("rig.trial.Simulating", Simulating, lambda m, c, o: api.simulate(m, c, **o)),
    ("judge.exploration.Exploring", Exploring, lambda m, c, o: explore(m, c, **o)),
    ("options.Rejecting", Rejecting, lambda m, c, o: api.design(m, "pid", **o)),
    *(
        ("synthesis.design.choose", kind, lambda m, c, o, name=name: api.design(m, name, **o))
        for name, kind in methods().items()
    ),
    *(
        (
            "code.pipeline.choose",
            kind,
            lambda m, c, o, name=name: api.export(c, "code", to=name, **o),
        )
        for name, kind in TARGETS.items()
    ),
    *(
        (
            "identification.pipeline.choose",
            kind,
            lambda m, c, o, name=name: api.identify(m, (), c, method=name, **o),
        )
        for name, kind in METHODS.items()
    ),
]


@pytest.mark.parametrize(
    ("place", "kind", "call"), OF_CLASSES, ids=lambda v: v.__name__ if isinstance(v, type) else ""
)
def test_every_field_of_a_class_is_taken_and_handed_on(place, kind, call, monkeypatch):
    """As it was given, and under its own name; left out, it is what the class takes for it."""
    machine = amb.load_machine("flywheel")
    controller = amb.design(machine, "pid").controller
    values = {
        item.name: item.default if option_of(item).choices else object()
        for item in fields(kind)
        if "Law" not in str(item.type)  # which the function reads first
    }
    monkeypatch.setattr(f"ambrose.{place}", asked)
    with pytest.raises(Asked) as found:
        call(machine, controller, values)
    assert found.value.args[0].items() >= values.items()
    with pytest.raises(Asked) as found:
        call(machine, controller, {})
    left, usual = found.value.args[0], {item.name: item.default for item in fields(kind)}
    assert {name: value for name, value in left.items() if usual.get(name, value) != value} == {}
