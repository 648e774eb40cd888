"""platform_landing_task, payload_task and racing_split_s_task."""

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.task import OBSERVATIONS, REWARDS, TERMINATIONS, Task, task_registry
from aerial_gym.task.terms.terminations import missed_touchdown, touchdown
from tests.unit.task.hover import begin
from tests.unit.task.hover import make as make_hover
from tests.unit.task.hover import put as put_at

NAME, STANDS = "platform_landing_task", 0.4
"""Height of the body origin [m] where the vehicle stands on the platform: 0.2 m, on skids of 0.2 m."""


def put(task: Task, *, above: float, speed: float, beside: float = 0.0) -> None:
    """Put the robots over their platforms [m], level, with their velocity and so fast downwards [m/s]."""
    state, platform = task.env.robot_manager.tensors.state, task.env.gtd["vec_root_tensor"][:, 1]
    state.position.copy_(platform[:, :3])
    state.position[:, 2] = STANDS + above
    state.position[:, 0] += beside
    state.attitude.copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
    state.lin_vel.copy_(platform[:, 7:10])
    state.lin_vel[:, 2] -= speed
    state.ang_vel.zero_()


def test_the_target_stands_on_the_platform_and_drives_with_it() -> None:
    with begin(NAME, 16) as task:
        for _ in range(5):
            before, velocity = task.target_position.clone(), task.values["target_velocity"].clone()
            task.step(torch.zeros(16, 4))  # the weight
            torch.testing.assert_close(task.target_position, before + task.env.dt * velocity, atol=1e-5, rtol=0.0)
        assert task.target_position[:, 2].tolist() == pytest.approx([STANDS] * 16)
        speed = velocity.norm(dim=-1)
        assert 0.2 - 1e-5 <= speed.min() < 0.4 < 0.6 < speed.max() <= 0.8 + 1e-5


@pytest.mark.parametrize(
    ("speed", "beside", "ended"), [(0.3, 0, "landed"), (0.7, 0, "missed"), (0.3, 0.37, "missed"), (1.3, 0, "hard")]
)
def test_a_touchdown_is_near_and_slow(speed: float, beside: float, ended: str) -> None:
    """From 5 mm above: slow on its middle, too fast, on its edge, and as fast as a crash."""
    with begin(NAME, 4, seed=3) as task:
        put(task, above=0.005, speed=speed, beside=beside)
        task.values.own["previous_relative_velocity"].copy_(torch.tensor([0.0, 0.0, -speed]))
        for _ in range(6):
            *_, info = task.step(torch.zeros(4, 4))
            if info["crashes"].any() or info["successes"].any():
                break
        means = task.episode_means()
        assert means[f"ended/{ended}"] == 1.0
        assert bool(info["successes"].all()) is (ended == "landed")


def fly(num: int, backend: str, first: int = 0) -> tuple[Tensor, Tensor]:
    """Return the robots' positions after ten steps over their platforms, (E, 3), and their ground-effect factors k, (E,)."""
    with begin(NAME, num, seed=5, backend=backend, first_env=first) as task:
        put(task, above=0.05, speed=0.0)
        for _ in range(10):
            task.step(torch.zeros(num, 4))
        assert (task.env.gtd["surface_height"] - 0.2).abs().max() < 1e-6
        return task.env.gtd["robot_position"].clone(), task.env.draws()["effects.ground_effect.k"].flatten().clone()


def test_an_environment_is_the_same_alone_and_among_others_and_on_both_backends() -> None:
    """At 0.25 m over the platform thrust as heavy as the vehicle lifts it by ``a dt² n (n + 1) / 2``, a of its own k."""
    many, k = fly(6, "warp")
    assert torch.equal(fly(1, "warp", first=4)[0], many[4:5])
    torch.testing.assert_close(fly(6, "torch")[0], many, atol=2e-6, rtol=0.0)
    share = k * (0.0635 / (4.0 * 0.25)) ** 2
    lifted = 9.81 * share / (1.0 - share) * 0.01**2 * 10 * 11 / 2
    torch.testing.assert_close(many[:, 2] - (STANDS + 0.05), lifted, rtol=0.02, atol=1e-6)


