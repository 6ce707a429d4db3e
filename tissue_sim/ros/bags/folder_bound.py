"""Where bags may be made: anybody on the graph may set a parameter, but must not write anywhere."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.errors import UserError


class Bound:
    """The folder that bags are confined to: the one that the node was started with."""

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder).absolute()

    def inside(self, folder: str) -> Path:
        """Return a folder with links and `..` resolved, as they are now.

        Raises UserError when it is outside the bound.
        """
        try:
            bound, wanted = self._folder.resolve(), Path(folder).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL
            raise UserError(f"record_folder {folder!r} can't be used: {error}") from None
        if not wanted.is_relative_to(bound):
            raise UserError(
                f"record_folder {str(wanted)!r} is outside {str(bound)!r}, with which the node was started: bags"
                " are written there or below; restart the node with another one"
            )
        return wanted
