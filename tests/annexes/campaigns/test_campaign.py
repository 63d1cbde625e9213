"""Campaigns: plans, keys, arrays against single cases, what survives a kill, results and
indices.
"""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.campaigns.plan import Times, assign, plan_of, subject
from ambrose.annexes.campaigns.result import main_effects, read_campaign
from ambrose.annexes.campaigns.run import (
    PEAK,
    ROWS,
    bases_of,
    checks_of,
    compute,
    executors,
    fixed_of,
    full_plant,
    rows_of,
    run_plan,
)
from ambrose.cli import main
from ambrose.judge.loop_response import loop_evaluator
from ambrose.synthesis import design
from coarse import coarse_file

HEAD = {
    "task": "screen",
    "machine": coarse_file("three-bearing-train"),
    "controller": "pid",
    "model": "reduced",
}
VARY = {
    "point.speed": {"from": "0 rpm", "to": "9000 rpm", "count": 2},
    "tolerance.seal.balance-piston.k": {"from": -1.0, "to": 1.0, "count": 3},
    "tolerance.bearing.*.negative_stiffness": [-1, 1],
}


@pytest.fixture(scope="module", autouse=True)
def designed_once():
    """The one controller of these plans, half a second each time; processes design their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(design, "design", cache(design.design))
        yield


def plan(head=None, vary=None, **options):
    return plan_of({"campaign": HEAD | (head or {}), "vary": vary or VARY, "options": options})


def computed(wanted, folder, **keywords):
    return run_plan(wanted, folder, make=lambda: ThreadPoolExecutor(1), **keywords)


def rows_in(folder):
    return {row["key"]: row for row in rows_of(folder / ROWS)}


def test_a_grid_has_every_combination_once_and_a_key_for_each():
    cases = list(plan().drawn())
    assert len(cases) == plan().size == 12
    assert len({case.key for case in cases}) == 12
    assert {case.by_path["point.speed"] for case in cases} == {"0.0 rpm", "9000.0 rpm"}


def test_keys_follow_contents_not_places(tmp_path):
    (tmp_path / "m.toml").write_text("one")
    document = {
        "campaign": {"task": "design", "machine": "m.toml"},
        "vary": {"point.speed": [1, 2]},
    }
    first = [case.key for case in plan_of(document, tmp_path).drawn()]
    (tmp_path / "m.toml").write_text("two")
    assert not set(first) & {case.key for case in plan_of(document, tmp_path).drawn()}
    (tmp_path / "m.toml").write_text("one")
    longer = document | {"vary": {"point.speed": [1, 2, 3]}}
    assert first == [case.key for case in plan_of(longer, tmp_path).drawn()][:2]


def test_a_latin_hypercube_visits_every_stratum_of_every_range():
    vary = {
        "point.speed": {"from": "0 Hz", "to": "10 Hz"},
        "point.seal_pressure": {"from": "1 bar", "to": "2 bar"},
    }
    cases = list(plan({"plan": "latin-hypercube", "cases": 10}, vary).drawn())
    speeds = sorted(float(case.by_path["point.speed"].removesuffix(" Hz")) for case in cases)
    assert [int(speed) for speed in speeds] == list(range(10))


def test_paths_reach_names_numbers_and_lists():
    document = {"bearing": [{"name": "A", "k": [1.0, "2 N/m"]}, {"name": "B", "k": "3 N/m"}]}
    assign(document, "bearing.*.k", Times(2.0), "machine")
    assign(document, "bearing.B.gap", "1 mm", "machine")
    assert document["bearing"] == [
        {"name": "A", "k": [2.0, "4.0 N/m"]},
        {"name": "B", "k": "6.0 N/m", "gap": "1 mm"},
    ]
    with pytest.raises(amb.InvalidInput, match="does not exist"):
        assign(document, "bearing.C.k", 1.0, "machine")
    with pytest.raises(amb.InvalidInput, match="not in the machine file"):
        assign(document, "bearing.A.gap", Times(2.0), "machine")


@pytest.mark.parametrize(
    ("head", "vary", "words"),
    [
        ({"task": "fly"}, VARY, "task is"),
        ({"plan": "random"}, VARY, "number of its cases"),
        ({}, {"bearing.gap": [1]}, "does not exist"),
        ({}, {"point.speed": {"from": "1 Hz", "to": "60 rpm", "count": 2}}, "same unit"),
        ({}, {"point.speed": {"from": "1 Hz", "to": "2 Hz"}}, "no count"),
        ({}, {"point.speed": {"from": 1, "to": 2, "count": 2, "times": True}}, "times = true"),
        ({"cases": True}, VARY, "whole number"),
        ({"task": "simulate"}, VARY, "needs a scenario"),
        ({}, {f"option.{name}": {"from": 1, "to": 200, "count": 200} for name in "abc"}, "at most"),
        (
            {},
            {"machine.shaft.*.od": {"from": 1, "to": 2, "count": 2, "times": "yes"}},
            "true or false",
        ),
        ({}, {"point.speed": {"values": [1, 2], "from": 1, "to": 2}}, "unknown key 'values'"),
        *(
            ({}, {path: given}, "must be finite numbers")
            for path in ("point.speed", "tolerance.*", "option.seed", "controller.gain")
            for number in (10**400, -(10**400), float("inf"), float("nan"))
            for given in ([1, number], {"from": number, "to": 1, "count": 2})
        ),
    ],
)
def test_wrong_plans_are_refused(head, vary, words):
    with pytest.raises(amb.InvalidInput, match=words):
        plan(head, vary)


def test_the_array_agrees_with_every_case_alone():
    """Oracle: the plant perturbed in its matrices, and its sensitivity at the frequency found and
    around it.
    """
    wanted = plan()
    bases, fixed = bases_of(wanted), fixed_of(wanted)
    cases = list(wanted.drawn())
    for case, row in list(zip(cases, compute("screen", cases, bases, fixed), strict=True))[::5]:
        item = subject(case, bases, fixed)
        assert row.failure == ""
        plant = full_plant(item)
        law = amb.StateSpace(item.controller.law)
        from ambrose.law.loop import match_controller, timing_of
        from ambrose.model.uncertainty import default_bending_modes, reduce

        late = timing_of(item.machine, item.controller).late(match_controller(law, plant))
        at = 2 * np.pi * row.values["sensitivity.output.at"]
        small = reduce(plant, default_bending_modes(plant))
        curve = loop_evaluator(small, late)(at * np.linspace(0.5, 2.0, 301)).output_sensitivity()
        peak = np.linalg.norm(curve, 2, axis=(1, 2)).max()
        assert row.values[PEAK] == pytest.approx(peak, rel=1e-9)  # 6e-14 as measured
        assert checks_of(item).stable == row.values["stable"]


def test_what_a_kill_leaves_is_gone_on_with_bit_for_bit(tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert computed(plan(), whole).computed == 12
    assert computed(plan(), cut, most=5).computed == 5
    text = (cut / ROWS).read_bytes()
    (cut / ROWS).write_bytes(text[:-20])  # a line half written
    done = computed(plan(), cut)
    assert (done.cases, done.computed) == (12, 8)
    assert rows_in(cut) == rows_in(whole)
    assert computed(plan(), cut).computed == 0


@pytest.mark.study
def test_every_task_has_its_row():
    head = {"machine": "seal-rig", "controller": "pid"}
    rows = {
        "verify": one_row("verify", head, {"point.speed": ["0 Hz"]}),
        "simulate": one_row(
            "simulate", head | {"scenario": "prbs"}, {"scenario.duration": ["0.3 s"]}
        ),
        "identify": one_row(
            "identify", head | {"scenario": "prbs"}, {"scenario.duration": ["0.6 s"]}
        ),
        "design": one_row(
            "design", {"machine": "seal-rig"}, {"point": ["nominal pressure"]}, method="pid"
        ),
    }
    assert rows["verify"].values["stable"] and rows["verify"].values[PEAK] > 1
    assert rows["simulate"].values["outcome"] == "completed"
    found = {
        name: value
        for name, value in rows["identify"].values.items()
        if name.endswith("seal.center.k")
    }
    assert found, rows["identify"].values
    assert rows["design"].values["stable"] and json.loads(rows["design"].files["controller.json"])


def one_row(task, head, vary, **options):
    wanted = plan_of({"campaign": {"task": task, **head}, "vary": vary, "options": options})
    (row,) = compute(task, list(wanted.drawn()), bases_of(wanted), fixed_of(wanted))
    assert not row.failure
    return row


def test_failures_are_rows_with_their_reason(tmp_path):
    wanted = plan(vary={"point.speed": ["100 Hz", "5 kg"], "controller.gain": [1.0]})
    done = computed(wanted, tmp_path)
    assert (done.computed, done.failed) == (2, 1)
    found = read_campaign(wanted, tmp_path)
    assert found.failures[0] == "" and "must be" in found.failures[1]
    assert len(found.worst_first) == 1


def test_results_as_dataset_and_table(tmp_path):
    xr = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    computed(plan(), tmp_path)
    found = read_campaign(plan(), tmp_path)
    found.write(tmp_path)
    with xr.open_dataset(tmp_path / "results.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {
            "point.speed": 2,
            "tolerance.seal.balance-piston.k": 3,
            "tolerance.bearing.all.negative_stiffness": 2,
        }
        assert data["point.speed"].attrs["units"] == "rpm"
        assert np.array_equal(data[PEAK].values.ravel(), found.values[PEAK])
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 13
    assert found.effects()["point.speed"] > 0.5


def test_indices_are_those_of_ishigami_and_homma_1990():
    x = np.random.default_rng(1).uniform(-np.pi, np.pi, (20_000, 3))
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    a, b = 7.0, 0.1
    first, second = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8
    total = 0.5 + a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18
    assert main_effects(x, y) == pytest.approx([first / total, second / total, 0.0], abs=0.012)


def test_indices_of_a_whole_grid_are_exact():
    x = np.stack(np.meshgrid(np.arange(3.0), np.arange(4.0), indexing="ij"), axis=-1).reshape(-1, 2)
    variances = 4 * np.arange(3.0).var(), np.arange(4.0).var()
    assert main_effects(x, 2 * x[:, 0] + x[:, 1], complete=True) == pytest.approx(
        np.array(variances) / sum(variances)
    )
    assert not main_effects(x, np.ones(12)).any()


PARENT = """
import os, time
from ambrose.annexes.campaigns.run import executors
with executors("processes", 1) as (make, _):
    with make() as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(3600)
