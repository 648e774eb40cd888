"""The table of docs/guides/randomise.md is the one that the code prints."""

from pathlib import Path

from aerial_gym.robots.quantities import table

PAGE = Path(__file__).parents[3] / "docs" / "guides" / "randomise.md"


def test_the_page_holds_the_table_of_all_names() -> None:
    assert table() in PAGE.read_text(encoding="utf-8"), "paste what python -m aerial_gym.robots.quantities prints"
