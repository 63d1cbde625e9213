"""What is handed out: one version everywhere, lower bounds that were tried, and a wheel that works
outside the checkout.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import ambrose

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SCRIPTS = "Scripts" if os.name == "nt" else "bin"
DATA_SUFFIXES = {".toml", ".json", ".j2", ".typed", ".html", ".css", ".js", ".svg"}


def bounds(*extras):
    """{package: its lower bound} of the dependencies and of these extras."""
    listed = PROJECT["dependencies"] + [
        line for extra in extras for line in PROJECT["optional-dependencies"][extra]
    ]
    return dict(re.fullmatch(r"([\w-]+)(?:\[\w+\])?>=([\d.]+)", line).groups() for line in listed)


def pins(file):
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


def release(version):
    """(1, 2) of '1.2.0': versions as pip compares them, trailing zeros apart."""
    return tuple(int(number) for number in re.sub(r"(\.0)+$", "", version).split("."))


def test_version_has_one_place():
    assert "version" in PROJECT["dynamic"]
    assert "version" not in PROJECT
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", citation, re.M)[1] == ambrose.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (?:\[?Unreleased\]?|(\d\S+))", changelog, re.M)[1] in (
        None,
        ambrose.__version__,
    )


def test_hooks_have_the_pinned_linter():
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert re.findall(r"ruff==([\d.]+)", hooks) == [pins("constraints.txt")["ruff"]]


def test_oldest_constraints_are_the_lower_bounds():
    lint = {"ruff", "mypy", "import-linter"}  # no test needs them
    wanted = {
        name: release(bound)
        for name, bound in bounds("dev", "lmi", "tdms").items()
        if name not in lint
    }
    assert {
        name: release(version) for name, version in pins("constraints-oldest.txt").items()
    } == wanted


def test_every_dependency_is_pinned_within_its_bound():
    pinned = {
        name.lower().replace("_", "-"): release(version)
        for name, version in pins("constraints.txt").items()
    }
    for name, bound in bounds(*PROJECT["optional-dependencies"]).items():
        assert pinned[name.lower()] >= release(bound), name


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    directory = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--wheel-dir",
        str(directory),
        str(ROOT),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (path,) = directory.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def source_archive(tmp_path_factory):
    """The sdist, built as a release is."""
    directory = tmp_path_factory.mktemp("sdist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(directory)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (path,) = directory.glob("*.tar.gz")
    return path


@pytest.fixture(scope="module", params=["wheel", "source_archive"])
def installed(request, tmp_path_factory):
    """A virtual environment that holds the wheel, or what pip makes of the sdist where there is no
    compiler, and sees the dependencies, but not the checkout: run(*command) -> output.

    The dependencies come through a path file, and path files within such a folder (the editable
    install) are not read.
    """
    directory = tmp_path_factory.mktemp("installed")
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "COV_"))
    }
    environment |= {"PYTHONUTF8": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(directory / "venv")], check=True
    )
    python = directory / "venv" / SCRIPTS / "python"
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(
        subprocess.run(
            [python, "-c", code], capture_output=True, text=True, check=True, env=environment
        ).stdout.strip()
    )
    dependencies = [
        path for path in sys.path if Path(path).name in {"site-packages", "dist-packages"}
    ]
    (site / "dependencies.pth").write_text("\n".join(dependencies) + "\n", encoding="utf-8")
    command = f"-m pip --python {python} install --quiet --disable-pip-version-check --no-deps --no-compile"
    subprocess.run(
        [
            sys.executable,
            *command.split(),
            "--no-index",
            "--no-build-isolation",
            str(request.getfixturevalue(request.param)),
        ],
        check=True,
        env=environment | {"PATH": "", "CC": "no compiler"},
    )

    def run(command, *arguments, status=0):
        path = directory / "venv" / SCRIPTS / command
        done = subprocess.run(
            [str(path), *map(str, arguments)],
            cwd=directory,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == status, done.stderr
        return done.stdout

    run.directory, run.site = directory, site
    return run


@pytest.mark.wheel
def test_wheel_holds_the_package_and_its_data(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        metadata = archive.read(f"ambrose-{ambrose.__version__}.dist-info/METADATA").decode()
    source = ROOT / "src"
    kept = {path for path in source.rglob("*") if path.suffix in {".py", *DATA_SUFFIXES}}
    assert names == {path.relative_to(source).as_posix() for path in kept}
    folders = {Path(name).parent.as_posix() for name in names if Path(name).suffix in DATA_SUFFIXES}
    rooms = {"machines", "rig/scenarios", "report/templates", "code/templates"}
    assert folders >= {"ambrose"} | {f"ambrose/{room}" for room in rooms}
    assert f"\nVersion: {ambrose.__version__}\n" in metadata


@pytest.mark.wheel
def test_wheel_works_outside_the_checkout(installed):
    code = (
        "import ambrose, importlib.metadata; print(ambrose.__file__); "
        "print(importlib.metadata.version('ambrose'))"
    )
    place, version = installed("python", "-c", code).splitlines()
    assert Path(place).is_relative_to(installed.site)
    assert version == ambrose.__version__
    assert installed("ambrose", "--version").split()[-1] == version
    assert set(json.loads(installed("ambrose", "machines", "--json"))) == set(
        ambrose.bundled_machines()
    )
    assert json.loads(installed("ambrose", "check", "seal-rig", "--json"))["rotor_states"] == 144
    code = "from ambrose.rig.scenario import bundled_scenarios; print(*bundled_scenarios())"
    assert {"levitation", "prbs", "run-up"} <= set(installed("python", "-c", code).split())

    # A tenth of the time without tolerances. The PID whirls at twice the nominal pressure: forced,
    # and status 1 says so.
    text = (installed.site / "ambrose" / "machines" / "seal-rig.toml").read_text(encoding="utf-8")
    (installed.directory / "rig.toml").write_text(
        text[: text.index("[[tolerance]]")], encoding="utf-8"
    )
    installed("ambrose", "synthesize", "rig.toml", "--method", "pid", "-o", "pid.json", status=1)
    arguments = ["--machine", "rig.toml", "--to", "c", "-o", "code", "--force", "--json"]
    done = json.loads(installed("ambrose", "export", "pid.json", *arguments, status=1))
    assert {"controller.c", "controller.h"} <= {Path(path).name for path in done["files"]}
    arguments = [
        "--scenario",
        "impulse-parallel",
        "--linear",
        "-o",
        "record.csv",
        "--report",
        "run.html",
        "--json",
    ]
    done = json.loads(
        installed("ambrose", "simulate", "rig.toml", "--controller", "pid.json", *arguments)
    )
    assert done["outcome"] == "completed"
    assert "</html>" in (installed.directory / "run.html").read_text(encoding="utf-8")
