"""How the figures of the pages are made: a function per group, on the command line as a reader
would do it.

A function gives {name: number or text}. QUICK ones take seconds and are computed anew by the tests;
SLOW ones take minutes. A study that lies already in $AMBROSE_STUDIES/<machine>-study is read
instead of made again.
"""

import json
import os
import platform
import re
import tempfile
import time
from datetime import date
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from docs_build import ROOT

SHORT = {
    "tuned": "tuned",
    "PID": "pid",
    "H-infinity": "hinf",
    "mu": "mu",
    "mu, polished": "polish",
    "LPV": "lpv",
    "commissioned": "commissioned",
}
POINT = {"zero pressure": "zero", "nominal pressure": "nominal", "twice nominal pressure": "twice"}
QUANTITY = {
    "sensitivity.output.max": "sensitivity",
    "unbalance.orbit_0p": "orbit",
    "impulse.settling": "settling",
}
ROBUST = {
    "robust.sensitivity.worst": "worst",
    "robust.sensitivity.bound": "bound",
    "robust.stability.margin": "margin",
    "robust.stability.proved": "proved",
}


def ambrose(*arguments, folder=None):
    """What a command prints with --json. Raises RuntimeError with its message where it refuses."""
    return json.loads(run(*arguments, "--json", folder=folder).stdout)


def run(*arguments, folder=None):
    """A command run in this process, in a folder of its own unless one is given. Raises
    RuntimeError where it refuses.
    """
    from ambrose.cli import main

    before = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(folder or scratch)
        try:
            done = CliRunner().invoke(main, [str(argument) for argument in arguments])
        finally:
            os.chdir(before)
    if done.exit_code not in (0, 1) or (
        done.exception and not isinstance(done.exception, SystemExit)
    ):
        raise RuntimeError(
            f"ambrose {' '.join(map(str, arguments))}: {done.stderr or done.exception}"
        )
    return done


def check(machine):
    printed = ambrose("check", machine)
    bending = np.array(printed["bending_rad_s"]) / (2 * np.pi)
    poles = {
        f"pole{i}": f"{real:.1f} +- {imag:.1f}j"
        for i, (real, imag) in enumerate(printed["unstable_poles_rad_s"])
        if imag > 0
    }
    sizes = ("rotor_states", "plant_states", "reduced_rotor_states", "reduced_plant_states")
    return {
        "mass": printed["mass_kg"],
        **{f"bending{i}": float(value) for i, value in enumerate(bending, 1)},
        **{name: printed[name] for name in sizes},
        **poles,
    }


def synthesis(method):
    """Certificate of a design on the seal rig."""
    with tempfile.TemporaryDirectory() as folder:
        printed = ambrose(
            "synthesize", "seal-rig", "--method", method, "-o", "controller.json", folder=folder
        )
        states = len(
            json.loads((Path(folder) / "controller.json").read_text(encoding="utf-8"))["A"]
        )
    certificate = printed["certificate"]
    margins = {
        name: value for name, value in certificate["margins"].items() if isinstance(value, float)
    }
    return {
        "states": states,
        "fastest": certificate["fastest_pole"],
        "norm": certificate["closed_loop_norm"],
        **margins,
    }


def study(machine):
    """Every controller of a study: <controller>.<point>.<quantity>, <controller>.<worst, bound,
    margin, proved>, ...
    """
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(os.environ.get("AMBROSE_STUDIES", scratch)) / f"{machine}-study"
        if not (made / "checks.json").exists():
            ambrose("study", machine, "-o", made)
        result = json.loads((made / "checks.json").read_text(encoding="utf-8"))
        states = {
            path.stem.removeprefix("controller-"): json.loads(path.read_text(encoding="utf-8"))
            for path in made.glob("**/controller*.json")
        }
    figures = {}
    for title, controller in result["controllers"].items():
        name = SHORT[title]
        figures |= {f"{name}.{key}": value for key, value in of_controller(controller).items()}
        law = states.get(name, states.get("controller", {}) if name == "commissioned" else {})
        if law.get("A") and not law.get("scheduling"):
            figures[f"{name}.states"] = len(law["A"])
    commissioned = result.get("commissioned") or {}
    for checks in commissioned.get("sampled", []):
        if checks["label"] in POINT:
            figures[f"sampled.{POINT[checks['label']]}"] = value_of(
                checks, "sensitivity.output.max"
            )
    for title, loops in result.get("run_up", {}).items():
        name = SHORT.get(title, title)
        for loop, windows in loops.items():
            settling = [window["settling_s"] for window in windows]
            figures |= {
                f"run_up.{name}.{loop}.{end}": settling[at]
                for end, at in (("first", 0), ("last", -1))
            }
            figures[f"run_up.{name}.{loop}.longest"] = max(
                settling, key=lambda value: np.inf if value == "inf" else value
            )
    return figures


