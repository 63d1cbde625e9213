"""The controller bench: its rows are a [controller] table, what they show is what is saved."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

import ambrose as amb
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.screens import answer
from ambrose.annexes.workbench.screens.controllers import grips, named_section, opened
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.judge.campbell import ONCE
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.plants import full_plants, judge_stability
from ambrose.judge.result import Synthesis
from ambrose.law.loop import Timing, timing_of
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.part import Section

W = np.geomspace(1.0, 1e5, 200)  # [rad/s]
# one of every kind
SECTIONS = (
    Section("pid", 0.2, 3e-3, 0.05),
    Section(
        "notch", zero_frequency=900.0, zero_damping=0.02, pole_frequency=1000.0, pole_damping=0.3
    ),
    Section("phase-bump", frequency=500.0, phase=0.6, damping=0.3),
    Section("lead-lag", zero_frequency=200.0, pole_frequency=2000.0),
    Section("low-pass", frequency=9000.0, damping=0.6),
    Section("sos", numerator=(1e-7, 0.0, -2.0), denominator=(1e-6, 2e-3, 1.0)),
)


def independent(section, w):
    """The response (w,) of a filter, from its formula alone; no code of the package."""
    s = 1j * np.asarray(w)
    v = {key: getattr(section, key) for key in section.to_dict()}
    match section.kind:
        case "pid":
            T, eps = v.get("derivative_time", 0.0), v.get("derivative_filter") or 0.1
            return 1 + 1 / (v.get("integral_time", math.inf) * s) + T * s / (eps * T * s + 1)
        case "notch":
            z, p = s / v["zero_frequency"], s / v["pole_frequency"]
            return (z**2 + 2 * v["zero_damping"] * z + 1) / (p**2 + 2 * v["pole_damping"] * p + 1)
        case "phase-bump":
            t = v["damping"] * math.tan(v["phase"] / 2)
            r = t + math.hypot(1, t)  # r - 1/r = 2 t
            z, p = s * r / v["frequency"], s / r / v["frequency"]
            return (z**2 + 2 * v["damping"] * z + 1) / (p**2 + 2 * v["damping"] * p + 1)
        case "lead-lag":
            return (s / v["zero_frequency"] + 1) / (s / v["pole_frequency"] + 1)
        case "low-pass":
            p = s / v["frequency"]
            return 1 / (p**2 + 2 * v["damping"] * p + 1)
    return np.polyval(v["numerator"], s) / np.polyval(v["denominator"], s)


def of_channel(settings, channel, w):
    """The same of a chain."""
    (chain,) = (c for c in settings.channels if channel in c.names)
    return chain.gain * np.prod([independent(part, w) for part in chain.sections], axis=0)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    begin(made, "seal-rig")
    return made


def ask(project, action="", **given):
    told = answer(project, "controllers", action, {"width": 900, **given})
    return told, {block["key"]: block for block in told["blocks"]}


def turned(project, **values):
    """The document of the page with other values of the first channel."""
    document = ask(project)[1]["chains"]["document"]
    document["channel"][0] |= values
    return json.loads(json.dumps(document))


def test_what_is_shown_at_first_is_the_machine_file(project):
    _, blocks = ask(project)
    (chain,) = blocks["chains"]["document"]["channel"]
    assert list(chain["names"]) == list(load_machine("seal-rig").axes)
    assert (chain["gain"], chain["section"][0]["integral_time"]) == (18250.0, 0.2)
    (row,) = blocks["peaks"]["rows"]
    # the thesis' PID does not hold twice the pressure, which is said at once
    assert row[3]["text"].startswith("✗ unstable")
    assert "FAILED: the loop is unstable at twice nominal" in blocks["verdict"]["text"]
    assert {"size-0", "phase-0", "sensitivity", "loci", "pulse"} <= set(blocks)


def test_the_filters_of_every_bundled_machine_are_its_controller(tmp_path):
    """By formulas of the filters in this file; mixed by the package, whose own test that has."""
    for name in bundled_machines():
        machine = load_machine(name)
        if machine.reference is None or not machine.bearings:
            continue
        folder = Project(tmp_path / name)
        begin(folder, name)
        settings = opened(folder, machine)
        whole = frequency_response(pid_controller(machine.reference, machine), W).values
        again = frequency_response(pid_controller(settings, machine), W).values
        assert np.abs(again - whole).max() <= 1e-9 * np.abs(whole).max()
        if settings.coordinates == "axes":
            for i, axis in enumerate(machine.axes):
                expected = of_channel(settings, axis, W)
                turn = whole[:, i, i] / expected  # of sensors at another angle
                assert np.abs(turn - turn[0]).max() < 1e-9


def test_every_section_gets_its_name():
    rng = np.random.default_rng(5)
    kinds = set()
    for known in (item for item in SECTIONS if item.kind != "phase-bump"):
        for factor in (1.0, -3.0):
            s = rng.uniform(1, 9)  # coefficients may have any common factor
            if known.kind == "pid":  # over t s^2 + s
                t = known.derivative_filter * known.derivative_time
                a = [t, 1, 0]
                b = np.polyadd(
                    a, [known.derivative_time, t / known.integral_time, 1 / known.integral_time]
                )
            elif known.kind == "notch":
                b = [known.zero_frequency**-2, 2 * known.zero_damping / known.zero_frequency, 1]
                a = [known.pole_frequency**-2, 2 * known.pole_damping / known.pole_frequency, 1]
            elif known.kind == "lead-lag":
                b, a = [0, 1 / known.zero_frequency, 1], [0, 1 / known.pole_frequency, 1]
            elif known.kind == "low-pass":
                b, a = [0, 0, 1], [known.frequency**-2, 2 * known.damping / known.frequency, 1]
            else:
                b, a = known.numerator, known.denominator
            gain, section = named_section(
                *(s * factor * np.array(b, float)), *(s * np.array(a, float))
            )
            kinds.add(section.kind)
            _, expected = signal.freqs(factor * np.array(b, float), a, W)
            assert np.allclose(gain * independent(section, W), expected, rtol=1e-10)
    assert kinds == {"pid", "notch", "lead-lag", "low-pass", "sos"}
    assert named_section(0, 0, 6.0, 0, 0, 2.0) == (3.0, None)


def moved(section, terms, kx, ky, angle):
    """What static/editor.js makes of a filter whose handle moves."""
    new = {}
    for key, way, power in terms:
        v = getattr(section, key)
        new[key] = {
            "x": lambda v, power: v * kx**power,
            "y": lambda v, power: v * ky**power,
            "width": lambda v, power: math.sinh(math.asinh(v) + math.log(kx)),
            "phase": lambda v, power: v + angle,
            "scale": lambda v, power: tuple(c / kx ** (len(v) - 1 - i) for i, c in enumerate(v)),
        }[way](v, power)
    return replace(section, **new)


@pytest.mark.parametrize("section", SECTIONS, ids=lambda item: item.kind)
def test_a_filter_follows_its_handle(section):
    kx, ky, angle = 1.3, 0.6, 0.2
    found = list(grips(section))
    assert found
    for w, words, _, terms in found:
        new = moved(section, terms, kx, ky, angle)
        places = [at for at, also, *_ in grips(new) if also == words]
        assert places == [pytest.approx(kx * w, rel=1e-9)]  # the handle is where the hand is
        before, after = independent(section, [w])[0], independent(new, [kx * w])[0]
        if any(way == "phase" for _, way, _ in terms):
            assert np.angle(after) - np.angle(before) == pytest.approx(angle, abs=1e-9)
        if words == "corner and damping":
            assert abs(after) == pytest.approx(ky * abs(before), rel=1e-9)
        if words == "centre and depth":  # of the zeros; the poles' part stays as it was
            zeros = [abs(2 * item.zero_damping) for item in (section, new)]
            assert abs(after) / abs(before) == pytest.approx(zeros[1] / zeros[0], rel=1e-9)
            assert zeros[1] / zeros[0] == pytest.approx(ky)
        if words == "width":  # |w/w_p - w_p/w| = 2 d at the handle
            r = kx * w / new.pole_frequency
            assert r - 1 / r == pytest.approx(2 * new.pole_damping)


VENDOR = """channel, b, a, rate_hz, delay_samples, input, input_unit
{}"""
ROW = "{}, -6.048963 10.43659 -4.403955, 1 -0.41521 -0.040637, 40000, 1, displacement, um"


def test_a_vendors_table_is_edited_saved_and_verified(tmp_path):
    """Its filters, sampled by Tustin's map, are its own difference equation (scipy.signal)."""
    made = Project(tmp_path)
    begin(made, "turbomolecular-pump")
    machine = load_machine("turbomolecular-pump")
    rows = "\n".join(ROW.format(axis) for axis in machine.axes)
    made.path("controllers", "vendor.csv").write_text(VENDOR.format(rows))
    _, blocks = ask(made, "open", open="vendor.csv")
    document = blocks["chains"]["document"]
    (chain,) = document["channel"]
    assert list(chain["names"]) == list(machine.axes)
    settings = opened(made, machine, "vendor.csv")
    T = 1 / 40000
    w = np.geomspace(10, 0.98 * np.pi / T, 200)
    _, table = signal.freqz([-6.048963, 10.43659, -4.403955], [1, -0.41521, -0.040637], w * T)
    tustin = of_channel(settings, machine.axes[0], 2 / T * np.tan(w * T / 2))
    assert np.allclose(tustin, -1e6 * table, rtol=1e-9)
    # saved as it stands, with the rate and the delay that the table says and the machine does not
    told, _ = ask(made, "save", name="edited", chains=json.loads(json.dumps(document)))
    assert told["told"].startswith("controllers/edited.json is written: certified as stable")
    saved = read_controller(made.path("controllers", "edited.json"), machine)
    theirs = read_controller(made.path("controllers", "vendor.csv"), machine)
    timing = timing_of(machine, saved)
    assert replace(timing, source="") == Timing(T, 1, "")
    for plant in full_plants(machine):
        one, two = (judge_stability(plant, law, timing).abscissa for law in (saved, theirs))
        assert one == pytest.approx(two, rel=1e-5) and one < 0
    verified = amb.verify(machine, saved, points="full speed", tolerances=False)
    assert verified.points[0].stable
    # a notch more, and the file is another one
    document["channel"][0]["section"].append(SECTIONS[1].to_dict())
    ask(made, "save", name="notched", chains=json.loads(json.dumps(document)))
    K = read_controller(made.path("controllers", "notched.json")).controller
    one = frequency_response(K, W).values[:, 0, 0]
    assert np.allclose(one, of_channel(settings, machine.axes[0], W) * independent(SECTIONS[1], W))


