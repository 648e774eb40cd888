"""racing_split_s_task: gates one over the other that are flown in opposite directions, and starts of a training behind them."""

import torch

from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.task import Task
from tests.unit.task.hover import begin

NAME, UPPER, LOWER = "racing_split_s_task", 3, 4
"""Numbers of the gates that stand one over the other."""


def at_gate(task: Task, number: int) -> None:
    gate = torch.tensor(task.cfg.command.params["centers"])[number]
    yaw = torch.tensor(task.cfg.command.params["yaws"])[number]
    own, count = task.values.own, task.num_envs
    own["target_index"].fill_(number)
    own["target_position"].copy_(gate.expand(count, 3))
    own["target_direction"].copy_(torch.stack((yaw.cos(), yaw.sin())).expand(count, 2))


def put(task: Task, x: float, z: float) -> None:
    state = task.env.robot_manager.tensors.state
    state.position.copy_(torch.tensor([x, -6.0, z]))
    state.lin_vel.zero_()


def move_robot(task: Task, x: float, z: float) -> dict[str, torch.Tensor]:
    put(task, x, z)
    *_, info = task.step(torch.tensor([[-0.375, 0.0, 0.0, 0.0]]).expand(task.num_envs, -1))  # the weight
    return info


def test_one_over_the_other_is_flown_through_back_and_forth() -> None:
    with begin(NAME, 2) as task:
        at_gate(task, UPPER)
        put(task, -4.4, 3.5)
        task.values.own["previous_position"].copy_(torch.tensor([-4.4, -6.0, 3.5]))
        assert move_robot(task, -4.6, 3.5)["gate_passed"].all()
        assert (task.values["target_index"] == LOWER).all()
        assert task.target_position[0].tolist() == torch.tensor([-4.5, -6.0, 0.8]).tolist()
        torch.testing.assert_close(task.values["target_direction"][0], torch.tensor([1.0, 0.0]))
        torch.testing.assert_close(task.values["following_position"][0], torch.tensor([4.75, -0.9, 1.2]))
        assert not move_robot(task, -4.6, 0.8)["gate_passed"].any()  # down behind both
        assert move_robot(task, -4.4, 0.8)["gate_passed"].all()
        assert (task.values["target_index"] == LOWER + 1).all()


def test_the_lower_one_is_not_passed_backwards_nor_at_the_height_of_the_upper_one() -> None:
    with begin(NAME, 2) as task:
        at_gate(task, LOWER)
        task.values.own["previous_position"].copy_(torch.tensor([-4.4, -6.0, 0.8]))
        info = move_robot(task, -4.6, 0.8)
        assert not info["gate_passed"].any()
        assert not info["crashes"].any()
        info = move_robot(task, -4.4, 3.5)
        assert not info["gate_passed"].any()
        assert info["crashes"].all()  # beside the opening


def test_the_way_through_a_gate_is_told_three_ways_alike() -> None:
    with begin(NAME, 7) as task:
        task.values.own["first_gate"].copy_(torch.arange(7))
        result = task._command.next_values({**dict(task.values), "begun": torch.ones(7, dtype=torch.bool)})
    ahead = quat_rotate(result["target_orientation"], torch.tensor([1.0, 0.0, 0.0]).expand(7, 3))
    torch.testing.assert_close(ahead[:, :2], result["target_direction"], atol=1e-6, rtol=0.0)
    torch.testing.assert_close(ahead[:, 2], torch.zeros(7))
    assert torch.equal(result["following_position"][:-1], result["target_position"][1:])
    assert torch.equal(result["following_direction"][:-1], result["target_direction"][1:])
    assert torch.equal(result["following_position"][-1], result["target_position"][-1])  # the last one stays


def test_episodes_of_a_training_begin_behind_any_gate_but_the_last_and_those_of_an_evaluation_do_not() -> None:
    with begin(NAME, 2000) as task:
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
