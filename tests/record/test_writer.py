"""Streams: what was appended comes back, however the run ends; memory does not grow with the
record.
"""

import io
import resource
import signal
import subprocess
import sys
from pathlib import Path
from unittest import mock

import h5py
import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.record.files import read_record, write_record
from ambrose.record.record import Record
from ambrose.record.stream import RecordWriter, block as stream_block, partial_path

POINT = OperatingPoint(speed=1200.0, seal_pressure=2.04e5, label="nominal")
SIGNALS, UNITS = ("y_A_zeta", "i_A_zeta", "f_center_x"), ("m", "A", "N")
WRITER = """
import sys, time
import numpy as np
from ambrose.record.stream import RecordWriter
signals = tuple(f"y_{i}" for i in range(8))
with RecordWriter(sys.argv[1], "rig", 10e3, signals, ("m",) * 8, chunk=int(sys.argv[3])) as writer:
    start, count = 0, int(sys.argv[2])
    while start < count:
        values = np.arange(start, start + 100.0)
        writer.append(values + 1e6 * np.arange(8)[:, None])
        start += 100
        print(writer.samples, flush=True)
    # The peak of this program alone: getrusage still counts the memory of the process that started it.
    lines = open("/proc/self/status").read().splitlines()
    print("peak", next(line.split()[1] for line in lines if line.startswith("VmHWM")), flush=True)
"""


def writer(path, **options):
    return RecordWriter(
        path, "seal-rig", 9999.7, SIGNALS, UNITS, POINT, 0.25, (("operator", "J. Doe"),), **options
    )


def samples(count, start=0):
    return np.arange(start, start + count) + np.array([[0.0], [1e6], [2e6]])


@pytest.mark.parametrize("sizes", [(1,), (7,), (8,), (100,), (3, 8, 1, 20, 2), (16, 16)])
@pytest.mark.parametrize("suffix", [".h5", ".hdf5"])
def test_blocks_of_any_size_give_the_record_written_at_once(tmp_path, sizes, suffix):
    path, start = tmp_path / f"run{suffix}", 0
    with writer(path, chunk=8) as stream:
        for size in sizes:
            stream.append(samples(size, start))
            start += size
            assert stream.samples == start
        assert not path.exists()
    plain = Record(
        "seal-rig", 9999.7, SIGNALS, UNITS, samples(start), POINT, 0.25, (("operator", "J. Doe"),)
    )
    again = read_record(path)
    assert np.array_equal(again.values, plain.values)
    for name in ("machine", "sample_rate_hz", "signals", "units", "point", "start_time", "notes"):
        assert getattr(again, name) == getattr(plain, name), name
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with h5py.File(path) as file, h5py.File(write_record(plain, tmp_path / "plain.h5")) as other:
        assert dict(file.attrs) == dict(other.attrs) and list(file["signals"]) == list(
            other["signals"]
        )


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_run_keeps_every_sample_under_the_partial_name(tmp_path, error):
    path = tmp_path / "run.h5"
    with pytest.raises(error), writer(path, chunk=8) as stream:
        stream.append(samples(21))
        stream.note("outcome", "stopped by hand")
        raise error
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5.partial"]
    record = read_record(partial_path(path))
    assert np.array_equal(record.values, samples(21))
    assert dict(record.notes) == {
        "complete": "false",
        "operator": "J. Doe",
        "outcome": "stopped by hand",
    }
    kept = read_record(write_record(record, tmp_path / "kept.csv"))  # the mark survives conversion
    assert np.array_equal(kept.values, record.values) and kept.notes == record.notes


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_writer_leaves_a_readable_record(tmp_path, seed):
    path = tmp_path / "run.h5"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, path, "100000000", "64"], stdout=subprocess.PIPE, text=True
    ) as process:
        lines = 50 + np.random.default_rng(seed).integers(20)
        reported = [int(process.stdout.readline()) for _ in range(lines)][-1]
        process.kill()
        reported = max([reported, *map(int, process.stdout.read().split())])
    assert process.returncode == -signal.SIGKILL and not path.exists()
    before = partial_path(path).read_bytes()
    record = read_record(partial_path(path))
    assert partial_path(path).read_bytes() == before
    count = record.values.shape[1]
    assert reported - 64 <= count <= reported + 100
    assert np.array_equal(record.values, np.arange(count) + 1e6 * np.arange(8)[:, None])
    assert ("complete", "false") in record.notes


def test_a_growing_record_can_be_read(tmp_path):
    with writer(tmp_path / "run.h5", chunk=8) as stream:
        with pytest.raises(InvalidInput, match=r"run\.h5\.partial: .*before its first block"):
            read_record(stream.partial)
        for start in range(0, 80, 10):
            stream.append(samples(10, start))
            if start >= 10:
                shown = read_record(stream.partial)
                assert shown.values.shape[1] == (start + 10) // 8 * 8
                assert np.array_equal(shown.values, samples(shown.values.shape[1]))


@pytest.mark.parametrize("damage", ["zeros", "cut"])
def test_a_chunk_cut_short_by_the_kill_is_left_out(tmp_path, damage):
    with pytest.raises(RuntimeError), writer(tmp_path / "run.h5", chunk=8) as stream:
        stream.append(samples(24))
        raise RuntimeError
    data = bytearray(stream.partial.read_bytes())
    if damage == "zeros":
        data[-64:] = bytes(64)
    stream.partial.write_bytes(data[:-1] if damage == "cut" else data)
    assert np.array_equal(read_record(stream.partial).values, samples(16))


