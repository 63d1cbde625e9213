"""Whatever a terminal, a text, a link or a special file does: one line, the right exit status,
nothing lost, no traceback.
"""

import errno
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import click
import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from ambrose import terminal
from ambrose.cli import main
from ambrose.cli.controller_commands import _say_what_decides
from ambrose.code.block.block import check_identifier
from ambrose.core.checks import InvalidInput
from ambrose.identification.result import Provenance, as_comment
from ambrose.judge.checks import Check, Checks, Verification
from ambrose.judge.controller_file import read_controller
from ambrose.judge.result import CERTIFYING
from ambrose.machine.file.toml import bundled_machines
from ambrose.machine.ordinary_file import check_source, file_name, write_files, write_text
from ambrose.record import apart
from ambrose.record.files import read_record, write_record
from ambrose.record.record import Record
from ambrose.record.stream import RecordWriter, partial_path
from ambrose.terminal import _encoding, print_table, say

SMALL = (Path(__file__).parent / "machine" / "small.toml").read_text(encoding="utf-8")
STEERING = "\x1b[31m\x9b\x07\x08\r\x7f\x85\u202e\u2066\u2028\u200b\ufeff"
NASTY = STEERING + "\nSPOOFED\n[/x] [red]danger[/red] :smile:"
POSIX = pytest.mark.skipif(
    os.name != "posix", reason="pipes in the file system, /dev and /proc are POSIX"
)


def call(*arguments, charset="utf-8"):
    done = CliRunner(charset=charset).invoke(main, [str(argument) for argument in arguments])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stdout_bytes.decode(charset), done.stderr_bytes.decode(charset)


def described(path, text):
    """A machine file with that description."""
    quoted = (
        '"'
        + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in text)
        + '"'
    )
    changed = SMALL.replace('"Two bearings, a disc, a seal and a coupling"', quoted)
    path.write_text(changed, encoding="utf-8")
    return path


@pytest.mark.parametrize("charset", ["cp1252", "cp437", "cp932", "ascii"])
def test_every_encoding_takes_every_text(charset, tmp_path):
    machine = described(tmp_path / "m.toml", "Läufer ≥ 3 μm ✓ 机器")
    status, out, _ = call("check", machine, charset=charset)
    assert status == 1 and "cannot be lifted" in out  # a bearing of the small machine is weak
    assert "kg m" in out
    assert (">= 3" in out) or ("≥ 3" in out)
    status, _, err = call("check", "机器✓.toml", charset=charset)
    assert status == 2
    assert err.startswith("ambrose: ")


@pytest.mark.parametrize(("locale", "plain"), [("C", True), ("POSIX", True), ("C.UTF-8", False)])
def test_a_locale_that_asks_for_plain_text_has_it(locale, plain, monkeypatch):
    monkeypatch.delenv("PYTHONIOENCODING", raising=False)
    monkeypatch.delenv("PYTHONUTF8", raising=False)
    monkeypatch.setenv("LC_ALL", locale)
    assert (_encoding(io.TextIOWrapper(io.BytesIO(), "utf-8")) == "ascii") is plain
    monkeypatch.setenv("PYTHONIOENCODING", "utf-8")
    assert _encoding(io.TextIOWrapper(io.BytesIO(), "utf-8")) == "utf-8"


def test_what_an_encoding_lacks_is_spelled_and_no_number_changes():
    stream = io.TextIOWrapper(io.BytesIO(), "ascii", "ambrose.spell")
    stream.write("3·10⁻⁷ m², 10¹² ≤ ∞, 2 µm, 45° ± 1, 机")
    stream.flush()
    assert stream.buffer.getvalue() == rb"3*10^-7 m^2, 10^12 <= inf, 2 um, 45 deg +- 1, \u673a"


def test_a_text_is_text_on_one_line_of_its_own(tmp_path):
    machine = described(tmp_path / "m.toml", NASTY)
    for arguments, expected in (
        (["check", machine], 1),
        (["check", NASTY.replace("/", "-")], 2),
        (["check", f"--{NASTY}"], 2),
        ([NASTY], 2),
        (["synthesize", "seal-rig", "--method", NASTY], 2),
    ):
        status, out, err = call(*arguments)
        assert status == expected
        assert not set(STEERING.replace("[31m", "")) & set(out + err)
        assert not [line for line in (out + err).splitlines() if line.strip().startswith("SPOOFED")]
        if expected == 1:
            assert all(
                words in out
                for words in ("[/x]", "[red]danger[/red]", ":smile:", "\\x1b[31m", "\\nSPOOFED")
            )


