"""How far a long calculation is, on the terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


class Bars:
    """A bar for each stage on a terminal, and a line when it is done."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """See calibrate.Progress."""
        started = time.perf_counter()
        last = ""
        # disable=None: tqdm stays silent where standard error is no terminal.
        with tqdm(total=total, desc=name, disable=None, leave=False, dynamic_ncols=True) as bar:

            def done(remark: str = "") -> None:
                nonlocal last
                last = remark or last
                bar.update(1)
                bar.set_postfix_str(last)

            yield done
        seconds = time.perf_counter() - started
        print(f"{name}: {last + ', ' if last else ''}{seconds:.1f} s", flush=True)
