"""Everywhere in the tests: shapes stated in docstrings are checked, `tests/` (random_systems) and
`benchmarks` are importable.

On CI Hypothesis repeats the same cases, so that a verdict depends on the commit alone; at a desk it
looks for new ones.
"""

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
# the campaigns are commands and no part of the package
sys.path.append(str(Path(__file__).parents[1]))

import shape_contract

shape_contract.install()
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("desk", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "desk")