def test_a_message_of_many_lines_keeps_its_own(tmp_path):
    (tmp_path / "two.toml").write_text(
        SMALL.replace('"timoshenko"', '"x\\ny"').replace("turns = 36", 'turns = "a"')
    )
    assert len(call("check", tmp_path / "two.toml")[2].splitlines()) == 3


class Reluctant(io.RawIOBase):
    """A stream that fails, or waits now and then."""

    def __init__(self, number=None):
        self.number, self.written, self.calls = number, b"", 0

    def writable(self):
        return True

    def write(self, data):
        self.calls += 1
        if self.number is not None:
            raise OSError(self.number, os.strerror(self.number))
        if self.calls % 2:
            return None  # would have to wait
        self.written += bytes(data)
        return len(data)


@pytest.mark.parametrize(
    ("out", "err", "arguments", "expected"),
    [
        (errno.EPIPE, None, ["machines"], 0),
        (errno.EPIPE, None, ["machines", "--json"], 0),
        (errno.EPIPE, None, ["--help"], 0),
        (errno.EPIPE, None, ["--version"], 0),
        (errno.EPIPE, errno.EPIPE, ["check", "nope"], 2),
        (errno.EPIPE, errno.EPIPE, ["check"], 2),
        (errno.ENOSPC, None, ["machines"], 2),
        (errno.ENOSPC, None, ["machines", "--json"], 2),
        (errno.ENOSPC, None, ["--version"], 2),
        (errno.EIO, errno.ENOSPC, ["check", "nope"], 2),
        (None, errno.ENOSPC, ["check"], 2),
        (None, None, ["machines"], 0),
    ],
)
def test_the_exit_status_does_not_depend_on_who_listens(out, err, arguments, expected, monkeypatch):
    outlets = Reluctant(out), Reluctant(err)
    for name, raw in zip(("stdout", "stderr"), outlets, strict=True):
        monkeypatch.setattr(
            sys, name, io.TextIOWrapper(io.BufferedWriter(raw), "utf-8", write_through=True)
        )
    before = sys.stdout, sys.stderr
    with pytest.raises(SystemExit) as stopped:
        main(arguments, prog_name="ambrose")
    assert stopped.value.code == expected
    assert (sys.stdout, sys.stderr) == before
    if out == errno.ENOSPC:
        assert b"standard output: No space left" in outlets[1].written
    if out is err is None:
        assert b"seal-rig" in outlets[0].written


def test_streams_that_do_not_exist(monkeypatch):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    for arguments, expected in ((["machines"], 0), (["check", "nope"], 2)):
        with pytest.raises(SystemExit) as stopped:
            main(arguments, prog_name="ambrose")
        assert stopped.value.code == expected


@POSIX
def test_closed_descriptors_never_become_a_file_of_results(tmp_path):
    record = Record("m", 10.0, ("y_A",), ("m",), np.arange(9.0)[None])
    write_record(record, tmp_path / "r.h5")
    command = f'exec "{sys.executable}" -m ambrose convert r.h5 -o r.csv <&- >&- 2>&-'
    assert (
        subprocess.run(["sh", "-c", command], check=False, cwd=tmp_path, timeout=60).returncode == 0
    )
    assert np.array_equal(read_record(tmp_path / "r.csv").values, record.values)


@POSIX
@pytest.mark.parametrize(
    "moment", ["click", "ambrose.cli.machine_commands", "numpy", "scipy.linalg"]
)
def test_an_interruption_is_130_and_one_line_from_the_first_import_on(moment):
    code = f"""
import signal, sys
class Finder:
    def find_spec(self, name, *others):
        if name == {moment!r}:
            signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
from ambrose.__main__ import main
sys.argv = ["ambrose", "check", "seal-rig"]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr.strip() == "ambrose: interrupted; what was finished before stays on disk"


@POSIX
def test_an_interruption_that_a_library_loses_ends_the_command_all_the_same():
    code = """
import signal, sys
class Lost:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
class Finder:
    def find_spec(self, name, *others):
        if name == "click":
            Lost()
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
from ambrose.__main__ import main
sys.argv = ["ambrose", "machines"]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (130, 1, "")


