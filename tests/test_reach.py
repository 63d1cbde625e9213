"""Which slow tests a change reaches: by imports, names, registrations and data; and where that
cannot be told, why all of them run.
"""

import subprocess

import pytest

import reach
from needs import needs

git = needs("git")
HERE = reach.TESTS


@pytest.fixture
def checkout(tmp_path):
    """A repository with a commit on main, and a function that runs git in it."""

    def run(*arguments):
        own = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
        command = ["git", "-C", str(tmp_path), *own, *arguments]
        subprocess.run(command, check=True, capture_output=True)

    run("init", "-b", "main")
    (tmp_path / "a.py").write_text("one = 1\n")
    run("add", ".")
    run("commit", "-m", "first")
    return tmp_path, run


@git
def test_what_differs_from_the_main_branch(checkout):
    root, run = checkout
    run("checkout", "-b", "work")
    assert reach.changed_files(root) == set()
    (root / "b.py").write_text("two = 2\n")
    run("mv", "a.py", "c.py")
    run("add", ".")
    run("commit", "-m", "second")
    assert reach.changed_files(root) == {"a.py", "b.py", "c.py"}
    assert reach.changed_files(root, base="HEAD") == set()
    run("checkout", "main")
    run("update-ref", "refs/remotes/origin/main", "work~1")
    run("merge", "work")
    assert reach.changed_files(root) == {"a.py", "b.py", "c.py"}


@git
def test_all_run_where_it_cannot_be_told(checkout, tmp_path_factory, monkeypatch):
    root, run = checkout
    with pytest.raises(reach.Unknown, match="no main branch to compare with"):
        reach.changed_files(root)
    (root / "new.py").write_text("")
    with pytest.raises(reach.Unknown, match="1 files are not committed"):
        reach.changed_files(root)
    (root / "new.py").unlink()
    run("commit", "--allow-empty", "-m", "second")
    shallow = tmp_path_factory.mktemp("shallow")
    run("clone", "--depth", "1", f"file://{root}", str(shallow))
    with pytest.raises(reach.Unknown, match="the clone is shallow"):
        reach.changed_files(shallow)
    with pytest.raises(reach.Unknown, match="no git checkout"):
        reach.changed_files(tmp_path_factory.mktemp("none"))
    monkeypatch.setenv("PATH", "")
    with pytest.raises(reach.Unknown, match="git is not installed"):
        reach.changed_files(root)


@pytest.mark.parametrize(
    ("test", "changed", "meant"),
    [
        ("core/test_lft.py", "src/ambrose/core/statespace.py", True),
        ("core/test_lft.py", "src/ambrose/report/page.py", False),
        ("core/test_lft.py", "src/ambrose/registry.py", True),
        ("core/test_lft.py", "docs/theory/linear-model.md", False),
        ("core/test_norms.py", "tests/random_systems.py", True),
        ("core/test_lft.py", "tests/random_plants.py", False),
        ("core/test_lft.py", "pyproject.toml", True),
        # a public name, and what it asks the registry for
        ("synthesis/fixed_order/test_tuning.py", "src/ambrose/judge/verdict.py", True),
        (
            "synthesis/fixed_order/test_tuning.py",
            "src/ambrose/annexes/scheduled/lpv/method.py",
            True,
        ),
        ("synthesis/fixed_order/test_tuning.py", "src/ambrose/annexes/touchdown/drop.py", False),
        ("synthesis/fixed_order/test_tuning.py", "src/ambrose/machines/seal-rig.toml", True),
        (
            "synthesis/fixed_order/test_tuning.py",
            "tests/synthesis/fixed_order/flexible_compressor.toml",
            True,
        ),
        # the command line may do anything
        ("test_cli.py", "src/ambrose/annexes/touchdown/drop.py", True),
        # a benchmark that a test imports
        ("literature/test_p2.py", "benchmarks/campaign_p2.py", True),
        ("docs/test_links.py", "docs/theory/linear-model.md", True),
    ],
)
def test_what_a_change_reaches(test, changed, meant):
    assert (reach.ROOT / changed).exists()
    assert reach.reached(HERE / test, {changed}) is meant


def test_no_slow_test_is_unknown():
    """A file that was renamed takes its durations along (make durations)."""
    assert {
        n.split("::")[0] for n in reach.durations() if not (reach.ROOT / n.split("::")[0]).exists()
    } == set()


def test_quick_ones_always_run_and_slow_ones_by_what_they_reach(monkeypatch):
    name = "tests/core/test_lft.py"
    slow, quick = f"{name}::test_slow", f"{name}::test_quick"
    monkeypatch.setattr(reach, "durations", lambda: {slow: reach.SLOW + 1, quick: reach.SLOW / 2})
    assert reach.left_out({"src/ambrose/report/page.py"}) == [slow]
    assert reach.left_out({"src/ambrose/core/lft.py"}) == []
    assert reach.left_out({"src/ambrose/core/lft.py"}, quick=True) == [slow]
    assert reach.left_out(set()) == [slow]
