"""How long the pages of the viewer take to answer, and how often pictures are sent to them for that."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import viser

from tissue_sim.rendering.organ_view import LATER

PROBE_EVERY = 0.5  # s between two looks
LOOKS = 8  # that count; a page answers when it draws, which a request comes sooner or later before
PATIENCE = 2.0  # s, after which a page that doesn't answer is hidden, and sets no pace


class Pace:
    """Asks each page now and then, in a thread of its own, as it answers when it draws its next picture.

    The way there and back takes as long each time, near or far; what differs is how long a request waits for a picture.
    pages: gives those that are there, by their numbers.
    """

    def __init__(self, pages: Callable[[], Mapping[int, viser.ClientHandle]]) -> None:
        self._pages, self._gone = pages, threading.Event()
        self._took: dict[int, tuple[float, ...]] = {}  # s, of the last looks; replaced as a whole
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def picture_time(self) -> float:
        """Return the s from one picture to the next with which no page takes more than LATER of them at once."""
        return max((max(took) - min(took) for took in list(self._took.values())), default=0.0) / LATER

    def look(self) -> None:
        """Ask every page once."""
        pages = self._pages()
        for number in set(self._took) - set(pages):
            self._took.pop(number)
        for number, page in pages.items():
            began = time.monotonic()
            try:
                page.local_storage.get_item("pace", timeout=PATIENCE)
            except TimeoutError:  # no page shows it
                self._took.pop(number, None)
                continue
            except RuntimeError:  # disconnected, or it keeps no storage, but answers
                pass
            self._took[number] = (*self._took.get(number, ()), time.monotonic() - began)[-LOOKS:]

    def close(self) -> None:
        """Ask no more."""
        self._gone.set()

    def _run(self) -> None:
        while not self._gone.wait(PROBE_EVERY):
            self.look()