def test_tilt_and_translate_have_a_chain_each(tmp_path):
    made = Project(tmp_path)
    begin(made, "turbomolecular-pump")
    machine = load_machine("turbomolecular-pump")
    names = ("translate_x", "translate_y", "tilt_x", "tilt_y")
    rows = "\n".join(
        ROW.format(name).replace("-6.048963", "-6.05" if "tilt" in name else "-6.048963")
        for name in names
    )
    made.path("controllers", "modal.csv").write_text(VENDOR.format(rows))
    settings = opened(made, machine, "modal.csv")
    assert settings.coordinates == "tilt-translate"
    assert [channel.names for channel in settings.channels] == [names[:2], names[2:]]
    _, blocks = ask(made, "open", open="modal.csv")
    assert {"size-0", "size-1", "phase-0", "phase-1"} <= set(blocks)
    assert "tilt_x" in blocks["size-1"]["title"].replace("tilt x", "tilt_x")


def test_a_controller_that_mixes_its_channels_is_refused_and_compared(project):
    axes = load_machine("seal-rig").axes
    D = 18250.0 * (np.eye(4) + 0.1 * np.arange(16).reshape(4, 4) / 16)
    full = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, 4)),
        np.zeros((4, 0)),
        D,
        [f"err_{a}" for a in axes],
        [f"u_{a}" for a in axes],
    )
    path = project.path("controllers", "mixed.json")
    write_controller(path, Synthesis(full), load_machine("seal-rig"))
    with pytest.raises(Refusal, match=r"mixed\.json is no chain of filters .* tick it to compare"):
        ask(project, "open", open="mixed.json")
    _, blocks = ask(project, "look", **{"with.mixed.json": True})
    assert [row[0]["text"] for row in blocks["peaks"]["rows"]] == ["the filters", "mixed.json"]
    path.unlink()


