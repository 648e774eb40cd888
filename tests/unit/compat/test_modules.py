"""Module paths of the Aerial Gym Simulator: each of the table gives its names, each that is gone says what to do."""

import subprocess
import sys
from importlib import import_module

import pytest

from aerial_gym.compat.modules import GONE, MODULES
from docs.generate.aerial_gym_names import METHODS


@pytest.mark.parametrize("path", [path for path, names in MODULES.items() if "" not in names])
def test_every_path_gives_its_names(path: str) -> None:
    module = import_module(f"aerial_gym.{path}")
    for name in module.__all__:
        first = getattr(module, name)
        space: dict[str, object] = {}
        exec(f"from aerial_gym.{path} import {name}", space)
        assert space[name] is first


@pytest.mark.parametrize("path", GONE)
def test_what_is_gone_says_what_to_do(path: str) -> None:
    words = "has no counterpart here: .+ See docs/guides/coming_from_aerial_gym.md"
    with pytest.raises(ModuleNotFoundError, match=words):
        import_module(f"aerial_gym.{path}.anything_at_all")


def test_a_missing_name_lists_the_others() -> None:
    module = import_module("aerial_gym.config.robot_config.base_quad_config")
    with pytest.raises(AttributeError, match="has no 'BaseQuadCgf' here. Known: BaseQuadCfg"):
        module.BaseQuadCgf  # noqa: B018


def test_other_missing_modules_are_missing_as_ever() -> None:
    with pytest.raises(ModuleNotFoundError, match="No module named 'aerial_gym.config.no_such_thing'$"):
        import_module("aerial_gym.config.no_such_thing")


def test_a_package_of_ours_gives_a_class_of_theirs() -> None:
    code = (
        "from aerial_gym.robots import ROBOTS, BaseMultirotor\n"
        "from aerial_gym.robots.base_multirotor import BaseMultirotor as Other\n"
        "from aerial_gym.task import task_registry\nfrom aerial_gym import AERIAL_GYM_DIRECTORY\n"
        "assert BaseMultirotor is Other and 'position_setpoint_task' in task_registry"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("path", [f"{place}.{name}" for place, methods in METHODS.items() for name in methods])
def test_every_method_is_there(path: str) -> None:
    module, _, members = path.partition(":")
    member = import_module(f"aerial_gym.compat.{module}")
    for name in members.split("."):
        member = getattr(member, name)
    assert member.__doc__
