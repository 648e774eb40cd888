"""Scripts without their ``isaacgym`` imports."""

import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from aerial_gym.compat.helpers import get_args, parse_arguments
from aerial_gym.compat.script import run_script, without_isaacgym
from aerial_gym.math.quaternion import quat_multiply


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("import isaacgym\nx = 1\n", "pass\nx = 1\n"),
        ("import isaacgym, torch as t\n", "import torch as t\n"),
        ("from isaacgym import (\n    gymapi,\n    gymutil,\n)\nx = 1\n", "pass\n\n\n\nx = 1\n"),
        ("from isaacgym.torch_utils import quat_mul; x = 1\n", "pass; x = 1\n"),
        ("if x:\n    import isaacgym  # first\n", "if x:\n    pass  # first\n"),
        ("from isaacgymenvs import tasks\nx = 'import isaacgym'\n", "from isaacgymenvs import tasks\nx = 'import isaacgym'\n"),
    ],
)  # fmt: skip
def test_imports_are_taken_out_and_lines_stay(before: str, after: str) -> None:
    assert without_isaacgym(before) == after


def test_modules_of_a_script_may_import_what_is_not_installed(tmp_path: Path) -> None:
    (tmp_path / "my_task_module.py").write_text(
        "import isaacgym\nfrom isaacgym import gymapi, gymtorch\nfrom isaacgym.torch_utils import *\n"
        "from gym.spaces import Box\nfrom gym import spaces, Wrapper\n"
        "try:\n    gymapi.Vec3\nexcept AttributeError as error:\n    said = str(error)\n"
    )
    names = "said, Box, spaces, quat_mul, Wrapper"
    script = tmp_path / "script.py"
    script.write_text(f"from my_task_module import {names}\n")
    installed = sys.modules.get("gym")
    names = run_script(script)
    sys.modules.pop("my_task_module")
    assert names["said"].startswith("isaacgym.gymapi.Vec3: there is no Isaac Gym here.")
    assert names["quat_mul"] is quat_multiply
    assert names["Box"] is names["spaces"].Box
    inner = SimpleNamespace(reset=lambda: ("obs", "info"), step=lambda action: action + 1, task_config=7)
    wrapped = names["Wrapper"](inner)
    assert (wrapped.reset(), wrapped.step(1), wrapped.task_config) == (("obs", "info"), 2, 7)
    assert "isaacgym" not in sys.modules
    assert sys.modules.get("gym") is installed
    with pytest.raises(ModuleNotFoundError, match="No module named 'isaacgym'"):
        import_module("isaacgym")


def test_a_script_is_main_with_its_arguments_and_folder(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("value = 3\n")
    script = tmp_path / "script.py"
    script.write_text("import isaacgym, sys\nfrom beside import value\nargv, main = sys.argv[1:], __name__\n")
    before = sys.modules["__main__"], sys.argv, list(sys.path)
    names = run_script(script, ["--a", "1"])
    assert (names["value"], names["main"], names["argv"]) == (3, "__main__", ["--a", "1"])
    assert (sys.modules["__main__"], sys.argv, sys.path) == before


def test_own_flags_and_devices() -> None:
    flags = [{"name": "--num_envs", "type": int, "default": 3}, {"name": "--train", "action": "store_true"}]
    argv = ["--sim_device", "cuda:1", "--headless"]
    args = parse_arguments("A script", headless=True, custom_parameters=flags, argv=argv)
    assert (args.num_envs, args.train, args.headless) == (3, False, True)
    assert (args.sim_device, args.rl_device) == ("cuda:1", "cuda:1")
    assert (args.sim_device_type, args.compute_device_id) == ("cuda", 1)


def test_a_script_s_flag_takes_the_place_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["script.py", "--headless", "False", "--use_warp", "true"])
    args = get_args([{"name": "--num_envs", "type": int, "default": 7, "help": "how many"}])
    assert (args.num_envs, args.headless, args.use_warp) == (7, False, True)
