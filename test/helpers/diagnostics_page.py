"""What the page on diagnostics explains: keys, and reasons of refusals."""

import re

from helpers.paths import ROOT

PAGE = ROOT / "docs" / "diagnostics.md"


def explained(head: str) -> set[str]:
    """Names in the first column of the page's tables with this head, and those in the line on the coupling."""
    found: set[str] = set()
    for table in re.findall(r"(?:^\|.*\n)+", PAGE.read_text(encoding="utf-8"), re.MULTILINE):
        first, _, *rows = [line.strip("| ").split(" | ")[0] for line in table.splitlines()]
        if first.strip() == head:
            found |= {name for row in rows for name in re.findall(r"`([^`]+)`", row)}
    return found


def keys() -> set[str]:
    """Keys of statuses, without the names of tools and organs before them."""
    own = {key.removesuffix(".<place>") for key in explained("key")}
    return own | {"coupling_stiffness", "coupling_bound"}


def is_explained(key: str, names: tuple[str, ...] = ()) -> bool:
    """Whether a key that a node reports is on the page; names: of its tools and organs."""
    for name in names:
        key = key.removeprefix(f"{name}.")
    known = keys()
    for before in ("refused.", "respiration.refused."):
        if key.startswith(before):
            return key.removeprefix(before) in explained("reason")
    return key in known or re.sub(r"_failures\..*", "_failures", key) in known