PAYLOAD_TASK = "payload_task"


def test_the_vehicle_belongs_a_link_above_the_place_of_the_load() -> None:
    with task_registry.make_task(PAYLOAD_TASK, num_envs=500, device="cpu", seed=0) as task:
        obs, _ = task.reset()
        mass, length, _ = task.env.gtd["effect_slung_payload"].unbind(-1)
        assert 0.02 <= mass.min() < 0.03 < 0.09 < mass.max() <= 0.1
        assert 0.3 <= length.min() < 0.35 < 0.95 < length.max() <= 1.0
        above = task.target_position - task.values["load_target"]
        torch.testing.assert_close(above, torch.stack((0.0 * length, 0.0 * length, length), dim=-1))
        assert (task.values["load_target"][:, 0] >= 0.5 - 1e-6).all()  # 0.75 of bounds of +-1 m
        seen = obs["observations"]
        assert seen.shape == (500, 21)
        torch.testing.assert_close(seen[:, 15:18], torch.stack((0.0 * length, 0.0 * length, -length), dim=-1))
        before = task.target_position.clone()
        task._reset_environments(torch.arange(500) < 250, counted=False)
        assert torch.equal(before[250:], task.target_position[250:])


def test_terms_of_touchdown_load_and_up_are_their_formulas() -> None:
    place, target = torch.tensor([[0.0, 0.3, 0.0], [0.0, 0.0, 0.05]]), torch.zeros(2, 3)
    velocity, own = torch.tensor([[0.0, 0.0, 0.2], [0.09, 0.0, 0.0]]), torch.tensor([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    result = REWARDS.get("load_distance_bell").value(target, place, height=3.0, width=8.0)
    torch.testing.assert_close(result, 3.0 * torch.tensor([-8.0 * 0.09, -8.0 * 0.0025]).exp())
    result = REWARDS.get("load_slow").value(velocity, height=1.0, width=2.0)
    torch.testing.assert_close(result, torch.tensor([-2.0 * 0.04, -2.0 * 0.0081]).exp())
    held = TERMINATIONS.get("load_at_rest").value(target, place, velocity, distance=0.1, speed=0.1)
    assert held.tolist() == [False, True]
    away = OBSERVATIONS.get("load_offset_world").value(place, own)
    torch.testing.assert_close(away, torch.tensor([[0.0, 0.2, 0.0], [0.0, 0.0, 0.05]]))
    relative = OBSERVATIONS.get("load_vel_world").value(velocity, own)
    torch.testing.assert_close(relative, torch.tensor([[0.0, -0.1, 0.2], [0.09, 0.0, 0.0]]))
    turn = torch.nn.functional.normalize(torch.randn(50, 4, generator=torch.Generator().manual_seed(0)), dim=-1)
    expected = quat_rotate_inverse(turn, torch.tensor([[0.0, 0.0, 1.0]]).expand(50, 3))
    torch.testing.assert_close(OBSERVATIONS.get("up_body").value(turn), expected)
    force = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 0.0]])
    place = torch.tensor([[0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.3, 0.3, 0.0], [0.0, 0.0, 0.0]])
    velocity = torch.tensor([[0.0, 0.0, -0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.4, 0.4, 0.0]])
    given = (force, torch.zeros(4, 3), place, velocity)
    assert touchdown(*given, radius=0.3, speed=0.5).tolist() == [True, False, False, False]
    assert missed_touchdown(*given, radius=0.3, speed=0.5).tolist() == [False, False, True, True]


def test_commands_without_their_asset_load_or_bounds_are_refused() -> None:
    ends = {"low": (0.1, 0.1, 0.1), "high": (0.9, 0.9, 0.9)}
    with pytest.raises(ConfigError, match="command load_point: nothing hangs on the robot"):
        make_hover(2, command=CommandCfg(generator="load_point", params=ends))
    with pytest.raises(ConfigError, match="command drawn_point: low = .*: needs 0 <= low <= high <= 1"):
        make_hover(2, command=CommandCfg(generator="drawn_point", params={**ends, "high": (0.9, 0.9, 1.1)}))
    with pytest.raises(ConfigError, match=r"command asset: name = 'boat': must be an asset with keep: true, of \[\]"):
        make_hover(2, command=CommandCfg(generator="asset", params={"name": "boat"}))