def test_a_machine_files_pid_that_mixes_is_not_taken_for_filters(tmp_path):
    """Gains of the axes behind tilt and translate: another PID is offered, and says so."""
    made = Project(tmp_path)
    begin(made, "seal-rig")
    text = made.machine.read_text()
    assert "[controller]\ngain = " in text
    head, _, rest = text.partition("[controller]\n")
    rest = rest.partition("\n")[2]
    gains = 'gain = [15000.0, 16000.0, 17000.0, 18000.0]\ncoordinates = "tilt-translate"'
    made.machine.write_text(f"{head}[controller]\n{gains}\n{rest}")
    _, blocks = ask(made)
    assert blocks["bench"]["fields"][0]["options"] == ["a PID to start from"]
    assert blocks["verdict"]["text"].startswith(("PASSED", "FAILED"))


def test_a_turned_number_moves_the_curves_and_is_saved(project):
    documents = [turned(project, gain=gain) for gain in (18250.0, 25000.0)]
    before, after = (ask(project, "look", chains=document)[1] for document in documents)
    for key in ("size-0", "sensitivity", "loci", "pulse"):
        assert before[key]["svg"] != after[key]["svg"]
    told, _ = ask(project, "save", chains=documents[1], name="mine")
    assert told["told"].startswith("controllers/mine.json is written")
    saved = read_controller(project.path("controllers", "mine.json"))
    machine = load_machine("seal-rig")
    design = amb.design(
        replace(machine, controller=replace(machine.controller, gain=(25000.0,))), "pid"
    )
    one, two = (frequency_response(law.controller, W).values for law in (saved, design))
    assert np.allclose(one, two, rtol=1e-9, atol=0)
    assert saved.status == design.status
    with pytest.raises(Refusal, match="exists already"):
        ask(project, "save", name="mine")
    with pytest.raises(Refusal) as refused:
        ask(project, "save", name="../mine")
    assert "name" in refused.value.content["fields"]


