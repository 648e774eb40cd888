"""Every method in the table of names exists, with a docstring."""

from importlib import import_module

import pytest

from aerial_gym.compat.names import METHODS, MethodName


@pytest.mark.parametrize("name", METHODS, ids=lambda name: name.script_name)
def test_every_method_is_there(name: MethodName) -> None:
    module, _, path = name.script_name.partition(":")
    member = import_module(f"aerial_gym.compat.{module}")
    for part in path.split("."):
        member = getattr(member, part)
    assert member.__doc__
