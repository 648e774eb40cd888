"""Tables of results in markdown, and their place on a page."""

from collections.abc import Iterable, Sequence
from pathlib import Path


def table_row(cells: Iterable[object]) -> str:
    """Return a line of a table."""
    return f"| {' | '.join(map(str, cells))} |"


def table(heads: Sequence[str], rows: Iterable[Iterable[object]] = ()) -> str:
    """Return a table with its head."""
    return "\n".join(map(table_row, (heads, ["---"] * len(heads), *rows)))


def insert_between_marks(page: Path, begin: str, end: str, text: str) -> None:
    """Write a text between two marks of a page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    page.write_text(f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}", encoding="utf-8")
