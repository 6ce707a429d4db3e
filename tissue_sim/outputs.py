"""Files and folders that a command will write, checked before the work begins."""

from __future__ import annotations

import json
from pathlib import Path

from tissue_sim.errors import UserError


def check_folder(path: Path, what: object) -> None:
    """Check that the folder of a file exists.

    Parameters
    ----------
    path : Path
        The file that will be written.
    what : object
        Its name in the message.

    Raises
    ------
    UserError
        Where it doesn't.
    """
    if not path.parent.is_dir():
        raise UserError(f"folder {path.parent} for {what} does not exist; make it first")


def check_file(option: str, path: Path, ending: str, what: str) -> None:
    """Check the name and the folder of a file that an option gives.

    Parameters
    ----------
    option : str
        The option.
    path : Path
        The file that will be written.
    ending : str
        The ending that its format needs.
    what : str
        Its name in the message.

    Raises
    ------
    UserError
        Where it has another ending, or its folder doesn't exist.
    """
    if path.suffix.lower() != ending:
        raise UserError(f"{option} {path} must end in {ending}")
    check_folder(path, what)


def make_folder(path: Path) -> None:
    """Make the folder that --out gives, where it doesn't exist yet.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    UserError
        Where it can't be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make folder {path}: {error.strerror}; name another with --out") from None


def write_json(path: Path, values: object) -> None:
    """Write values to a file, as JSON.

    Parameters
    ----------
    path : Path
        The file.
    values : object
        What JSON can hold.

    Raises
    ------
    UserError
        Where it can't be written.
    """
    try:
        path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None
