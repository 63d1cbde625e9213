"""Every operation on files fails in turn, or is where the process is killed: what stands there is
old or new, whole.

On Linux this is done below Python, to every system call of every way of writing; elsewhere to the
calls of ``os``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import INTERRUPTED, claimed, set_aside, write_files, write_text
from needs import lacking

TESTS = Path(__file__).parents[1]
HOLD = """
import sys
from ambrose.machine.ordinary_file import claimed
with claimed(sys.argv[1], "file"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(
    scope="module",
    params=[("stream", "folder"), pytest.param((), id="all")],
)
def rows(request, tmp_path_factory):
    """(kind, mode, operation, end, state) of every fault; of these kinds every third kill alone, in
    seconds.
    """
    if not sys.platform.startswith("linux"):
        pytest.skip("no Linux: system calls are intercepted there")
    if lacking("cc"):
        pytest.skip(lacking("cc"))
    folder = tmp_path_factory.mktemp("faults")
    library = folder / "faults.so"
    built = subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", library, TESTS / "faults.c", "-ldl"],
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode:
        pytest.skip(f"no C library that is known: {built.stderr[:200]}")
    done = subprocess.run(
        [sys.executable, TESTS / "fault_driver.py", folder, *request.param],
        env={**os.environ, "LD_PRELOAD": str(library)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return [tuple(line.split("\t")) for line in done.stdout.splitlines()]


def test_every_kind_was_failed_at_many_operations(rows):
    counts = Counter((kind, mode) for kind, mode, *_ in rows)
    least = {"text": 5, "csv": 5, "hdf5": 12, "stream": 30, "new folder": 12, "folder": 25}
    assert (kinds := {kind for kind, _ in counts}) in ({"stream", "folder"}, set(least))
    assert all(
        count > least[kind] / (3 if len(kinds) == 2 else 1) for (kind, _), count in counts.items()
    )


def test_old_or_new_is_there_whole(rows):
    """Of a stream killed at its end all samples were lost; a folder was left mixed; a full disk
    ended in a signal.
    """
    whole = {
        "text": "old new",
        "csv": "old new",
        "hdf5": "old new",
        "new folder": "none new",
        "folder": "old new marked",
    }
    for row in rows:
        kind, *_, state = row
        if kind == "stream":
            assert state in {"new", "old"} or state.removeprefix("old, ").isdigit(), row
        else:
            assert state in whole[kind].split(), row


def test_the_end_is_told_truly(rows):
    """Success where it is new, else one sentence: no other exception, and no signal but the one
    that was sent.
    """
    for row in rows:
        _, mode, _, ended, state = row
        assert ended in {"signal 9"} if mode == "killed" else ended in {"done", "InvalidInput"}, row
        if ended == "done":
            assert state == "new", row


def test_a_single_failure_leaves_no_mixed_folder(rows):
    """What cannot be replaced puts back what was; only a kill, or a disk that fails for good,
    leaves the mark.
    """
    for row in rows:
        kind, mode, _, _, state = row
        if kind == "folder" and mode == "once":
            assert state in {"old", "new"}, row
    assert any(row[0] == "folder" and row[-1] == "marked" for row in rows)


def test_a_stream_loses_no_sample_that_was_written(rows):
    counts = [
        int(state.removeprefix("old, "))
        if state.startswith("old, ")
        else 0
        if state == "old"
        else 99
        for kind, mode, _, _, state in rows
        if (kind, mode) == ("stream", "killed")
    ]
    assert counts[0] == 0 and {8, 16, 20} <= set(counts) and counts[-1] == 99
    assert all(before <= after for before, after in pairwise(counts))


class Dead(BaseException):
    """From here on nothing is done any more, as after a kill."""


@pytest.fixture
def dying(monkeypatch):
    """A call that lets the n-th of these operations, and all that follow, raise; -1: none."""
    seen = {"count": 0, "at": -1}

    def armed(real):
        def call(*arguments, **options):
            seen["count"] += 1
            if 0 <= seen["at"] < seen["count"]:
                raise Dead
            return real(*arguments, **options)

        return call

    for name in ("replace", "fsync", "mkdir", "unlink", "rmdir", "open"):
        monkeypatch.setattr(os, name, armed(getattr(os, name)))

    def die_at(n):
        seen.update(count=0, at=n)

    return die_at


def test_a_process_that_dies_at_any_call_leaves_old_or_new(dying, tmp_path):
    names = ("a", "b", "c")
    for n in range(60):
        folder = tmp_path / str(n)
        dying(-1)
        write_files(folder, dict.fromkeys(names[:2], "old"))
        write_text(folder / "text", "old", "text")
        dying(n)
        try:
            write_files(folder, dict.fromkeys(names, "new"))
            write_text(folder / "text", "new", "text")
            break
        except Dead:
            dying(-1)
        marked = (folder / INTERRUPTED).exists()
        write_files(folder, {"other": ""})  # finishes what is marked
        texts = [
            (folder / name).read_text() if (folder / name).exists() else None for name in names
        ]
        assert texts in (["old", "old", None], ["new"] * 3), (n, texts)
        assert texts[0] == "new" or not marked
        assert (folder / "text").read_text() in {"old", "new"}
    assert n > 20
    dying(-1)


def test_a_folder_of_the_users_that_is_called_so_is_left_alone(tmp_path):
    (tmp_path / INTERRUPTED).mkdir()
    (tmp_path / INTERRUPTED / "mine").write_text("mine")
    with pytest.raises(InvalidInput, match="interrupted-write"):
        write_files(tmp_path, {"a": "new"})
    assert (tmp_path / INTERRUPTED / "mine").read_text() == "mine" and not (tmp_path / "a").exists()


@pytest.mark.skipif(os.name != "posix", reason="umask")
def test_a_new_folder_follows_the_umask(tmp_path):
    """It was open to everybody."""
    before = os.umask(0o077)
    try:
        write_files(tmp_path / "code", {"a": ""})
    finally:
        os.umask(before)
    assert (tmp_path / "code").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_the_second_run_is_refused_until_the_first_is_killed(tmp_path, kind):
    place = tmp_path / "place"
    if kind == "folder":
        place.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, place],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as first:
        assert first.stdout.readline() == "held\n"
        with pytest.raises(InvalidInput, match="another run is writing"), claimed(place, kind):
            pass
        with (
            pytest.raises(InvalidInput, match="another run is writing"),
            claimed(tmp_path / "." / "x" / ".." / "place", kind),
        ):
            pass
        first.kill()
        first.wait()
        assert (tmp_path / ".place.lock").exists()
        with claimed(place, kind):
            assert (tmp_path / ".place.lock").exists()
    assert not (tmp_path / ".place.lock").exists()


def test_a_lock_file_that_anybody_left_is_no_lock(tmp_path):
    (tmp_path / ".place.lock").write_text("12345")
    with claimed(tmp_path / "place", "file"):
        pass


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    with (
        pytest.raises(InvalidInput, match="cannot write the file"),
        claimed(tmp_path / "none" / "place", "file"),
    ):
        pass


def test_what_is_set_aside_replaces_what_was_so_before(tmp_path):
    for text in ("first", "second"):
        (tmp_path / "report.html").write_text(text)
        (tmp_path / "code").mkdir()
        (tmp_path / "code" / text).write_text("")
        for name in ("report.html", "code", "absent"):
            set_aside(tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "earlier-code",
        "earlier-report.html",
    ]
    assert (tmp_path / "earlier-report.html").read_text() == "second"
    assert [path.name for path in (tmp_path / "earlier-code").iterdir()] == ["second"]


@pytest.mark.parametrize("failing", [1, 3, 4])
def test_a_process_that_dies_while_it_puts_files_back_leaves_old_or_new(
    tmp_path, monkeypatch, failing
):
    """One file cannot be replaced, and at every step of the undoing the process dies."""
    real = os.replace
    for last in range(12):
        folder, seen = tmp_path / f"{last}", {"replaced": 0, "undoing": 0}
        write_files(folder, dict.fromkeys("abc", "old"))

        def replace(source, target, folder=folder, seen=seen, last=last):
            if seen["undoing"]:
                seen["undoing"] += 1
                if seen["undoing"] > last + 1:
                    raise Dead
            elif Path(target).parent == folder and Path(source).parent.name == "new":
                seen["replaced"] += 1
                if seen["replaced"] == failing:
                    seen["undoing"] = 1
                    raise PermissionError(13, "in use")
            real(source, target)

        monkeypatch.setattr(os, "replace", replace)
        with pytest.raises((Dead, InvalidInput)) as told:
            write_files(folder, dict.fromkeys("abcd", "new"))
        monkeypatch.setattr(os, "replace", real)
        if told.type is InvalidInput:
            assert (
                "in use; nothing was changed there" in str(told.value)
                and not (folder / INTERRUPTED).exists()
            )
        write_files(folder, {"other": ""})
        texts = [path.read_text() for path in sorted(folder.glob("?"))]
        assert texts in (["old"] * 3, ["new"] * 4), (last, texts)
    assert told.type is InvalidInput  # the last one got to the end
