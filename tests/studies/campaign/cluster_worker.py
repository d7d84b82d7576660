"""How a worker of a cluster of processes starts: one of them is killed in its first chunk, one is
slow in all of them. `FOLDER` has a file for each that was."""

import os
import signal
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent.parent))

from compile_once import compile_once

from smarttac_can.studies.campaign import runner

KILLED, SLOW = 0, 1
"""Names of workers."""
DELAY_S = 0.5
FOLDER = Path(os.environ.get("CLUSTER_WORKERS", "."))


def dask_setup(worker):
    compile_once()
    run_chunk = runner.run_chunk

    def killed(campaign, numbers, compiled):
        first = not (FOLDER / "killed").exists()
        (FOLDER / "killed").touch()
        made = run_chunk(campaign, numbers, compiled)
        if first:
            os.kill(os.getpid(), signal.SIGKILL)
        return made

    def slow(campaign, numbers, compiled):
        (FOLDER / "slow").touch()
        time.sleep(DELAY_S)
        return run_chunk(campaign, numbers, compiled)

    runner.run_chunk = {KILLED: killed, SLOW: slow}.get(worker.name, run_chunk)