def test_what_is_saved_is_judged_as_a_designed_one_is(tmp_path):
    """At every operating point, and at the rate that others assume where nobody states one."""
    made = Project(tmp_path)
    begin(made, "turboexpander")
    told, _ = ask(made, "save", name="mine")
    assert "at all 6 operating points, but only as a continuous loop" in told["told"]
    saved = read_controller(made.path("controllers", "mine.json"))
    assert saved.missed and len(saved.certificate.envelope) == 6


def test_controllers_are_compared_at_every_point(project):
    for name in ("one", "two", "three", "four"):
        ask(project, "save", name=name)
    chosen = {"with.one.json": True, "with.as opened": True}
    _, blocks = ask(project, "look", chains=turned(project, gain=25000.0), **chosen)
    assert [row[0]["text"] for row in blocks["peaks"]["rows"]] == [
        "the filters",
        "as opened",
        "one.json",
    ]
    # dashed, at the stable points as well as at the one that is not, in the legend once
    assert blocks["size-0"]["svg"].count('stroke-dasharray="7,3"') >= 3
    assert blocks["size-0"]["svg"].count(">as opened, ") == 1
    with pytest.raises(InvalidInput, match="5 controllers at most"):
        more = {f"with.{name}.json": True for name in ("two", "three", "four")}
        ask(project, "look", **chosen, **more)
    assert json.dumps(blocks)


def test_an_unstable_loop_leaves_nothing_of_the_stable_one(project):
    """At no point stable: the open loop is drawn, and neither sensitivity nor pulse stays."""
    told, blocks = ask(project, "look", chains=turned(project, gain=10.0))
    assert blocks["verdict"]["text"].startswith(
        "FAILED: the loop is unstable at nominal pressure (+"
    )
    assert {"size-0", "phase-0", "loci"} <= set(blocks)
    assert {"sensitivity", "pulse"} <= set(told["gone"]) - set(blocks)


def test_the_verdict_of_other_values_does_not_stay(project):
    told, blocks = ask(project, "judge", chains=turned(project, gain=25000.0))
    assert "verdict-0" in blocks
    assert not told["whole"]
    assert "verdict-0" in ask(project, "look", chains=turned(project, gain=26000.0))[0]["gone"]


def test_a_machine_that_turns_has_its_campbell_diagram(tmp_path):
    turning = Project(tmp_path)
    begin(turning, "flywheel")
    buttons = [b["action"] for b in ask(turning)[1]["bench"]["buttons"]]
    assert "campbell" in buttons
    assert ONCE in ask(turning, "campbell")[1]["campbell"]["svg"]


@pytest.mark.parametrize("value", [math.nan, math.inf, "x", True, None, -1.0, {}])
def test_what_is_no_number_is_said_and_nothing_of_before_stays(project, value):
    told, blocks = ask(project, "look", chains=turned(project, gain=value))
    assert blocks["verdict"]["text"].startswith("FAILED: ") and "gain" in blocks["verdict"]["text"]
    assert {"size-0", "sensitivity", "peaks", "verdict-0"} <= set(told["gone"])
    with pytest.raises(InvalidInput, match="gain"):
        ask(project, "save", chains=turned(project, gain=value), name="never")
    assert "never.json" not in project.names("controllers")


@pytest.mark.parametrize("document", ["x", [], {"channel": 5}, {"channel": [{"names": ["Q"]}]}])
def test_what_is_no_table_is_refused(project, document):
    _, blocks = ask(project, "look", chains=document)
    assert blocks["verdict"]["text"].startswith("FAILED: ")
