"""Every method in the table of names exists, with a docstring."""

from importlib import import_module

import pytest

from aerial_gym.compat.names import METHODS, Name


@pytest.mark.parametrize("name", METHODS, ids=lambda name: name.theirs)
def test_every_method_is_there(name: Name) -> None:
    module, _, path = name.theirs.partition(":")
    member = import_module(f"aerial_gym.compat.{module}")
    for part in path.split("."):
        member = getattr(member, part)
    assert member.__doc__
