"""Tables of the pages from the code, as Markdown: the options of every command, and the node's parameters."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Iterable
from typing import Any
from unittest import mock


def parser_of(*words: str) -> argparse.ArgumentParser:
    """Return the parser of `tissue_sim WORDS`, as the command line makes it to answer --help."""
    from tissue_sim.cli import main

    asked: list[argparse.ArgumentParser] = []
    asking = mock.patch.object(argparse.ArgumentParser, "print_help", lambda parser, file=None: asked.append(parser))
    with asking, contextlib.suppress(SystemExit):
        main([*words, "--help"])
    return asked[0]


def subcommands(*words: str) -> dict[str, str]:
    """Return the summary of every command below `tissue_sim WORDS`, by its name."""
    below = [action for action in parser_of(*words)._actions if isinstance(action, argparse._SubParsersAction)]
    return {choice.dest: choice.help or "" for action in below for choice in action._choices_actions}


def options(*words: str) -> dict[str, str]:
    """Return the help of every argument of `tissue_sim WORDS`, by how it is written: `--rate RATE`, `ORGAN`."""
    parser = parser_of(*words)
    form = parser._get_formatter()
    taken = [a for a in parser._actions if not isinstance(a, argparse._HelpAction | argparse._SubParsersAction)]
    return {form._format_action_invocation(action): form._expand_help(action) for action in taken}


def options_table(*words: str) -> list[str]:
    """Return the lines of a table of the arguments of `tissue_sim WORDS`, and of one for each command below it."""
    lines = []
    if taken := options(*words):
        lines = _table(("option", ""), ((f"`{written}`", _prose(text)) for written, text in taken.items()))
    for name, summary in subcommands(*words).items():
        lines += [f"**`tissue_sim {' '.join(words)} {name}`**: {summary}.", "", *options_table(*words, name), ""]
    return lines


def parameters_table(of: str) -> list[str]:
    """Return the lines of a table of the parameters: `node`, or `tool` for those of each tool."""
    from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS

    specs, prefix = {"node": (NODE_SPECS, ""), "tool": (TOOL_SPECS, "<tool>.")}[of]
    rows = [
        (
            f"`{prefix}{spec.name}`",
            f"`{_value(spec.default)}`",
            _range(spec),
            "yes" if spec.live else "",
            _prose(spec.text),
        )
        for spec in specs
    ]
    if of == "node":
        rows.append(("`tools`", "`[left, right]`", "", "", "names of the tools"))
    return _table(("parameter", "default", "values", "live", ""), rows)


def _value(value: Any) -> str:
    """Return a value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return '""' if value == "" else str(value)


def _range(spec: Any) -> str:
    if spec.choices:
        return ", ".join(f"`{choice}`" for choice in spec.choices)
    return f"{spec.low:.7g} to {spec.high:.7g}" if spec.low is not None else ""


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    cells = [head, ("---",) * len(head), *rows]
    return ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in cells] + [""]


def _prose(text: str) -> str:
    """Return help as Markdown: <name> is no tag, * no emphasis."""
    return re.sub(r"([<>*])", r"\\\1", text)