def of_controller(controller):
    figures = {"fastest": controller["certificate"]["fastest_pole"]}
    for checks in controller["points"]:
        point = POINT.get(checks["label"])
        if point:
            figures |= {
                f"{point}.{short}": value_of(checks, long) for long, short in QUANTITY.items()
            }
    for short in ("orbit", "settling"):
        values = [
            value
            for key, value in figures.items()
            if key.endswith(short) and not isinstance(value, str)
        ]
        figures |= {f"{short}": max(values)} if values else {}
    # around the first point that has tolerances
    robust = next(iter(controller["boxes"]), {"checks": []})
    return figures | {
        short: value_of(robust, long) for long, short in ROBUST.items() if has(robust, long)
    }


def has(checks, name):
    return any(check["name"] == name for check in checks["checks"])


def value_of(checks, name):
    """A quantity of a verification; a loop that does not hold the rotor has none."""
    value = next((check["value"] for check in checks["checks"] if check["name"] == name), "inf")
    return value if isinstance(value, int | float) else "unstable"


def sampled_designs(machine="seal-rig-k-only"):
    """Designs for the sampled loop: states and worst sensitivity at each pressure, as the header of
    the C code states it.
    """
    designs = {
        "mu": ["mu"],
        "mu_sampled": ["mu", "--rate-hz", "10000"],
        "polish": ["polish"],
        "polish_sampled": ["polish", "--rate-hz", "10000"],
        "loss": ["mu", "--rate-hz", "10000", "--loss", "5"],
    }
    figures = {}
    for name, options in designs.items():
        with tempfile.TemporaryDirectory() as folder:
            ambrose(
                "synthesize", machine, "--method", *options, "-o", "controller.json", folder=folder
            )
            law = json.loads((Path(folder) / "controller.json").read_text(encoding="utf-8"))
            ambrose("export", "controller.json", "--to", "c", "-o", "code", folder=folder)
            header = (Path(folder) / "code" / "controller.h").read_text(encoding="utf-8")
        figures[f"{name}.states"] = len(law["A"])
        for label, point in POINT.items():
            _, _, peak = header.partition(f"Verified   {label}: stable, sensitivity peak ")
            figures[f"{name}.{point}"] = float(peak.split("\n")[0].rstrip("."))
    return figures


TUNED = {  # name: machine and options
    "turboexpander": ("turboexpander", "--rate-hz", "10000"),
    "turboexpander_continuous": ("turboexpander",),
    "seal_rig": ("seal-rig", "--rate-hz", "10000"),
    "two_disc_rotor": ("two-disc-rotor",),
    "vertical_pump": ("vertical-pump",),
    "process_compressor": ("process-compressor",),
}


def tuned_designs():
    """docs/research/robust-control.md: tuned controllers, with the date and the processor on which the search went this way.

    States; gamma, the largest ratio of a requirement to its limit; sigma_max(S_o) at the worst operating point; seconds of
    processor time.
    """
    figures = {"date": date.today().isoformat(), "processor": processor()}
    for name, (machine, *options) in TUNED.items():
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            ambrose(
                "synthesize",
                machine,
                "--method",
                "tuned",
                *options,
                "-o",
                "controller.json",
                folder=folder,
            )
            seconds = time.process_time() - start
            law = json.loads((Path(folder) / "controller.json").read_text(encoding="utf-8"))
        figures |= {
            f"{name}.states": len(law["A"]),
            f"{name}.gamma": law["gamma"],
            f"{name}.sensitivity": law["certificate"]["closed_loop_norm"],
            f"{name}.seconds": round(seconds),
        }
    return figures


