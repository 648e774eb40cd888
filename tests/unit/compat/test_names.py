"""Every method in the table of names exists, with a docstring."""

from importlib import import_module

import pytest

from docs.generate.aerial_gym_names import METHODS


@pytest.mark.parametrize("path", [f"{place}.{name}" for place, methods in METHODS.items() for name in methods])
def test_every_method_is_there(path: str) -> None:
    module, _, members = path.partition(":")
    member = import_module(f"aerial_gym.compat.{module}")
    for name in members.split("."):
        member = getattr(member, name)
    assert member.__doc__
