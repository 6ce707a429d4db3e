"""Exit codes of commands."""

from tissue_sim.cli import main


def exit_code_of(*words: str) -> object:
    """Return the exit code of a command, also where its parser raises it."""
    try:
        return main(words)
    except SystemExit as end:
        return end.code
