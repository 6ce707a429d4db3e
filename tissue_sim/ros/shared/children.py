"""Child processes that end with their parent, in order, and whose last error line is known."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence

from tissue_sim.parent_exit import exit_with_parent

SECONDS_TO_END = 5.0
SECONDS_TO_TERMINATE = 2.0


class Child:
    """A program that runs beside this one, in a session of its own: Ctrl-C in the terminal reaches only the parent."""

    def __init__(self, name: str, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self.name = name
        self._process = subprocess.Popen(
            command,
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
            preexec_fn=exit_with_parent,  # noqa: PLW1509 - one system call, and nothing that a thread could hold
        )
        self.output: deque[str] = deque(maxlen=100)
        self.errors: deque[str] = deque(maxlen=100)
        self._readers = [
            threading.Thread(target=self._read, args=pair, daemon=True)
            for pair in ((self._process.stdout, self.output), (self._process.stderr, self.errors))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: object, lines: deque[str]) -> None:
        for line in stream:  # type: ignore[attr-defined]
            if line.strip():
                lines.append(line.rstrip())

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while it runs."""
        return self._process.poll()

    @property
    def pid(self) -> int:
        """Number of its process."""
        return self._process.pid

    def last_words(self) -> str:
        """Return how it ended, and the last line that it wrote about that."""
        for reader in self._readers:
            reader.join(timeout=1.0)
        code = self._process.poll()
        how = f"exit code {code}" if code is None or code >= 0 else f"signal {signal.Signals(-code).name}"
        line = (self.errors or self.output or [""])[-1]
        return f"{how}: {line}" if line else how

    def stop(self) -> bool:
        """Send SIGINT, later SIGTERM, and SIGKILL as the last resort; return whether it ended by itself."""
        for number, patience in ((signal.SIGINT, SECONDS_TO_END), (signal.SIGTERM, SECONDS_TO_TERMINATE)):
            if self._process.poll() is None:
                self._process.send_signal(number)
                try:
                    self._process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue
            return True
        self._process.kill()
        self._process.wait()
        return False


def stop_all(children: Sequence[Child]) -> list[str]:
    """Stop children one after the other; return the names of those that had to be killed."""
    return [child.name for child in children if not child.stop()]


def wait_a_little(deadline: float) -> None:
    """Sleep until a deadline, but only for a short time, so that signals are noticed.

    deadline: the deadline, monotonic, s.
    """
    time.sleep(max(0.0, min(0.05, deadline - time.monotonic())))
