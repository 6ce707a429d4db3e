"""Entry point of `tissue_sim COMMAND`: finds the command and runs it."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections.abc import Sequence
from difflib import get_close_matches

import tissue_sim
from tissue_sim import interrupts, progress
from tissue_sim.commands import COMMANDS
from tissue_sim.errors import UserError, output_is_gone, printable, stop_output
from tissue_sim.unexpected_errors import INTERRUPTED, catch_all, report_error, write_error
from tissue_sim.version import __version__

UNTIL_ASKED = (
    "demo",
    "view",
    "bridge",
    "camera",
    "drive",
)  # commands that Ctrl-C ends normally, with exit code 0; they report no progress once they run


def _with_signs(words: Sequence[str]) -> list[str]:
    """Return words in which `--seed -5,2,3` reads `--seed=-5,2,3`: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for word in words:
        signed = len(word) > 1 and word[0] == "-" and (word[1].isdigit() or word[1] == ".")
        if signed and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class _Parser(argparse.ArgumentParser):
    """Parser that reports mistakes in one line, with the word that may have been meant."""

    def error(self, message: str) -> None:  # type: ignore[override]
        chosen = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)$", message)
        if chosen:
            message += _meant(chosen[1], re.findall(r"[\w-]+", chosen[2]))
        sys.stderr.write(f"{self.prog}: error: {message} (see '{self.prog} --help')\n")
        raise SystemExit(2)


def _meant(word: str, choices: Sequence[str]) -> str:
    """Return the question whether a similar choice was meant; empty where there is none."""
    names = {choice.lstrip("-"): choice for choice in choices}  # two dashes alone make no words similar
    close = get_close_matches(word.lstrip("-"), names, n=1)
    return f"; did you mean {names[close[0]]}?" if close else ""


class _Help(argparse.ArgumentDefaultsHelpFormatter):
    """Help formatter that names a default only where there is one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, []) or action.default is False or "default:" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    arguments: arguments, None for those of the process. Returns exit code: 0, 1 for a failed check, 2 for invalid use,
    130 after Ctrl-C.
    """
    if arguments is None:  # not where another program calls this
        catch_all("tissue_sim")
        interrupts.remember()
    words = _with_signs(sys.argv[1:] if arguments is None else arguments)
    chosen = next((word for word in words if not word.startswith("-")), None)
    try:
        with progress.task(_title(words)):
            code = _run(words, chosen)
        sys.stdout.flush()  # so that a failure to write is reported here
        return code
    except (KeyboardInterrupt, Exception) as error:
        if interrupts.caused(error):
            return _stopped(" ".join(["tissue_sim", *_named(words)]), chosen in UNTIL_ASKED)
        return _failed(error)


def _stopped(title: str, until_asked: bool) -> int:
    """Write the line of a command that Ctrl-C ended; return its exit code."""
    left = interrupts.reported() or ("it had not begun" if until_asked else "")
    write_error(f"{title}: stopped{'; ' if left else ''}{left}\n")
    return 0 if until_asked else INTERRUPTED


def _failed(error: BaseException) -> int:
    """Write the line of an error that ended a command; return its exit code."""
    if isinstance(error, UserError):
        write_error(f"tissue_sim: error: {printable(str(error))}\n")
        return 2
    if isinstance(error, BrokenPipeError) and output_is_gone():
        stop_output()
        return 0
    report_error(error, "tissue_sim")
    if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
        stop_output()  # the disk may be full, where the remaining output would fail again
    return 1


def _title(words: Sequence[str]) -> str:
    return " ".join(_named(words)) or "tissue_sim"


def _named(words: Sequence[str]) -> list[str]:
    """Return the command, with its benchmark; nothing where no command is named."""
    named = [word for word in words if not word.startswith("-")]
    return named[: 2 if named[:1] == ["bench"] else 1]


def _run(words: Sequence[str], chosen: str | None) -> int:
    parser = _Parser(prog="tissue_sim", description=tissue_sim.__doc__)
    parser.add_argument("--version", action="version", version=f"tissue_sim {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for name, (module, summary) in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=_Help,
        )
        if name == chosen:
            with progress.task("loading"):
                importlib.import_module(module).add_arguments(command)
    args, unknown = parser.parse_known_args(words)
    if unknown:
        command = commands.choices[args.command]
        meant = _meant(unknown[0].partition("=")[0], re.findall(r"--[\w-]+", command.format_usage()))
        command.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
    return int(importlib.import_module(COMMANDS[args.command][0]).run(args))
