"""Module paths, helpers and scripts of the Aerial Gym Simulator: each name is there, or says what to do."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from aerial_gym.compat import math as helpers
from aerial_gym.compat.helpers import get_args, parse_arguments
from aerial_gym.compat.modules import GONE, MODULES
from aerial_gym.compat.script import run_script, without_isaacgym
from aerial_gym.math.quaternion import quat_multiply
from docs.generate.aerial_gym_names import METHODS
from tests.refusals import assert_refused


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
    assert_refused(ModuleNotFoundError, words, import_module, f"aerial_gym.{path}.anything_at_all")


def test_a_missing_name_lists_the_others_and_a_missing_module_is_missing_as_ever() -> None:
    module = import_module("aerial_gym.config.robot_config.base_quad_config")
    with pytest.raises(AttributeError, match="has no 'BaseQuadCgf' here. Known: BaseQuadCfg"):
        module.BaseQuadCgf  # noqa: B018

    assert_refused(ModuleNotFoundError, "No module named", import_module, "aerial_gym.config.no_such_thing")


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


HALF = 0.5**0.5


def test_euler_angles_and_axes() -> None:
    q = helpers.quat_from_euler_xyz(torch.zeros(1), torch.zeros(1), torch.full((1,), torch.pi / 2))
    torch.testing.assert_close(q, torch.tensor([[0.0, 0.0, HALF, HALF]]))
    torch.testing.assert_close(helpers.quat_axis(q, 0), torch.tensor([[0.0, 1.0, 0.0]]), atol=1e-6, rtol=0.0)
    angles = torch.tensor([[0.3, -0.4, 1.2]], dtype=torch.float64)
    turned = helpers.quat_from_euler_xyz_tensor(angles)
    torch.testing.assert_close(helpers.get_euler_xyz_tensor(turned), angles)
    torch.testing.assert_close(torch.stack(helpers.get_euler_xyz(turned), dim=-1), angles)
    matrix = helpers.quat_to_rotation_matrix(turned)
    torch.testing.assert_close(helpers.matrix_to_euler_zyx(matrix), angles.flip(-1))
    yaw_only = helpers.get_euler_xyz_tensor(helpers.vehicle_frame_quat_from_quat(turned))
    torch.testing.assert_close(yaw_only, torch.tensor([[0.0, 0.0, 1.2]], dtype=torch.float64))


def test_every_helper_is_there_and_vee_is_the_inverse_of_the_cross_product_matrix() -> None:
    v, w = torch.tensor([1.0, 2.0, 3.0]), torch.tensor([-0.5, 0.4, 0.7])
    matrix = torch.stack([torch.linalg.cross(v, unit) for unit in torch.eye(3)], dim=-1)
    torch.testing.assert_close(helpers.compute_vee_map(matrix), v)
    torch.testing.assert_close(matrix @ w, torch.linalg.cross(v, w))
    space: dict[str, object] = {}
    exec("from aerial_gym.utils.math import *", space)
    assert all(space[name] is getattr(helpers, name) for name in helpers.__all__)


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(3.5, 3.5 - 2 * torch.pi), (-3.5, 2 * torch.pi - 3.5), (7.0, 7.0 - 2 * torch.pi)]
)
def test_ssa_wraps_into_half_a_turn(angle: float, wrapped: float) -> None:
    assert helpers.ssa(torch.tensor([angle])).item() == pytest.approx(wrapped, abs=1e-5)


def test_draws_lie_between_their_limits_and_follow_torch_s_seed() -> None:
    low, high = torch.tensor([[0.0, 5.0]]).repeat(1000, 1), torch.tensor([[1.0, 5.5]]).repeat(1000, 1)
    torch.manual_seed(1)
    first = helpers.torch_rand_float_tensor(low, high)
    torch.manual_seed(1)
    assert torch.equal(first, helpers.torch_rand_float_tensor(low, high))
    assert ((first >= low) & (first <= high)).all()
    assert helpers.torch_rand_float(-1.0, 1.0, (5, 2), "cpu").abs().max() <= 1.0


def test_small_formulas() -> None:
    low, high = torch.tensor([[0.0, 0.0, 0.0]]), torch.tensor([[2.0, 4.0, 6.0]])
    state = torch.full((1, 13), 0.5)
    assert helpers.torch_interpolate_ratio(low, high, state).tolist() == [[1.0, 2.0, 3.0]]
    assert helpers.exponential_reward_function(2.0, 3.0, torch.zeros(1)).item() == 2.0
    assert helpers.exponential_penalty_function(2.0, 3.0, torch.zeros(1)).item() == 0.0
    assert helpers.exponential_penalty_function(2.0, 3.0, torch.full((1,), 10.0)).item() == pytest.approx(-2.0)
    assert helpers.pd_control(torch.ones(1), torch.ones(1), 2.0, 3.0).item() == 5.0
    assert helpers.copysign(2.0, torch.tensor([-1.0, 3.0])).tolist() == [-2.0, 2.0]
    assert helpers.tensor_clamp(torch.tensor([5.0]), torch.tensor([0.0]), torch.tensor([1.0])).tolist() == [1.0]
    assert helpers.normalize(torch.tensor([3.0, 4.0])).tolist() == pytest.approx([0.6, 0.8])
    assert helpers.to_torch([1, 2]).dtype == torch.float32


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
    assert_refused(ModuleNotFoundError, "No module named 'isaacgym'", import_module, "isaacgym")


def test_a_script_is_main_with_its_arguments_and_folder(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("value = 3\n")
    script = tmp_path / "script.py"
    script.write_text("import isaacgym, sys\nfrom beside import value\nargv, main = sys.argv[1:], __name__\n")
    before = sys.modules["__main__"], sys.argv, list(sys.path)
    names = run_script(script, ["--a", "1"])
    assert (names["value"], names["main"], names["argv"]) == (3, "__main__", ["--a", "1"])
    assert (sys.modules["__main__"], sys.argv, sys.path) == before


def test_flags_of_a_script_and_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = [{"name": "--num_envs", "type": int, "default": 3}, {"name": "--train", "action": "store_true"}]
    argv = ["--sim_device", "cuda:1", "--headless"]
    args = parse_arguments("A script", headless=True, custom_parameters=flags, argv=argv)
    assert (args.num_envs, args.train, args.headless) == (3, False, True)
    assert (args.sim_device, args.rl_device) == ("cuda:1", "cuda:1")
    assert (args.sim_device_type, args.compute_device_id) == ("cuda", 1)
    monkeypatch.setattr("sys.argv", ["script.py", "--headless", "False", "--use_warp", "true"])
    args = get_args([{"name": "--num_envs", "type": int, "default": 7, "help": "how many"}])
    assert (args.num_envs, args.headless, args.use_warp) == (7, False, True)
