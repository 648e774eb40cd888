"""Tasks that cannot work, and tasks that are closed, say so in one sentence."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import SimBuilder, task_registry
from aerial_gym.errors import CapabilityError, ClosedError, ConfigError, ShapeError
from aerial_gym.rl_training import GymnasiumVectorEnv
from aerial_gym.task import OBSERVATIONS, REWARDS
from tests.unit.task.hover import begin

NAMES = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
NAMES |= {"controller_name": "lee_position_control"}


def test_terms_that_return_another_shape_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reward (E, 1) would be spread to (E, E), a wider term would shift every entry after it."""
    reward, term = REWARDS.get("distance_bell"), OBSERVATIONS.get("position_error_world")

    def replace_reward(change: Callable[[Tensor], object]) -> object:
        return replace(reward, value=lambda robot_position, *, height, width: change(robot_position * height * width))

    wide = replace(term, value=lambda robot_position: torch.cat((robot_position, robot_position), dim=-1))
    column = r"reward 'near' \(distance_bell\): returns \(4, 1\) .*\(E,\) = \(4,\)"
    whole = r"returns \(4,\) torch.int32, needs .* floating point"
    for registry, entry, message in (
        (REWARDS, replace_reward(lambda rows: rows[:, :1]), column),
        (REWARDS, replace_reward(lambda rows: rows[:, 0].int()), whole),
        (REWARDS, replace_reward(lambda rows: float(len(rows))), "returns a float, needs a tensor"),
        (OBSERVATIONS, wide, r"observation term .*returns \(4, 6\) .*\(E, width\) = \(4, 3\)"),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(registry._entries, entry.name, entry)
            with pytest.raises(ConfigError, match=message):
                task_registry.make_task("position_setpoint_task", num_envs=4, device="cpu")


@pytest.mark.parametrize(("count", "message"), [(10**10, "must be at least 1"), (2**31 - 1, "memory of cpu")])
def test_counts_that_nothing_holds_are_refused(count: int, message: str) -> None:
    with pytest.raises((ConfigError, CapabilityError), match=message):
        SimBuilder().build_env(**NAMES, num_envs=count, device="cpu")


def test_whatever_is_used_after_close_says_so() -> None:
    task = task_registry.make_task("position_setpoint_task", num_envs=4, device="cpu")
    adapter, actions = GymnasiumVectorEnv(task), torch.zeros(4, 4)
    task.reset()
    adapter.close()
    task.close()  # a second time does nothing
    env = task.env
    tasks = (task.reset, lambda: task.step(actions), lambda: task.reset(seed=1))
    envs = (env.reset, env.render, lambda: env.step(actions))
    for use in (*tasks, *envs, adapter.reset, lambda: adapter.step(actions)):
        with pytest.raises(ClosedError, match="this simulation is closed. Build a new one"):
            use()


@pytest.mark.parametrize("width", [1, 3, 5])
@pytest.mark.parametrize("name", ["position_setpoint_task", "position_setpoint_task_sim2real_px4"])
def test_actions_of_another_width_are_refused(name: str, width: int) -> None:
    with begin(name, 4) as task, pytest.raises(ShapeError, match=r"expected \(E, V\) = \(4, 4\)"):
        task.step(torch.zeros(4, width))