def processor():
    """The processor's name as the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def lowering():
    """docs/research/code.md: the worst sampled sensitivity at every order that --loss tries, as its progress shows it."""
    progress = run(
        "synthesize", "seal-rig-k-only", "--method", "mu", "--rate-hz", "10000", "--loss", "5"
    ).stderr
    return {
        f"{how}{order}": float(worst)
        for order, how, worst in re.findall(r"order (\d+), (\w+): ([\d.]+)", progress)
    }


def printed_controller():
    """docs/research/reproduction.md: how far our H-infinity controller is from the one that P5 prints, and where the rig rests with it.

    Largest singular value of the difference over that of the printed one, up to 100 Hz, at 200 and at 400 Hz; the largest
    displacement [m] at a sensor under the rotor's weight.
    """
    from benchmarks.published_p5 import published_p5_problem

    from ambrose import StateSpace, frequency_response, hinf_synthesis, load_machine, simulate

    print_ = json.loads(
        (ROOT / "tests" / "literature" / "published_hinf.json").read_text(encoding="utf-8")
    )
    A, B, C, D = (np.array(print_[letter], dtype=float) for letter in "ABCD")
    axes = print_["axes"]
    printed = StateSpace(A, B / 20e-6, C, D, [f"err_{a}" for a in axes], [f"u_{a}" for a in axes])
    ours = hinf_synthesis(published_p5_problem(uncertain=False)).controller
    hz = np.concatenate([np.geomspace(1, 100, 500), [200.0, 400.0]])
    found, wanted = (frequency_response(law, 2 * np.pi * hz).values for law in (ours, printed))
    error = np.linalg.norm(found - wanted, 2, axis=(1, 2)) / np.linalg.norm(wanted, 2, axis=(1, 2))
    record = simulate(load_machine("seal-rig-k-only"), printed, "impulse-orthogonal").record
    rest = max(abs(record[f"y_{axis}"][0]) for axis in axes)
    return {"to100": error[:-2].max(), "at200": error[-2], "at400": error[-1], "rest": float(rest)}


def gas_seal():
    """docs/research/models.md: the hole-pattern seal of the thesis, its coefficients and what the rational fit leaves."""
    from ambrose.model.effects.bulkflow import Friction, SealCondition, SealGeometry, air, bulk_flow

    seal = SealGeometry(
        length=0.0857,
        diameter=0.11474,
        inlet_clearance=0.2115e-3,
        exit_clearance=0.2102e-3,
        hole_depth=3.3e-3,
        hole_area_ratio=0.684,
        stator_friction=Friction(0.02, 0.0),
    )
    condition = SealCondition(
        inlet_pressure=70e5,
        exit_pressure=31.5e5,
        temperature=290.55,
        speed=20200 * np.pi / 30,
        gas=air(290.55),
    )
    hz = [20, 140, 300]
    omega = 2 * np.pi * np.array(hz)
    flow = bulk_flow(seal, condition, omega)
    figures = {"leakage": flow.leakage}
    for i, f in enumerate(hz):
        K, k, C, c = (float(getattr(flow, letter)[i]) for letter in "KkCc")
        figures |= {f"K{f}": K, f"k{f}": k, f"C{f}": C, f"c{f}": c}
        figures |= {f"stiffness{f}": K + c * omega[i], f"damping{f}": C - k / omega[i]}
    return figures


QUICK = {
    "check": lambda: check("seal-rig"),
    "turboexpander": lambda: check("turboexpander"),
    "pid": lambda: synthesis("pid"),
    "hinf": lambda: synthesis("hinf"),
    "gas_seal": gas_seal,
}
SLOW = {
    "study": lambda: study("seal-rig"),
    "study_turboexpander": lambda: study("turboexpander"),
    "sampled": sampled_designs,
    "tuned": tuned_designs,
    "lowering": lowering,
    "printed": printed_controller,
}
