"""Required rules of MISRA C:2012, by cppcheck's addon, over every kind of law's code."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ambrose.annexes.synchronous.block_code import generate_run
from ambrose.code.c.code import generate, literal
from ambrose.core.checks import InvalidInput
from example_blocks import rig_block
from needs import needs

sys.path.append(str(Path(__file__).parent))
from test_run import base_of, unit_of

# advisory rules of MISRA C:2012 (with amendments 1 and 2), which the report lists as not all followed
ADVISORY = {
    *("2.3", "2.4", "2.5", "2.6", "2.7", "4.2", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5"),
    *("11.4", "11.5", "12.1", "12.3", "12.4", "13.3", "13.4", "15.1", "15.4", "15.5", "17.5"),
    *("17.8", "18.4", "18.5", "19.2", "20.1", "20.5", "20.10", "21.12"),
}
# deviations, with reasons in the report: of fixed point; of several files
FIXED_POINT, SEVERAL = {"10.1", "2.2"}, {"5.6", "5.7"}
# what a compiler says of itself, and without which cppcheck stops at the code's own #error
COMPILER = (
    *("-DDBL_MANT_DIG=53", "-DFLT_MANT_DIG=24", "-DFLT_EVAL_METHOD=0", "-DCHAR_BIT=8"),
    *("-DDBL_MAX=1.7976931348623157e308", "-DFLT_MAX=3.40282347e38f"),
    "-D__STDC_VERSION__=199901L",
)
LAWS = {
    "fixed": lambda: generate(rig_block()),
    "fixed32": lambda: generate(rig_block(), "fixed32"),
    "cascade": lambda: generate(base_of("cascade"), "float"),
    "cascade32": lambda: generate(base_of("cascade"), "fixed32"),
    "scheduled": lambda: generate(base_of("scheduled")),
    "fixed32 beside synchronous": lambda: generate_run(unit_of("fixed"), "fixed32"),
    "supervised beside synchronous": lambda: generate_run(unit_of("supervised"), "float"),
}


def broken(files, folder):
    """Rules that cppcheck finds broken in what runs on the machine."""
    for name, text in files.items():
        (folder / name).write_text(text)
    sources = [name for name in files if name.endswith(".c") and not name.endswith("_test.c")]
    command = ["cppcheck", "--addon=misra", "--std=c99", "--enable=style", "-q", *COMPILER]
    done = subprocess.run(
        [*command, *sources], cwd=folder, capture_output=True, text=True, check=False
    )
    return set(re.findall(r"misra-c2012-(\d+\.\d+)", done.stderr))


checked = needs("cppcheck")


@checked
@pytest.mark.parametrize("law", LAWS)
def test_no_required_rule_is_broken_but_those_with_a_reason(tmp_path, law):
    files = LAWS[law]()
    found = broken(files, tmp_path)
    assert found & ADVISORY  # it looked
    required = found - ADVISORY
    allowed = (FIXED_POINT if "32" in law else set()) | (SEVERAL if "beside" in law else set())
    assert required <= allowed
    report = "".join(text for name, text in files.items() if name.endswith("_report.md"))
    for rule in required:
        assert re.search(rf"\b{rule}[\s,]", report)


@checked
def test_a_broken_rule_is_found(tmp_path):
    files = LAWS["fixed"]()
    source = files["rig.c"].replace("u[o] = 0.0;", "if (o) u[o] = 0.0;", 1)
    assert {"14.4", "10.4"} & broken({**files, "rig.c": source}, tmp_path)


@pytest.mark.parametrize("value", [1e39, -1e60, 1e149, 3.41e38])
def test_no_number_is_written_that_single_precision_does_not_hold(value):
    """ "inff" was written, which no compiler reads, or a warning with a line of the source."""
    with pytest.raises(InvalidInput, match=r"at most 3\.4e\+38 in single precision"):
        literal(value, "float")
    assert float(literal(value, "double")) == value
    assert literal(3.4e38, "float") == "3.39999995e+38f"
