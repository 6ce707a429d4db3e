"""Where the topics of an organ lie."""

from __future__ import annotations


def path_of(base: str, organ: str) -> str:
    """Return what comes before the topics of an organ: `base`, and the organ's name where a scene gives it one."""
    return f"{base}/{organ}" if organ else base