@POSIX
@pytest.mark.parametrize("twice", [False, True])
def test_an_interrupted_design_certifies_what_it_has_unless_it_is_interrupted_again(
    tmp_path, twice
):
    code = f"""
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
import ambrose.__main__ as start
from ambrose.synthesis.fixed_order import tuning
start._PATIENCE = 1.0
best = tuning._best
def late(*given):
    time.sleep({60 if twice else 3})
    return best(*given)
tuning._best = late
start.main()
"""
    path = tmp_path / "law.json"
    words = ["synthesize", "flywheel", "--method", "tuned", "-o", str(path)]
    run = subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for line in run.stderr:
            if "round 1:" in line:
                run.send_signal(signal.SIGINT)
            if CERTIFYING in line:
                break
        time.sleep(1.0)
        if twice:
            run.send_signal(signal.SIGINT)
        _, rest = run.communicate(timeout=50)
    finally:
        run.kill()
    assert run.returncode == 130
    assert path.exists() != twice
    if twice:
        assert rest.strip() == "ambrose: interrupted; what was finished before stays on disk"
    else:
        assert read_controller(path).stopped_early == "interrupted"


def test_an_interruption_within_a_command_is_130(monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("ambrose.machine.file.toml.load_machine", interrupted)
    status, _, err = call("check", "seal-rig")
    assert status == 130
    assert "interrupted" in err


# names that enter paths and files


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("seal-rig", "seal-rig"),
        ("x/../../ESCAPED", "x-.-.-ESCAPED"),
        ("..", "unnamed"),
        ("a\\b:c*?", "a-b-c"),
        ("\n\x1b", "unnamed"),
        (".hidden", "hidden"),
        ("Läufer 机器", "Läufer-机器"),
        ("n" * 400, "n" * 60),
        ("a\u202eb", "a-b"),
        ("v1.5_b", "v1.5_b"),
    ],
)
def test_a_name_becomes_part_of_a_file_name(name, plain):
    assert file_name(name) == plain


def test_a_study_stays_in_its_folder_whatever_the_machine_is_called(tmp_path, monkeypatch):
    inner = tmp_path / "in" / "ner"
    inner.mkdir(parents=True)
    places = []
    monkeypatch.chdir(inner)
    monkeypatch.setattr(
        "ambrose.chain.study.study", lambda machine, place, *rest: places.append(place) or 1 / 0
    )
    (tmp_path / "m.toml").write_text(SMALL.replace('"small"', '"x/../../ESCAPED"', 1))
    done = CliRunner().invoke(main, ["study", str(tmp_path / "m.toml")])
    assert done.exit_code == 2 and "the calculation broke down" in done.stderr
    assert [(inner / place).resolve().parent for place in places] == [inner.resolve()]


@pytest.mark.parametrize("name", ["con", "AUX", "nul", "Lpt1", "../x", "a/b", "a\n"])
def test_a_block_is_not_called_like_a_device_or_a_path(name):
    with pytest.raises(InvalidInput):
        check_identifier(name, "the name of the block", "choose another")


def test_names_of_files_cannot_break_out_of_a_comment():
    names = Provenance(("a\n[machine]\n\x1b.h5", "b\udcff.h5"), "c\r.json")
    text = as_comment([f"from {names.of_records}, {names.controller}", "  \x1b\x00"])
    assert all(line.startswith("#") for line in text.splitlines() if line)
    assert text.replace("\n", "").isprintable()
    text.encode()


# what is written


def occupied(path, kind):
    if kind == "link":
        path.with_name("target").write_text("kept")
        path.symlink_to("target")
    elif kind == "dangling":
        path.symlink_to("nowhere")
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as bound:
            here = Path.cwd()
            os.chdir(path.parent)  # names of sockets are short
            bound.bind(path.name)
            os.chdir(here)
    return path


