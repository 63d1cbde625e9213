"""Linear algebra in one thread: in the library and in the command line, counted."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ambrose as amb
from ambrose.cli import main
from ambrose.core.processes import VARIABLES, in_one_thread, one_thread


def counts():
    return {item["num_threads"] for item in threadpool_info() if item["user_api"] == "blas"}


@pytest.fixture
def two_threads(monkeypatch):
    """A program with two threads for linear algebra, on a computer with one processor, too."""
    import scipy.linalg  # noqa: F401

    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(2, user_api="blas"):
        yield


def test_one_thread_inside_and_the_callers_number_afterwards(two_threads):
    assert counts() == {2}
    with one_thread(), one_thread():
        assert counts() == {1}
    assert counts() == {2}
    with pytest.raises(ValueError, match="kept"):
        in_one_thread(lambda: (_ for _ in ()).throw(ValueError("kept")).__next__())()
    assert counts() == {2}


def test_threads_of_python_that_overlap_leave_the_number_as_it_was(two_threads):
    inside, leave = Event(), Event()

    def second():
        with one_thread():
            inside.set()
            assert leave.wait(20)

    with ThreadPoolExecutor(1) as pool:
        with one_thread():
            waiting = pool.submit(second)
            assert inside.wait(20) and counts() == {1}
        leave.set()
        waiting.result()
    assert counts() == {2}


def test_a_number_in_the_environment_is_kept(two_threads, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with one_thread():
        assert counts() == {2}


def test_the_library_computes_in_one_thread(two_threads):
    seen = []
    amb.design("seal-rig", "hinf", progress=lambda stage: seen.append(counts()))
    assert seen and all(found == {1} for found in seen)
    assert counts() == {2}


def test_a_campaign_leaves_the_environment_as_it_was(two_threads, tmp_path):
    from ambrose.annexes.campaigns.run import executors

    with executors("processes", 1):
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"  # which its workers inherit
    assert "OPENBLAS_NUM_THREADS" not in os.environ


def test_the_command_called_by_a_program_computes_in_one_thread(two_threads, monkeypatch):
    seen = []
    from ambrose.chain import check as plants

    monkeypatch.setattr(
        plants,
        "facts",
        lambda *given, facts=plants.facts: [seen.append(counts()), facts(*given)][1],
    )
    with pytest.raises(SystemExit):
        main(["check", "seal-rig", "--json"], standalone_mode=False)
    assert seen == [{1}]
    assert counts() == {2} and "OPENBLAS_NUM_THREADS" not in os.environ


_COUNTED = """
import json, pathlib, sys
sys.argv = ["ambrose", "synthesize", "seal-rig", "--method", "pid", "-o", sys.argv[1]]
try:
    from ambrose.__main__ import main
    main()
except SystemExit:
    pass
from threadpoolctl import threadpool_info
status = pathlib.Path("/proc/self/status")
words = status.read_text().split() if status.exists() else ["Threads:", "1"]
blas = sorted({item["num_threads"] for item in threadpool_info() if item["user_api"] == "blas"})
print(json.dumps([blas, int(words[words.index("Threads:") + 1])]), file=sys.stderr)
"""


def test_the_command_in_a_process_of_its_own_starts_no_thread(tmp_path):
    """Two threads a library were started before: numpy was loaded before the variable was set."""
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run(
        [sys.executable, "-c", _COUNTED, str(tmp_path / "pid.json")],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stderr.splitlines()[-1]) == [[1], 1]


def test_no_command_loads_numpy_before_it_runs():
    program = (
        "import ambrose.cli, sys; print([name for name in ('numpy', 'scipy', 'pydantic', 'pint') "
        "if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