SPLIT_S_TASK, UPPER, LOWER = "racing_split_s_task", 3, 4  # Numbers of the gates that stand one over the other


def at_gate(task: Task, number: int) -> None:
    gate = torch.tensor(task.cfg.command.params["centers"])[number]
    yaw = torch.tensor(task.cfg.command.params["yaws"])[number]
    own, count = task.values.own, task.num_envs
    own["target_index"].fill_(number)
    own["target_position"].copy_(gate.expand(count, 3))
    own["target_direction"].copy_(torch.stack((yaw.cos(), yaw.sin())).expand(count, 2))


def move_robot(task: Task, x: float, z: float) -> dict[str, torch.Tensor]:
    put_at(task, (x, -6.0, z))
    *_, info = task.step(torch.tensor([[-0.375, 0.0, 0.0, 0.0]]).expand(task.num_envs, -1))  # the weight
    return info


def test_one_over_the_other_is_flown_through_back_and_forth() -> None:
    with begin(SPLIT_S_TASK, 2) as task:
        at_gate(task, UPPER)
        put_at(task, (-4.4, -6.0, 3.5))
        task.values.own["previous_position"].copy_(torch.tensor([-4.4, -6.0, 3.5]))
        assert move_robot(task, -4.6, 3.5)["gate_passed"].all()
        assert (task.values["target_index"] == LOWER).all()
        assert task.target_position[0].tolist() == torch.tensor([-4.5, -6.0, 0.8]).tolist()
        torch.testing.assert_close(task.values["target_direction"][0], torch.tensor([1.0, 0.0]))
        torch.testing.assert_close(task.values["following_position"][0], torch.tensor([4.75, -0.9, 1.2]))
        assert not move_robot(task, -4.6, 0.8)["gate_passed"].any()  # down behind both
        assert move_robot(task, -4.4, 0.8)["gate_passed"].all()
        assert (task.values["target_index"] == LOWER + 1).all()


def test_the_way_through_a_gate_is_told_three_ways_alike() -> None:
    with begin(SPLIT_S_TASK, 7) as task:
        task.values.own["first_gate"].copy_(torch.arange(7))
        result = task._command.next_values({**dict(task.values), "begun": torch.ones(7, dtype=torch.bool)})
    ahead = quat_rotate(result["target_orientation"], torch.tensor([1.0, 0.0, 0.0]).expand(7, 3))
    torch.testing.assert_close(ahead[:, :2], result["target_direction"], atol=1e-6, rtol=0.0)
    torch.testing.assert_close(ahead[:, 2], torch.zeros(7))
    assert torch.equal(result["following_position"][:-1], result["target_position"][1:])
    assert torch.equal(result["following_direction"][:-1], result["target_direction"][1:])
    assert torch.equal(result["following_position"][-1], result["target_position"][-1])  # the last one stays


def test_episodes_of_a_training_begin_behind_any_gate_but_the_last_and_those_of_an_evaluation_do_not() -> None:
    with begin(SPLIT_S_TASK, 2000) as task:
        assert (task.values["target_index"] == 0).all()
        task.practise()
        task.reset()
        first = task.values["target_index"]
        counts = torch.bincount(first.long(), minlength=7)
        assert (counts[1:] - 2000 * 0.7 / 6).abs().max() < 5.0 * (2000 * 0.7 / 6) ** 0.5
        centers = torch.tensor(task.cfg.command.params["centers"])
        behind = first > 0
        away = task.env.gtd["robot_position"][behind] - centers[first[behind].long() - 1]
        assert away.norm(dim=-1).max() < (0.5**2 + 2 * 0.4**2) ** 0.5 + 1e-3
        assert task.env.gtd["robot_linvel"][behind].norm(dim=-1).max() <= 4.0 + 1e-5
