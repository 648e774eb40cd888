"""The page of names says what the tables say, and every method in it is there."""

from importlib import import_module
from pathlib import Path

import pytest

from aerial_gym.compat.names import METHODS, Name
from aerial_gym.compat.page import with_names

PAGE = Path(__file__).parents[3] / "docs" / "guides" / "coming_from_aerial_gym.md"


def test_the_page_is_made_from_the_tables() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_names(text), f"run: python -m aerial_gym.compat.page {PAGE}"


@pytest.mark.parametrize("name", METHODS, ids=lambda name: name.theirs)
def test_every_method_is_there(name: Name) -> None:
    module, _, path = name.theirs.partition(":")
    found = import_module(f"aerial_gym.compat.{module}")
    for part in path.split("."):
        found = getattr(found, part)
    assert found.__doc__
