"""A Dask cluster of real processes."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from helpers.patience import LIMIT, wait_for

WORKERS = 2


@contextmanager
def cluster_in(folder: Path) -> Iterator[tuple[str, Any]]:
    """A scheduler and two workers, each a process of its own: its address, and a client.

    Dask's own nanny would start a lost worker again; without it what is lost stays lost.
    """
    import distributed

    file = folder / "scheduler.json"

    def started(*words: str) -> subprocess.Popen:
        command = [sys.executable, "-m", *words, "--scheduler-file", str(file), "--no-dashboard"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    processes = [started("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0")]
    try:
        wait_for(file.exists, "no scheduler came up")
        for _ in range(WORKERS):
            processes.append(started("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny"))
        address = json.loads(wait_for(file.read_text))["address"]
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(WORKERS, timeout=LIMIT)
            yield address, client
    finally:
        for process in processes:
            process.kill()
            process.wait()