def test_what_is_appended_after_a_failed_attempt_is_behind_the_last_whole_block(
    tmp_path, monkeypatch
):
    """Half a block was left in the way: what came behind it could not be read."""
    with writer(tmp_path / "run.h5", chunk=8) as stream:
        stream.append(samples(8))
        real, file = io.FileIO.write, stream._file
        half = mock.Mock(wraps=file)
        half.write.side_effect = [real(file, b"S" * 30), OSError(28, "No space left on device")]
        stream._file = half
        with pytest.raises(InvalidInput, match="No space left"):
            stream.append(samples(8, 8))
        stream._file = file
        stream.append(samples(8, 16))
    assert np.array_equal(read_record(tmp_path / "run.h5").values, samples(24))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"junk",
        b"ambrose-stream-1\n",
        stream_block(b"H", b"[]"),
        stream_block(b"H", {"signals": []}),
        stream_block(b"H", b"[" * 100_000),
        stream_block(b"H", {"signals": ["y_A"]}) + stream_block(b"S", b"123"),
    ],
)
def test_what_is_no_stream_is_refused(tmp_path, content):
    path = tmp_path / "run.h5.partial"
    path.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"run\.h5\.partial: "):
        read_record(path)


def test_a_second_writer_is_refused(tmp_path):
    """It replaced the growing file of the first, whose samples were lost."""
    with writer(tmp_path / "run.h5") as first:
        first.append(samples(5))
        with (
            pytest.raises(InvalidInput, match="another run is writing"),
            writer(tmp_path / "run.h5"),
        ):
            pass
        first.append(samples(5, 5))
    assert np.array_equal(read_record(tmp_path / "run.h5").values, samples(10))


@pytest.mark.parametrize("kept", [0.9, 0.5, 0.2, 0.02, 0.005])
def test_a_truncated_copy_of_a_killed_run_is_refused_or_right(tmp_path, kept):
    path = tmp_path / "run.h5"
    with writer(path, chunk=8) as stream:
        stream.append(samples(4000))
        data = stream.partial.read_bytes()
    copy = tmp_path / "copy.partial"
    copy.write_bytes(data[: int(kept * len(data))])
    try:
        record = read_record(copy)
    except InvalidInput as error:
        assert "copy.partial: " in str(error)
    else:
        assert np.array_equal(record.values, samples(record.values.shape[1]))


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="reads the peak memory from Linux's /proc"
)
def test_memory_stays_flat(tmp_path):
    peaks = []
    for count in (2_000, 400_000):  # 0.1 and 26 MB
        arguments = [sys.executable, "-c", WRITER, tmp_path / "run.h5", str(count), "2048"]
        output = subprocess.run(arguments, capture_output=True, text=True, check=True).stdout
        peaks.append(int(output.split()[-1]) / 1024)
    assert peaks[1] < peaks[0] + 10 and peaks[1] < 200  # [MB]
    assert read_record(tmp_path / "run.h5").values.shape == (8, 400_000)


def test_a_finished_record_replaces_the_old_one_and_an_interrupted_one_does_not(tmp_path):
    path = tmp_path / "run.h5"
    for count in (5, 9):
        with writer(path) as stream:
            stream.append(samples(count))
    with pytest.raises(RuntimeError), writer(path) as stream:
        stream.append(samples(3))
        raise RuntimeError
    assert (
        read_record(path).values.shape[1] == 9 and read_record(stream.partial).values.shape[1] == 3
    )


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (np.zeros((2, 4)), "one row per signal"),
        (np.zeros((3, 0)), "n > 0"),
        (np.zeros(3), "one row per signal"),
        (
            np.array([[0.0, 0], [0, np.nan], [0, 0]]),
            r"i_A_zeta at sample 11 is nan.*run\.h5\.partial",
        ),
    ],
)
def test_a_wrong_block_is_refused_and_the_rest_kept(tmp_path, block, message):
    with pytest.raises(InvalidInput, match=message), writer(tmp_path / "run.h5") as stream:
        stream.append(samples(10))
        stream.append(block)
    assert np.array_equal(read_record(stream.partial).values, samples(10))


def test_wrong_use_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"suffix.*\.h5 or \.hdf5"):
        writer(tmp_path / "run.csv")
    with pytest.raises(InvalidInput, match="chunk is 0"):
        writer(tmp_path / "run.h5", chunk=0)
    with pytest.raises(InvalidInput, match="not a directory"), writer(tmp_path / "none" / "run.h5"):
        pass
    with pytest.raises(InvalidInput, match="the unit of y_A is 'N'"):
        RecordWriter(tmp_path / "run.h5", "m", 1.0, ("y_A",), ("N",))
    with pytest.raises(InvalidInput, match="not open"):
        writer(tmp_path / "run.h5").append(samples(1))
    with pytest.raises(InvalidInput, match="no samples"), writer(tmp_path / "run.h5"):
        pass
    with pytest.raises(InvalidInput, match="leaves free"), writer(tmp_path / "run.h5") as stream:
        stream.note("speed_rad_s", "3")
    with writer(tmp_path / "run.h5") as stream:
        stream.append(samples(1))
    with pytest.raises(InvalidInput, match="make a new one"), stream:
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5"]


def test_a_full_disk_is_named(tmp_path):
    """The size of files limited in another process: an HDF5 file of some kB, then no room."""
    limited = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    limited += "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n" + WRITER
    arguments = [sys.executable, "-c", limited, tmp_path / "run.h5", "100000", "64"]
    result = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=60)
    assert "cannot write" in result.stderr and "free some disk space" in result.stderr
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    record = read_record(tmp_path / "run.h5.partial")
    count = record.values.shape[1]
    assert count > 200 and np.array_equal(
        record.values, np.arange(count) + 1e6 * np.arange(8)[:, None]
    )
