"""Notebooks and examples run on all processors; their pages find the results in .site_cache/."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

from docs_build.gallery import EXAMPLES, run_of
from docs_build.notebooks import NOTEBOOKS, cells_of


def run():
    """(path, why it does not run or "") of every notebook and example."""
    if os.environ.get("DRAFT"):
        return []
    paths = [*sorted(NOTEBOOKS.glob("*.ipynb")), *sorted(EXAMPLES.glob("[0-9]*.py"))]
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        return list(zip(paths, pool.map(failure, paths), strict=True))


def failure(path):
    """Why a notebook or an example does not run; "" where it does. In words: some exceptions do not
    pass between processes.
    """
    try:
        (cells_of if path.suffix == ".ipynb" else run_of)(path)
    except (Exception, SystemExit) as error:
        return f"{type(error).__name__}: {error}"
    return ""
