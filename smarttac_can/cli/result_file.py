"""Files and folders for results: nothing that is there is replaced without ``--force``.

What would be replaced is refused before the work begins. New results take the place of old ones
when all of them are written, so that a run that fails leaves the old ones as they were.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TextIO

import click

from smarttac_can.cli.options import Command
from smarttac_can.host.files import result_file

_FORCE: Final = f"{__name__}.force"
_MOST_NAMED: Final = 3


class _ResultPath(click.Path):
    """Path for results, refused if it holds something, unless ``--force`` was given."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; refuse one that holds something."""
        path = super().convert(value, param, ctx)
        assert isinstance(path, Path)
        if ctx is not None and not ctx.meta.get(_FORCE) and (held := _held(path)):
            raise click.ClickException(held)
        return path


def _held(path: Path) -> str:
    """Say what a path holds that results would replace; empty for nothing, and for a device."""
    if path.is_dir():
        # What is hidden is not the work of a person: .gitkeep, .DS_Store.
        names = sorted(file.name for file in path.iterdir() if not file.name.startswith("."))
        if not names:
            return ""
        more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
        listed = ", ".join([*names[:_MOST_NAMED], *more])
        return (
            f"the folder {path} is not empty ({listed}): choose another folder, or replace older "
            "results in it with --force"
        )
    if path.is_file() and path.stat().st_size:
        return f"{path} exists: choose another file, or replace it with --force"
    return ""


def _take_force(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    ctx.meta[_FORCE] = value


def force_option(text: str = "Replace older results.") -> Callable[[Command], Command]:
    """Option that lets older results be replaced, with this help; the command is not told of it."""
    return click.option(
        "--force", is_flag=True, is_eager=True, expose_value=False, callback=_take_force, help=text
    )


result_path = _ResultPath(dir_okay=False, writable=True, path_type=Path)
"""Parameter type of a file for results; the command needs a `force_option`."""
result_folder_path = _ResultPath(file_okay=False, path_type=Path)
"""The same for a folder."""
json_file_option = click.option(
    "--json",
    "json_file",
    type=result_path,
    help="File for the results; - is stdout.",
)
json_option = click.option(
    "--json",
    "json_file",
    type=result_path,
    is_flag=False,
    flag_value="-",
    help="File for the results; - is stdout, and so is none.",
)
"""The same for a command whose results are all that it prints."""


def opened_results(stack: ExitStack, json_file: Path | None) -> TextIO | None:
    """Open the file for the results before the run; None for none."""
    if json_file is None:
        return None
    if json_file == Path("-"):
        return sys.stdout
    return stack.enter_context(result_file(json_file))


def report_results(results: object, lines: Iterable[str], file: TextIO | None) -> None:
    """Write results to their file, and lines to stdout unless it has the results."""
    if file is not None:
        click.echo(json.dumps(results, indent=2), file)
    if file is not sys.stdout and (text := "\n".join(lines)):
        click.echo(text)


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder if there is none; if nothing is in it after the block, it is gone again."""
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if new:
            with suppress(OSError):  # it has results
                folder.rmdir()


@contextmanager
def result_folder(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Give an empty folder whose files take the place of old results when all of them are there.

    Parameters
    ----------
    folder
        Where they are to be; made if it does not exist.
    names
        Of all files that such results may have: old ones that were not made anew are removed.
        Files of other names stay.

    Yields
    ------
    Path
        A folder inside it, where the results are to be written.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        stack.enter_context(_made(folder))
        try:
            part = stack.enter_context(TemporaryDirectory(prefix=".part-", dir=folder))
        except OSError as error:
            error.filename = str(folder)
            raise
        try:
            yield Path(part)
        except OSError as error:
            if error.errno and error.filename is None:  # as on a full disk
                error.filename = str(folder)
            raise
        made = list(Path(part).iterdir())
        for name in {*names} - {file.name for file in made}:
            (folder / name).unlink(missing_ok=True)
        for file in made:
            file.replace(folder / file.name)
