"""The process of a job: the command line, which ends with the server that started it.

Its standard input is a pipe from the server; where that ends, by a kill as well, the whole process
group ends.
"""

import os
import runpy
import signal
import threading


def main() -> None:
    """`ambrose` with the arguments of this process."""
    threading.Thread(target=_end_with_the_server, daemon=True).start()
    runpy.run_module("ambrose", run_name="__main__", alter_sys=True)


def _end_with_the_server() -> None:
    while os.read(0, 1024):
        pass
    os.killpg(os.getpgrp(), signal.SIGKILL)


if __name__ == "__main__":
    main()
