"""What a reader meets first: lines and columns of every command's output, words and first screen of every page.

    python -m benchmarks.first_screens FOLDER                every command on its bundled machines, hours on two cores
    python -m benchmarks.first_screens FOLDER verify size seal-rig
                            those commands, and machines; what they read must lie in FOLDER already

A run prints in a terminal of 100 columns and, where it is quick, again in one of 80. The pages are opened at
1400 x 900 and 400 x 800. What was printed stays in FOLDER/printed, the figures in FOLDER/first_screens.jsonl.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = ROOT / "benchmarks" / "snapshot_files"
SCREEN = 40, 100  # lines, columns
WORDS, PRINTED = 1500, 2500
QUICK = 20  # [s], what is run at 80 columns, too
# {m}: every bundled machine. A page is the first file (*.html) that the arguments name, or the one after ->
RUNS = """
machines
scenarios
new mine.toml --length "700 mm" --diameter "45 mm" --speed "15000 rpm" --disc "350 mm, 9 kg, 220 mm" --force
check {m}
synthesize {m} --method pid -o {m}-pid.json
verify {m} --controller {m}-pid.json --report verify-{m}.html
map {m} --controller {m}-pid.json -o map-{m}.html
simulate {m} --controller {m}-pid.json --scenario levitation -o levitation-{m}.h5 --report run-{m}.html
lateral {m} --controller {m}-pid.json -o lateral-{m}.html --data lateral-{m}.json
compare lateral-two-disc-rotor.json theirs.csv
landing {m} --duration 0.2 -o landing-{m}.html
magnet {m} -o magnet-{m}.html
synthesize seal-rig -o tuned.json
export seal-rig-pid.json --machine seal-rig --to c --rate-hz 10000 -o code --force
simulate seal-rig --controller seal-rig-pid.json --scenario run-up -o run-up.h5 --report run-up.html
simulate seal-rig --controller seal-rig-pid.json --scenario prbs -o prbs.h5
simulate seal-rig --controller seal-rig-pid.json --scenario acceptance -o measured.h5
simulate seal-rig --controller seal-rig-pid.json --scenario monitor -o watched.h5
record check prbs.h5 seal-rig
identify seal-rig prbs.h5 --controller seal-rig-pid.json -o identified.toml --report identify.html
identify --generic prbs.h5 --displacement y_A_zeta --drive u_A_zeta --reference e_A_zeta -o generic.html
frf seal-rig measured.h5 --controller seal-rig-pid.json -o frf.html
accept seal-rig seal-rig-pid.json measured.h5 -o accept.html
monitor seal-rig seal-rig-pid.json watched.h5 -o monitor.html
retune seal-rig prbs.h5 --controller seal-rig-pid.json -o retuning -> retuning/retuning.html
convert stations.csv -o stations.toml --speed "9000 rpm"
convert controller vendor.csv --machine turbomolecular-pump --input-unit um --input displacement -o bank.json
simulate overhung-blower --controller overhung-blower-pid.json --scenario turning-slow.toml -o slow.h5
simulate overhung-blower --controller overhung-blower-pid.json --scenario turning-fast.toml -o fast.h5
simulate overhung-blower --controller overhung-blower-pid.json --scenario still.toml -o still.h5
balance overhung-blower slow.h5 fast.h5 --plane "impeller=80 mm" --plane "free-end=50 mm" --settle 1.2
calibrate overhung-blower --slow-roll slow.h5 --levitated still.h5 -o calibrated.toml
simulate seal-rig --controller seal-rig-pid.json --scenario loads.toml --rate-hz 10000 -o loads.h5
bias seal-rig prbs.h5 --controller seal-rig-pid.json --loads loads.h5 -o bias.toml --report bias.html
simulate seal-rig --controller seal-rig-pid.json --scenario seal-sines.toml --rate-hz 10000 --point "zero pressure" -o seal-0.h5
simulate seal-rig --controller seal-rig-pid.json --scenario seal-sines.toml --rate-hz 10000 --point "nominal pressure" -o seal-1.h5
seal seal-rig seal-0.h5 seal-1.h5 -o seal.toml --report seal.html
campaign plan-screen.toml --workers 1 --pages 1 -o campaign -> campaign/report.html
trade-off two-disc-rotor --over settling_time --values "60 ms, 120 ms" --rate-hz 10000 -o trade-off.html
size turbomolecular-pump --rate-hz 20000 --areas "0.5, 1" --biases "1" -o size.html
study seal-rig -o study -> study/report.html
study turboexpander -o study-turboexpander -> study-turboexpander/report.html
"""


def runs(machines):
    """(command, machine or "", its words, the page or "") in their order."""
    for line in RUNS.strip().splitlines():
        written, _, page = line.partition(" -> ")
        for machine in machines if "{m}" in line else [""]:
            words = shlex.split(written.replace("{m}", machine))
            two = words[:2] in (
                ["record", "check"],
                ["convert", "controller"],
            )  # a command of two words
            named = page or next((word for word in words if word.endswith(".html")), "")
            yield " ".join(words[: 1 + two]), machine, words, named


def printed(words, folder, columns):
    """Exit status, lines that the command prints in a terminal that wide, its error, seconds."""
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "ambrose", *words],
        cwd=folder,
        env=os.environ | {"COLUMNS": str(columns)},
        capture_output=True,
        text=True,
        check=False,
    )
    took = time.monotonic() - begun
    return done.returncode, done.stdout.splitlines(), done.stderr.strip()[-300:], took


def measured(browser, path):
    """Words and first screens of a page, and what its head states."""
    sys.path.insert(0, str(ROOT / "tests"))
    from first_screen import WIDTHS, measure

    wide, narrow = (measure(browser, path, width) for width in WIDTHS)
    text = re.sub(r"<[^>]+>", " ", path.read_text(encoding="utf-8").partition("<script")[0])
    return {
        "words": wide.words,
        "printed": wide.printed,
        "decides_1400": wide.decides,
        "decides_400": narrow.decides,
        "wider": wide.wider or narrow.wider,
        "hashes": len(set(re.findall(r"SHA-256 [0-9a-f]{8,}", text))),
    }


def main(folder, *names):
    from playwright.sync_api import sync_playwright

    from ambrose.machine.file.toml import bundled_machines

    folder = Path(folder).resolve()
    (folder / "printed").mkdir(parents=True, exist_ok=True)
    for path in FILES.iterdir():
        shutil.copy(path, folder)
    theirs = folder / "theirs.csv"  # of two decimal marks, which is refused
    theirs.write_text(theirs.read_text("utf-8").replace(",", "."), "utf-8")
    with (
        sync_playwright() as driver,
        (folder / "first_screens.jsonl").open("a", encoding="utf-8") as results,
    ):
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        machines = [name for name in bundled_machines() if name in names]
        commands = set(names) - set(machines)
        for command, machine, words, page in runs(machines or list(bundled_machines())):
            if commands and command not in commands:
                continue
            status, lines, error, took = printed(words, folder, SCREEN[1])
            name = f"{command} {machine or ' '.join(words[2:])[:50]}".strip()
            (folder / "printed" / f"{re.sub('[^a-z0-9-]+', '-', name)}.txt").write_text(
                "\n".join(lines), encoding="utf-8"
            )
            row = {"run": name, "status": status, "lines": len(lines), "took": round(took, 1)}
            row["columns"] = max(map(len, lines), default=0)
            if error and status not in (0, 1):
                row["error"] = error
            if took < QUICK and lines:
                row["columns_of_80"] = max(map(len, printed(words, folder, 80)[1]), default=0)
            if page and (folder / page).exists():
                row |= measured(browser, folder / page)
            results.write(json.dumps(row) + "\n")
            results.flush()
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