@POSIX
@pytest.mark.parametrize("kind", ["link", "dangling", "fifo", "socket"])
def test_nothing_but_a_file_is_replaced(kind, tmp_path):
    record = Record("m", 10.0, ("y_A",), ("m",), np.arange(9.0)[None])
    path = occupied(tmp_path / "r.h5", kind)
    before = path.lstat()
    writers = (
        lambda: write_text(path, "x", "report"),
        lambda: write_record(record, path),
        lambda: RecordWriter(path, "m", 10.0, ("y_A",), ("m",)).__enter__(),
        lambda: write_files(tmp_path, {"other": "x", "r.h5": "x"}),
        lambda: write_files(path, {"a": "x"}),
    )
    for write in writers:
        with pytest.raises(
            InvalidInput, match=r"r\.h5: it is (a symbolic link|a pipe|a socket|not a folder)"
        ):
            write()
    assert path.lstat() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == (
        ["r.h5", "target"] if kind == "link" else ["r.h5"]
    )
    assert kind != "link" or (tmp_path / "target").read_text() == "kept"


@POSIX
def test_nor_is_the_place_of_a_partial_record(tmp_path):
    occupied(partial_path(tmp_path / "r.h5"), "link")
    with pytest.raises(InvalidInput, match="symbolic link"):
        RecordWriter(tmp_path / "r.h5", "m", 10.0, ("y_A",), ("m",)).__enter__()
    assert (tmp_path / "target").read_text() == "kept"


# what is read


@POSIX
@pytest.mark.parametrize(
    "kind",
    [
        *("fifo", "socket", "/dev/zero"),
        *(place for place in ("/dev/null", "/proc/self/pagemap", "/proc/self/mem")),
    ],
)
def test_what_is_no_file_is_refused_at_once(kind, tmp_path):
    if kind.startswith("/proc") and not Path(kind).exists():
        pytest.skip("no /proc here")
    table = tmp_path / "map.toml"
    table.write_text(
        'machine = "m"\nsample_rate_hz = 1\n[point]\nspeed = 0\nseal_pressure = '
        '0\n[[signal]]\nname="y"\nsource="y"\n'
    )
    np.savetxt(tmp_path / "y.mat", [1.0])
    for suffix, arguments in {
        "toml": ["check", "{}"],
        "json": ["export", "{}", "--to", "c", "-o", tmp_path / "code"],
        "h5": ["convert", "{}"],
        "csv": ["convert", "{}"],
        "mat": ["convert", "{}", "--columns", table],
        "tdms": ["convert", "{}", "--columns", table],
        "map": ["convert", tmp_path / "y.mat", "--columns", "{}"],
    }.items():
        path = tmp_path / f"input.{suffix}"
        if kind.startswith("/"):
            path.symlink_to(kind)
        else:
            occupied(path, kind)
        status, out, err = call(*[path if part == "{}" else part for part in arguments])
        assert (status, out) == (2, "")
        assert f"input.{suffix}" in err


def test_a_source_that_is_missing_says_so(tmp_path):
    with pytest.raises(InvalidInput, match="is not a file; check the name") as refused:
        check_source(tmp_path / "none", "record")
    assert isinstance(refused.value.__cause__, FileNotFoundError)


@pytest.fixture
def secret(tmp_path):
    """Numbers that belong to nobody's record: raw, and in HDF5."""
    np.full(8, 42.5).tofile(tmp_path / "secret.bin")
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["signals/y_A"] = np.full(8, 42.5)
        file["signals/y_A"].attrs["unit"] = "m"
        file["log/v"] = file["v"] = np.full((1, 8), 42.5)
    return tmp_path


def virtual(file, place, source, shape):
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource("secret.h5", source, shape)
    file.create_virtual_dataset(place, layout)


OUTSIDE = {
    "external storage": lambda f: f.create_dataset(
        "signals/y_A", (8,), "f8", external=[("secret.bin", 0, 64)]
    ),
    "an external link to the group": lambda f: f.__setitem__(
        "signals", h5py.ExternalLink("secret.h5", "/signals")
    ),
    "a soft link over an external one": lambda f: f.update(
        {
            "away": h5py.ExternalLink("secret.h5", "/"),
            "signals": h5py.SoftLink("/away/signals"),
        }
    ),
    "an external link to a signal": lambda f: f.__setitem__(
        "signals/y_A", h5py.ExternalLink("secret.h5", "/signals/y_A")
    ),
    "a virtual dataset": lambda f: virtual(f, "signals/y_A", "signals/y_A", (8,)),
    "a soft link to nothing": lambda f: f.__setitem__("signals", h5py.SoftLink("/nothing")),
}


