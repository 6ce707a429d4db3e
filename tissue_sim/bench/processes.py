"""Solutions of finite elements beside each other, in processes of one thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any


def on_all_cores[Result](function: Callable[..., Result], runs: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
    """Yield what a function returns, in the order of its runs, of which as many are under way as there are cores.

    Each has one thread: of two, the second mostly waits for the first, and takes its core from another run.
    """
    from joblib import Parallel, delayed

    jobs = min(len(runs), os.cpu_count() or 1)
    yield from Parallel(n_jobs=max(1, jobs), return_as="generator", batch_size=1)(
        delayed(function)(*arguments) for arguments in runs
    )
