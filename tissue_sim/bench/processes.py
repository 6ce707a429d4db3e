"""Runs of a function beside each other, in processes of one thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence


def on_all_cores[*Given, Result](
    function: Callable[[*Given], Result],
    runs: Sequence[tuple[*Given]],
    jobs: int | None = None,
    *,
    ordered: bool = True,
) -> Iterator[Result]:
    """Yield what a function returns, in the order of its runs, of which as many are under way as there are cores.

    Each has one thread: of two, the second mostly waits for the first, and takes its core from another run.

    jobs: how many are under way instead; ordered: False yields each as soon as it is ready.
    """
    from joblib import Parallel, delayed

    count = jobs or max(1, min(len(runs), os.cpu_count() or 1))
    parallel = Parallel(n_jobs=count, return_as="generator" if ordered else "generator_unordered", batch_size=1)
    yield from parallel(delayed(function)(*arguments) for arguments in runs)