@pytest.mark.parametrize("how", OUTSIDE)
@pytest.mark.parametrize("unfinished", [False, True])
def test_a_record_reads_nothing_outside_itself(how, unfinished, secret, monkeypatch):
    # of the others the reader itself, without its trial apart
    if how not in {"external storage", "a virtual dataset"}:
        monkeypatch.setattr(apart, "try_record", lambda path: None)
    path = secret / "r.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {"format": "ambrose-record", "version": 1, "machine": "m", "sample_rate_hz": 1.0}
        )
        file.attrs.update(
            {
                "speed_rad_s": 0.0,
                "seal_pressure_pa": 0.0,
                **({"complete": "false"} if unfinished else {}),
            }
        )
        OUTSIDE[how](file)
        if "link" not in how:
            file["signals/y_A"].attrs["unit"] = "m"
    with pytest.raises(InvalidInput, match=r"/signals(/y_A)? is a link, or kept in another file"):
        read_record(path)


OUTSIDE_MAT = {
    "external storage": (
        "v",
        lambda f: f.create_dataset("v", (1, 8), "f8", external=[("secret.bin", 0, 64)]),
    ),
    "an external link": ("v", lambda f: f.__setitem__("v", h5py.ExternalLink("secret.h5", "/v"))),
    "an external link to a structure": (
        "log.v",
        lambda f: f.__setitem__("log", h5py.ExternalLink("secret.h5", "/log")),
    ),
    "a virtual dataset": ("v", lambda f: virtual(f, "v", "v", (1, 8))),
}


@pytest.mark.parametrize("how", OUTSIDE_MAT)
def test_nor_does_a_file_of_matlab(how, secret):
    from ambrose.record.foreign import read_foreign

    source, fill = OUTSIDE_MAT[how]
    with h5py.File(secret / "r.mat", "w") as file:
        fill(file)
    columns = {"machine": "m", "sample_rate_hz": 1.0, "point": {"speed": 0.0, "seal_pressure": 0.0}}
    columns["signal"] = [{"name": "y_A", "source": source, "unit": "m"}]
    with pytest.raises(InvalidInput, match=rf"{source} is a link, or kept in another file"):
        read_foreign(secret / "r.mat", columns)


def test_an_attribute_that_is_no_text_is_written_as_one(tmp_path):
    write_record(Record("m", 1.0, ("y_A",), ("m",), np.zeros((1, 3))), tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "a") as file:
        kind = h5py.h5t.C_S1.copy()
        kind.set_size(2)
        kind.set_cset(h5py.h5t.CSET_UTF8)
        space = h5py.h5s.create(h5py.h5s.SCALAR)
        h5py.h5a.create(file.id, b"note", kind, space).write(np.array(b"\xff\xfe", "S2"), kind)
        file.attrs.create("other", b"a\xff", dtype=h5py.string_dtype())
    assert call("convert", tmp_path / "r.h5", "-o", tmp_path / "r.csv")[0] == 0
    assert (
        json.loads(call("convert", tmp_path / "r.csv", "-o", tmp_path / "s.h5", "--json")[1])[
            "samples"
        ]
        == 3
    )


def test_say_and_tables_need_no_terminal(capsys):
    say("a\x1bb")
    print_table("[/t]", ("[/c]",), [("[/d] :smile:",)])
    out = capsys.readouterr().out
    assert "a\\x1bb\n" in out
    assert all(words in out for words in ("[/t]", "[/c]", "[/d] :smile:"))


def test_an_inherited_deafness_to_interruptions_stays():
    if os.name != "posix":
        pytest.skip("signals are POSIX")
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from ambrose.__main__ import "
        "main; import sys\n"
    )
    code += "sys.argv = ['ambrose', '--version']\ntry:\n    main()\nexcept SystemExit:\n    pass\n"
    code += "assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=False, timeout=60
        ).returncode
        == 0
    )


TERMINATED = """
import ambrose.cli, sys, time
from ambrose.machine.ordinary_file import claimed
def main(**given):
    with claimed(sys.argv[1], "file"):
        print("held", flush=True)
        time.sleep(3600)
ambrose.cli.main = main
from ambrose.__main__ import main as start
start()
"""


