"""Kernels that a step launches, each of which costs a GPU a microsecond or two; and what ends a capture of a CUDA graph: making
tensors from Python numbers, and reading tensors. Dispatchers of torch see both on any device, but for arrays of NumPy, whose
functions refuse. ``tests/integration/test_cuda.py`` has what only a GPU shows."""

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any, NoReturn

import pytest
import torch
import warp as wp
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from warp._src.context import Launch

from aerial_gym import ROBOTS, Task, task_registry
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import SensorMountCfg
from aerial_gym.config.task_terms import ActionCfg
from aerial_gym.interop.rows import RowFunction
from tests.builders import simulation
from tests.refusals import assert_refused
from tests.repetitions import rare_values
from tests.unit.task.hover import begin, build_task, camera_task, rich

VIEWS = (
    "alias", "as_strided", "detach", "empty", "expand", "permute", "select", "slice", "split", "squeeze", "t", "transpose",
    "unbind", "unsqueeze", "view", "_reshape_alias", "_unsafe_view",
)  # fmt: skip
"""Operations of torch that launch nothing."""


class LaunchCounter(TorchDispatchMode):
    """Counts operations of torch that launch a kernel on a GPU, most of them one."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func._schema.name.removeprefix("aten::").split(".")[0]
        if name not in VIEWS and not name.startswith("empty"):
            self.found[name] += 1
        return func(*args, **(kwargs or {}))


EACH_ROTOR = RandomizeCfg(each_rotor=True, low=0.9, high=1.1)
DRAWN_PARAMS = {"body.mass": RandomizeCfg(low=0.9, high=1.1)}
DRAWN_PARAMS |= {"rotor.thrust_map": EACH_ROTOR, "rotor.time_constant": EACH_ROTOR}


@pytest.mark.parametrize(
    ("name", "randomize", "most"),
    [("position_setpoint_task", {}, 6), ("position_setpoint_task", DRAWN_PARAMS, 6), ("navigation_task", {}, 34)],
)
def test_a_step_launches_few_kernels(name, randomize, most, monkeypatch) -> None:
    """``most`` is what it takes today: more of them are a choice, to be made here."""
    task = build_task(replace(task_registry.get(name), randomize=randomize), 2)
    actions = torch.zeros(2, task.num_actions)
    task.reset()
    task.step(actions)
    counting, launch, by_row = LaunchCounter(), Launch.launch, RowFunction.__call__

    def count_launch(self: wp.Launch, *args: object) -> None:
        counting.found[self.kernel.key] += 1
        launch(self, *args)

    def rows(self: RowFunction, *args: Tensor, **kwargs: object) -> tuple[Tensor, ...]:
        counting.found["rows"] += 1
        return by_row(self, *args, **kwargs)

    monkeypatch.setattr(Launch, "launch", count_launch)
    monkeypatch.setattr(RowFunction, "__call__", rows)
    with counting:
        task.step(actions)
    assert sum(counting.found.values()) <= most, sorted(counting.found.items())


def test_a_reset_copies_its_mask_once() -> None:
    class Masks(TorchDispatchMode):
        copied = 0

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            self.copied += "copy_" in func._schema.name and args[1].dtype == torch.bool
            return func(*args, **(kwargs or {}))

    task = begin("navigation_task", 2)
    with Masks() as masks:
        task._reset_environments(torch.tensor([True, False]))
    assert masks.copied == 1


FORBIDDEN = {
    "aten::lift_fresh": "makes a tensor from Python numbers: torch.tensor, new_tensor",
    "aten::_local_scalar_dense": "reads a tensor: item, tolist, bool, float",
    "aten::nonzero": "has a size that depends on the data",
}


class WaitGuard(TorchDispatchMode):
    """Refuses what a captured step must not do."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.name().split(".")[0]
        assert name not in FORBIDDEN, f"{name} {FORBIDDEN[name]}"
        by_mask = name == "aten::index" and any(i is not None and i.dtype == torch.bool for i in args[1])
        assert not by_mask, "aten::index by a mask has a size that depends on the data"
        return func(*args, **(kwargs or {}))


