"""Output of commands: tables on stdout, a progress bar on stderr with an estimate of the time left, and pages."""

import sys
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from aerial_gym.config.console import progress_console


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that takes a description of the work and the share that is done."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=progress_console(), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)


def print_table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), *, title: str | None = None) -> None:
    """Print a table of texts; without ``head`` it has no line of column names."""
    table = Table(*head, title=title, title_justify="left", box=None, pad_edge=False, show_header=bool(head))
    for row in rows:
        table.add_row(*row)
    Console(markup=False).print(table)


def open_in_browser(page: Path) -> None:
    """Open a page in the user's browser; without one, say so on stderr."""
    if not webbrowser.open(page.resolve().as_uri()):
        print(f"--open: this machine has no browser. Open {page} in another one", file=sys.stderr)