"""


def test_a_worker_ends_with_a_parent_that_was_killed():
    command = [sys.executable, "-c", PARENT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert int(parent.stdout.readline()) != parent.pid
        parent.kill()
        # the pipe closes when the last process that may write to it is gone: the worker
        assert parent.communicate(timeout=300) == ("", None)


def test_a_process_pool_gives_the_same_and_survives_a_killed_worker(tmp_path):
    import multiprocessing

    killed = []

    def told(stage):
        if not killed and (children := multiprocessing.active_children()):
            os.kill(children[0].pid, signal.SIGKILL)
            killed.append(children[0].pid)

    with executors("processes", 1) as (make, workers):

        def make_and_kill():
            pool = make()
            if not killed:
                pool.submit(time.sleep, 0).result()
                told("")
            return pool

        run_plan(plan(), tmp_path / "pool", make=make_and_kill, workers=workers)
    assert killed
    computed(plan(), tmp_path / "here")
    assert rows_in(tmp_path / "pool") == rows_in(tmp_path / "here")


def test_dask_gives_the_same_and_survives_a_killed_worker(tmp_path, monkeypatch):
    """Two workers of a real local cluster; one is killed while it computes."""
    monkeypatch.setattr("ambrose.annexes.campaigns.run._EVERY", 0.0)  # told of the first block
    distributed = pytest.importorskip("distributed")
    wanted = plan(
        vary=VARY
        | {"machine.bearing.MID.bias_current": {"from": 0.9, "to": 1.1, "count": 6, "times": True}}
    )
    killed = []
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):

        def told(stage):
            if not killed and "of 72 cases" in stage:
                busy = [name for name, tasks in client.processing().items() if tasks]
                killed.append(
                    next(w.pid for w in cluster.workers.values() if w.worker_address in busy)
                )
                os.kill(killed[0], signal.SIGKILL)

        run_plan(wanted, tmp_path / "dask", make=client.get_executor, workers=2, progress=told)
    assert killed
    computed(wanted, tmp_path / "here")
    assert rows_in(tmp_path / "dask") == rows_in(tmp_path / "here")


def test_the_command(tmp_path):
    file = tmp_path / "plan.toml"
    file.write_text(
        f'[campaign]\ntask = "screen"\nmachine = \'{HEAD["machine"]}\'\ncontroller = "pid"\nmodel '
        '= "reduced"\n'
        '[vary]\n"tolerance.seal.balance-piston.k" = [-1, 1]\n'
    )
    words = ["campaign", str(file), "--workers", "1", "--pages", "1", "--json"]
    ended = CliRunner().invoke(main, words)
    assert ended.exit_code == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert (found["cases"], found["computed_now"], found["missing"]) == (2, 2, 0)
    page = (tmp_path / "plan" / "report.html").read_text()
    (case,) = (tmp_path / "plan" / "cases").glob("*.html")
    assert f'href="cases/{case.name}"' in page
    assert Path(tmp_path / "plan" / "table.csv").exists()


@pytest.mark.skipif(os.name == "nt", reason="an interrupt is sent as a signal")
def test_ctrl_c_keeps_what_is_done_and_the_front_door_goes_on(tmp_path):
    document = {
        "campaign": HEAD,
        "vary": VARY | {"tolerance.seal.balance-piston.k": {"from": -1.0, "to": 1.0, "count": 40}},
    }
    (tmp_path / "plan.json").write_text(json.dumps(document))
    code = (
        "import json, sys, ambrose as amb\n"
        "amb.campaign(json.load(open(sys.argv[1])), sys.argv[2], workers=1, progress=lambda text: "
        "print(text, flush=True))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "plan.json"), str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        deadline = time.monotonic() + 600
        while (
            not ((tmp_path / "out" / ROWS).exists() and (tmp_path / "out" / ROWS).stat().st_size)
            and run.poll() is None
        ):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=600)
    before = (tmp_path / "out" / ROWS).read_bytes()
    assert before
    again = amb.campaign(document, tmp_path / "out", workers=1)
    assert (tmp_path / "out" / ROWS).read_bytes().startswith(before)
    assert len(again.values[PEAK]) == 160


def test_ranges_are_counted_before_they_are_built():
    """Five ranges of a million values each are 6 GB as lists."""
    import tracemalloc

    many = {f"point.{name}": {"from": 0.0, "to": 1.0, "count": 1_000_000} for name in "abcde"}
    tracemalloc.start()
    with pytest.raises(amb.InvalidInput, match="at most 1000000"):
        plan(vary=many)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("head", "vary", "options", "words"),
    [
        (
            {},
            {"option.delay_sample": [1, 2]},
            {},
            'no option .delay_sample.; did you mean "delay_samples"',
        ),
        ({}, VARY, {"frobnicate": 1}, "no option 'frobnicate'; known: delay_samples, rate"),
        ({}, VARY, {"rate": "often"}, "option rate is .often., but must be a number or None"),
        (
            {},
            {"option.delay_samples": [1, 1.5]},
            {},
            "option delay_samples is 1.5, but must be a whole number",
        ),
        ({"task": "design"}, VARY, {"orders": 8}, 'did you mean "order"'),
        ({"task": "simulate", "scenario": "levitation"}, VARY, {"second": 1}, "no option 'second'"),
        (
            {"task": "identify", "scenario": "prbs"},
            VARY,
            {"repeats": "yes"},
            "must be True or False",
        ),
        (
            {},
            {"point.speed": ["5 kg", "6 kg"]},
            {},
            "none of 2 cases that were tried can be made ready: .*must be",
        ),
    ],
)
def test_what_no_case_can_use_is_refused_before_any_is_computed(
    tmp_path, head, vary, options, words
):
    with pytest.raises(amb.InvalidInput, match=words):
        computed(plan(head, vary, **options), tmp_path)
    assert not (tmp_path / ROWS).exists()


@pytest.mark.parametrize(
    "content",
    [
        b"a,b,c\n1,2,3\n",
        b"no newline at all",
        b"\x00\xff",
        b"[1]\n",
        b"null\n",
        b'"key"\n',
        b"[" * 100_000 + b"\n",
        b'{"key": "a"}\n',
        b'{"key": "a", "failure": "", "values": [1]}\n',
        b'{"key": "a", "failure": "", "values": {"x": [1]}}\n',
        b'{"key": "a", "failure": "", "values": {"x": 1' + b"0" * 400 + b"}}\n",
        b'{"key": "a", "failure": "", "values": {"sensitivity.output.max": "large"}}\n',
        b'{"key": "a", "failure": "", "values": {"stable": "yes"}}\n',
        b'{"key": "a", "failure": "", "values": {"outcome": 3}}\n',
        b'{"key": "a", "failure": "", "values": {"x": NaN}}\n',
        b'{"key": "a", "failure": "", "values": {"x": 1e999}}\n',
        *(
            b'{"key": "a", "failure": "", "values": {"%s": 1}}\n' % name
            for name in (b"", b" ", b"x ", b"a/b", b"a\\u0007", b"a\\n")
        ),
    ],
)
def test_a_foreign_file_of_rows_is_refused_and_kept(tmp_path, content):
    (tmp_path / ROWS).write_bytes(content)
    with pytest.raises(amb.InvalidInput, match="no row of a campaign; move the file away"):
        computed(plan(), tmp_path)
    assert (tmp_path / ROWS).read_bytes() == content


@pytest.mark.parametrize("name", ["failure", "key", "case", *VARY])
def test_a_result_in_the_name_of_a_column_is_refused(tmp_path, name):
    case = next(plan().drawn())
    row = {"key": case.key, "failure": "", "values": {name: 1.0}}
    (tmp_path / ROWS).write_text(json.dumps(row) + "\n")
    with pytest.raises(amb.InvalidInput, match="one of the plan's columns; move the file away"):
        read_campaign(plan(), tmp_path)


def test_what_stands_for_a_file_of_rows_and_is_none_is_refused(tmp_path):
    (tmp_path / ROWS).mkdir()
    with pytest.raises(amb.InvalidInput, match="is a directory"):
        computed(plan(), tmp_path)


class Dying(ThreadPoolExecutor):
    """Workers that die of the cases ``deadly``, as a process pool says it; the pool is then of no
    use.
    """

    def __init__(self, deadly):
        super().__init__(1)
        self.deadly = deadly

    def submit(self, function, task, block, *others):
        from concurrent.futures import Future
        from concurrent.futures.process import BrokenProcessPool

        if not self.deadly & {case.key for case in block}:
            return super().submit(function, task, block, *others)
        broken = Future()
        broken.set_exception(BrokenProcessPool("died"))
        return broken


def test_a_worker_that_dies_says_nothing_of_its_case(tmp_path):
    wanted = plan({"task": "verify"}, {"point.speed": {"from": "0 Hz", "to": "100 Hz", "count": 9}})
    deadly = {list(wanted.drawn())[8].key}
    done = run_plan(wanted, tmp_path, make=lambda: Dying(deadly))
    assert (done.computed, done.failed, done.lost) == (8, 0, 1)
    found = read_campaign(wanted, tmp_path)
    assert (found.missing, found.failed) == (1, 0)
    assert computed(wanted, tmp_path).computed == 1  # the next run has it


def test_workers_that_die_at_once_are_no_campaign(tmp_path):
    wanted = plan(
        {"task": "verify"}, {"point.speed": {"from": "0 Hz", "to": "100 Hz", "count": 100}}
    )
    with pytest.raises(amb.NumericalFailure, match=r"no case was computed: .* died 3 times"):
        run_plan(wanted, tmp_path, make=lambda: Dying({case.key for case in wanted.drawn()}))
    assert (tmp_path / ROWS).read_bytes() == b""


_SCRIPT = """import sys, ambrose as amb
found = amb.campaign({"campaign": HEAD, "vary": VARY}, sys.argv[1], workers=1, engine=sys.argv[2])
print(found.missing, found.failed, len(found.keys))
"""


@pytest.mark.parametrize("engine", ["processes", pytest.param("dask", marks=pytest.mark.study)])
def test_a_plain_script_needs_no_guard(tmp_path, engine):
    """Without ``if __name__ == "__main__"``: every case was recorded as failed, its worker having
    died.
    """
    if engine == "dask":
        pytest.importorskip("distributed")
    script = tmp_path / "script.py"
    script.write_text(_SCRIPT.replace("HEAD", repr(HEAD)).replace("VARY", repr(VARY)))
    command = [sys.executable, str(script), str(tmp_path / "out"), engine]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert ended.stdout.split() == ["0", "0", "12"], ended.stderr


def test_a_script_in_the_standard_input_computes_too(tmp_path):
    text = _SCRIPT.replace("HEAD", repr(HEAD)).replace("VARY", repr(VARY))
    command = [sys.executable, "-", str(tmp_path / "out"), "processes"]
    ended = subprocess.run(
        command, input=text, capture_output=True, text=True, check=False, timeout=300
    )
    assert ended.stdout.split() == ["0", "0", "12"], ended.stderr


def test_a_worker_that_imports_its_script_starts_no_campaign(monkeypatch):
    import multiprocessing

    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(amb.InvalidInput, match="if __name__"), executors("processes", 1):
        pass


@pytest.mark.parametrize(
    ("engine", "workers"),
    [("processes", 0), ("processes", -1), ("processes", "two"), (7, 1), ("mpi", 1)],
)
def test_wrong_engines_are_refused(engine, workers):
    with pytest.raises(amb.InvalidInput), executors(engine, workers):
        pass