def test_the_mode_sees_what_it_refuses() -> None:
    rows, mask = torch.ones(3), torch.tensor([True, False, True])
    with WaitGuard():
        rows.add_(1.0)
        wrongs = (lambda: torch.tensor((0.0, 1.0)), lambda: float(rows[0]), lambda: rows[mask], lambda: bool(mask[0]))
        for wrong in wrongs:
            assert_refused(AssertionError, "aten::", wrong)


LIKE_OTHERS = (
    "agile_tracking_task", "gust_rejection_task", "lidar_navigation_task", "platform_landing_task",
    "position_setpoint_task_acceleration_sim2real", "position_setpoint_task_morphy_paper",
    "position_setpoint_task_morphy_stiff", "position_setpoint_task_reconfigurable", "position_setpoint_task_sim2real",
    "position_setpoint_task_sim2real_px4", "race_of_four_task", "racing_random_track_task", "racing_split_s_task",
    "radar_navigation_task", "radar_navigation_task_held", "safe_navigation_task", "smooth_position_setpoint_task",
    "smooth_tracking_task", "tunnel_swap_task",
)  # fmt: skip
"""Their terms are those of ``lidar_navigation_task``, whose rays are others, and of ``position_setpoint_task_morphy``."""


RANDOMIZE = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "body.inertia": RandomizeCfg(low=0.9, high=1.1),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, distribution="normal", mean=1.0, std=0.03, low=0.9, high=1.1),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.0, high=0.2),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
}
DRAWN = ("position_setpoint_task", "racing_task")
"""Tasks of one kind each that are always tried with drawn parameters as well."""


def make_random_task(name: str) -> Task:
    """Return a task with drawn parameters, whose actions are velocities unless they are laid out for its robot."""
    cfg, randomize = task_registry.get(name), RANDOMIZE
    if cfg.robot == "snakey6":  # a sixth of its mass is in its base, which draws of the whole would use up
        randomize = {key: drawn for key, drawn in RANDOMIZE.items() if not key.startswith("body.")}
    tells_rotors = cfg.action.transform == "rotor_range" or "snakey" in cfg.robot
    action = ActionCfg() if tells_rotors else cfg.action
    return build_task(replace(cfg, controller="lee_velocity_control", action=action, randomize=randomize), 4)


MAKERS = {name: partial(task_registry.make_task, name, num_envs=4, device="cpu") for name in task_registry.names()}
MAKERS |= {"rich": partial(rich, 4), "seeing": partial(camera_task, 4)}
MAKERS |= {f"{name}-drawn": partial(make_random_task, name) for name in task_registry.names()}
RARE = {*LIKE_OTHERS, *(f"{name}-drawn" for name in task_registry.names() if name not in DRAWN)}


@pytest.mark.parametrize("name", rare_values(MAKERS, RARE))
def test_a_step_of_a_task_can_be_captured(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    task = MAKERS[name]()
    task.reset()
    actions = torch.zeros(task.num_envs, task.num_actions)
    task.step(actions)

    def refuse(*args: object, **options: object) -> NoReturn:
        raise AssertionError("a step copies numbers from the host")

    for function in ("as_tensor", "from_numpy", "asarray"):
        monkeypatch.setattr(torch, function, refuse)
    task.env.gtd["sim_steps"][::2] = task.cfg.episode_len_steps
    with WaitGuard():
        task.step(actions)
        task.step(actions)


def test_mounted_sensors_with_rate_and_latency_can_be_captured() -> None:
    late = {"rate_hz": 50.0, "latency_s": 0.02}
    mounts = (
        "base_depth_camera",
        SensorMountCfg(sensor="base_depth_camera", name="rear", euler=(0.0, 0.0, 3.0), **late),
        "vn100",
        SensorMountCfg(sensor="bmi088", name="tail", position=(-0.1, 0.0, 0.0), **late),
    )
    env = simulation(replace(ROBOTS.get("base_quadrotor"), sensors=mounts), "lee_velocity_control", env="landing_env")
    env.reset()
    actions, mask = torch.zeros(2, 4), torch.tensor([True, False])
    env.step(actions)
    env.render()
    with WaitGuard():
        env.step(actions)
        env.reset(mask)
        env.render()