@POSIX
def test_a_command_that_is_terminated_leaves_no_lock(tmp_path):
    """SIGTERM, as a service manager or `kill` sends it, left the lock file there."""
    command = [sys.executable, "-c", TERMINATED, str(tmp_path / "out.toml")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout.readline() == "held\n"
        assert list(tmp_path.iterdir()) == [tmp_path / ".out.toml.lock"]
        run.send_signal(signal.SIGTERM)
        said = run.communicate(timeout=300)[1]
    assert run.returncode == 143 and "interrupted" in said and "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [["check", "no-such-machine"], ["check"], ["check", "seal-rig", "--no-such-option"]],
)
def test_a_refusal_is_one_json_object_as_well(arguments):
    done = CliRunner().invoke(main, [*arguments, "--json"])
    said = json.loads(done.stdout)
    assert done.exit_code == said["status"] == 2
    assert " ".join(said["error"].split())[:40] in " ".join(done.stderr.split())


def test_a_stage_that_lasts_says_so(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "_SILENCE", 0.02)
    with terminal.progress_shown(False) as progress:
        progress("thinking")
        told = ""
        while told.count("since") < 2:
            time.sleep(0.01)
            told += capsys.readouterr().err
    said = (told + capsys.readouterr().err).splitlines()
    assert said[0] == "  thinking" and len(said) > 2
    assert all(line.startswith("  thinking: since ") for line in said[1:])


def screen_of(monkeypatch, *arguments):
    """What a command prints by default, before it is fitted to a width."""
    shown = []

    def show(screen):
        shown.append(screen)

    monkeypatch.setattr(terminal.Screen, "show", show)
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code in {0, 1}, done.stderr
    (screen,) = shown
    return screen


def bounded(screen, most=40):
    """At 80 and 100 columns: no more lines, no wider, and no word torn or lost but a path longer
    than half a line.
    """
    whole = {word for line in screen.fitted(1000) for word in line.split()}
    long = [word for word in whole if len(word) > 40]
    for width in (80, 100):
        lines = screen.fitted(width)
        assert 0 < len(lines) <= most, "\n".join(lines)
        assert max(map(len, lines)) <= width, max(lines, key=len)
        torn = {word for line in lines[:-1] for word in line.split()} - whole
        assert not [word for word in torn if not any(word in name for name in long)], torn
    return lines


@pytest.mark.parametrize("machine", bundled_machines())
def test_check_is_one_screen(machine, monkeypatch):
    lines = bounded(screen_of(monkeypatch, "check", machine))
    assert lines[0].startswith(("PASSED", "IMPLAUSIBLE"))


@pytest.mark.parametrize("command", ["machines", "scenarios"])
def test_a_list_is_one_screen(command, monkeypatch):
    bounded(screen_of(monkeypatch, command))


# quick ones; those after the first are for the long suite
_QUICK = (
    "flywheel",
    *(
        pytest.param(name, marks=pytest.mark.study)
        for name in (
            "seal-rig",
            "high-speed-spindle",
            "lalanne-ferraris-rotor",
            "nelson-mcvaugh-rotor",
            "overhung-blower",
            "turboexpander",
            "two-disc-rotor",
        )
    ),
)
# what needs more of the machine file
_LATERAL = {
    "flywheel",
    "high-speed-spindle",
    "lalanne-ferraris-rotor",
    "nelson-mcvaugh-rotor",
}
_MAGNETS = {"nelson-mcvaugh-rotor", "overhung-blower"}


@pytest.mark.parametrize("machine", _QUICK)
def test_the_chain_on_a_machine_is_screens(machine, monkeypatch, tmp_path):
    """verify printed 66 to 272 lines of 140 columns, lateral lines of 234."""
    law = tmp_path / "pid.json"
    rate = ("--rate-hz", 10000)
    bounded(screen_of(monkeypatch, "synthesize", machine, "--method", "pid", *rate, "-o", law))
    told = (machine, "--controller", law)
    lines = bounded(screen_of(monkeypatch, "verify", *told))
    assert lines[0].startswith(("PASSED: ", "FAILED: "))
    assert any("operating point" in line and "stable" in line for line in lines)
    assert "The loop is sampled at 10 kHz, one sample of delay (design rate)." in lines
    bounded(screen_of(monkeypatch, "map", *told, "--what", "poles"))
    run = ("--scenario", "impulse-parallel", "--linear", "-o", tmp_path / "run.h5")
    bounded(screen_of(monkeypatch, "simulate", *told, *run))
    if machine in _LATERAL:
        bounded(screen_of(monkeypatch, "lateral", *told))
        bounded(screen_of(monkeypatch, "landing", machine))
    if machine in _MAGNETS:
        bounded(screen_of(monkeypatch, "magnet", machine))


