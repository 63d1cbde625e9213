"""Everywhere in the tests: shapes stated in docstrings are checked, and `tests/` is importable (random_systems).

On CI Hypothesis repeats the same cases, so that a verdict depends on the commit alone; at a desk it looks for new ones.
"""

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

import shape_contract

shape_contract.install()
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("desk", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "desk")