def sixteen(spread):
    """A verification of 16 points, whose axes are above the limit where ``spread`` is."""

    def at(i):
        value = 2 + spread * i / 16
        zone = "A" if value <= 3 else "B"
        checks = (
            Check("stability.abscissa", "Stability", -9.0, "rad/s", 0.0, "<", True),
            Check("sensitivity.output.max", "Peak", 2.5, "-", 3.0, "<=", True),
            *(
                Check(
                    f"sensitivity.output.{axis}",
                    f"Peak output sensitivity, {axis}",
                    value,
                    "-",
                    3.0,
                    "<=",
                    value <= 3,
                    zone,
                    detail=f"at {40 + i} Hz",
                )
                for axis in ("A_zeta", "B_eta")
            ),
        )
        return Checks(f"point {i} of a machine with long labels", True, checks)

    return Verification(tuple(at(i) for i in range(16)))


@pytest.mark.parametrize(("spread", "verdict"), [(0.5, "PASSED: "), (3.0, "FAILED: ")])
def test_sixteen_points_are_one_screen(spread, verdict):
    verification = sixteen(spread)
    screen = terminal.Screen(lines=60)
    with click.Context(click.Command("verify")) as context:
        context.meta[terminal._SCREEN] = screen
        _say_what_decides(verification, ())
    lines = bounded(screen, 60)
    assert lines[0].startswith(verdict)
    (limits,) = [line for line in lines if line.strip().startswith("limit ")]
    assert limits.count("≤ 3") == 2
    rows = [line for line in lines if line.strip().startswith("point ") and " yes " in line]
    assert len(rows) == 16  # no operating point is cut: what fails in full is
    assert sum("*" in row for row in rows) == 1 and ("✗" in "".join(rows)) == (spread > 1)
    assert ("Not met" in lines) == (spread > 1)


def test_what_has_no_room_is_counted_and_what_fails_stays():
    screen = terminal.Screen("FAILED: three rows.")
    rows = [(f"row {i}", "a value") for i in range(100)]
    marks = ["red" if i in {50, 70, 99} else "" for i in range(100)]
    screen.parts.append(terminal._Table("Many", ("what", "value"), rows, marks))
    screen.parts += [f"note: number {i} of some length" for i in range(30)]
    lines = bounded(screen)
    assert lines[0] == "FAILED: three rows."
    assert all(any(f"row {i} " in line for line in lines) for i in (50, 70, 99))
    shown = sum("a value" in line for line in lines)
    notes = sum(line.startswith("note: ") for line in lines)
    assert lines[-1] == (
        f'Not shown: {100 - shown} more rows, {30 - notes} more of "note". '
        "--details prints everything."
    )


def test_details_prints_everything(monkeypatch):
    short, full = (call("scenarios", *more)[1] for more in ((), ("--details",)))
    assert "┃" in full and "┃" not in short
    assert json.loads(call("scenarios", "--json")[1]) == json.loads(
        call("scenarios", "--json", "--details")[1]
    )


@POSIX
@pytest.mark.parametrize("flags", ["fpu avx2 avx512f avx512dq", "fpu sse4_2 avx2"])
def test_small_products_take_the_same_kernels_on_every_processor(flags, tmp_path):
    processors = tmp_path / "cpuinfo"
    processors.write_text(f"processor\t: 0\nflags\t\t: {flags}\n", encoding="utf-8")
    code = f"""
import os, sys
import ambrose.__main__ as start
import ambrose.cli
start._PROCESSORS = {str(processors)!r}
ambrose.cli.main = lambda **given: print(os.environ.get("OPENBLAS_CORETYPE"), "numpy" in sys.modules)
start.main()
"""
    free = {k: v for k, v in os.environ.items() if k != "OPENBLAS_CORETYPE"}
    for own, expected in (
        ({}, "Haswell" if "avx512f" in flags else "None"),
        ({"OPENBLAS_CORETYPE": "Zen"}, "Zen"),
    ):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env={**free, **own},
            timeout=60,
        )
        assert done.stdout.split() == [expected, "False"]
