"""What a task computes as kernels is what its torch functions compute; raw images among the observations."""

import logging

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.errors import UnknownNameError
from aerial_gym.task import OBSERVATIONS, Task
from aerial_gym.task.step.row_kernels import RowKernel
from aerial_gym.task.terms.term import Term
from tests.repetitions import rare_values
from tests.unit.task.hover import begin
from tests.unit.task.test_navigation import make

RARE = ("lidar_navigation_task", "radar_navigation_task", "platform_landing_task", "racing_split_s_task")
FREQUENT = ("position_setpoint_task", "navigation_task", "payload_task")


@pytest.fixture(scope="module", params=rare_values([*FREQUENT, *RARE], RARE))
def flight_task(request: pytest.FixtureRequest) -> Task:
    task = make(5, camera=True) if request.param == "navigation_task" else begin(request.param, 5)
    task.reset()
    generator = torch.Generator().manual_seed(0)
    for _ in range(3):
        task.step(2.0 * torch.rand(5, 4, generator=generator) - 1.0)
    return task


def test_kernels_of_the_shipped_tasks_compute_what_torch_does(flight_task: Task) -> None:
    """Same types and truth values; numbers within round-off of a few operations on numbers of order one to ten."""
    parts = (flight_task._judge.rows, flight_task._observer.rows, flight_task._memory)
    for rows in (part for part in parts if part is not None):
        expected = rows.compute_by_torch()
        result = rows()
        assert rows.reason is None
        assert rows.apart == ()
        assert result.keys() == expected.keys()
        for name, value in result.items():
            assert value.dtype == expected[name].dtype, name
            torch.testing.assert_close(value, expected[name], rtol=1e-5, atol=1e-5, msg=name)
    action = torch.rand(5, 4)
    expected = flight_task._actor.transform(action, **flight_task._actor.params)
    torch.testing.assert_close(flight_task._actor(action), expected, rtol=1e-5, atol=1e-5)


def test_a_term_that_cannot_be_traced_is_named_and_still_right(monkeypatch, caplog) -> None:
    def middle(robot_position: Tensor) -> Tensor:
        return robot_position.sort(dim=-1).values[:, 1:2]

    monkeypatch.setitem(OBSERVATIONS._entries, "distance", Term(name="distance", value=middle, width=1))
    with caplog.at_level(logging.WARNING):
        task = make(4)
    assert [term.term.name for term in task._observer.rows.apart] == ["distance"]
    assert "observation term 'distance' runs as torch operations of its own: torch.sort" in caplog.text
    entries = task._observer.groups["policy"]
    column = sum(entry.width for entry in entries[: [entry.cfg.term for entry in entries].index("distance")])
    obs, _ = task.reset()
    expected = middle(task.env.gtd["robot_position"])[:, 0]
    assert torch.equal(obs["observations"][:, column], expected)


def test_a_function_that_cannot_be_traced_runs_as_torch_does(caplog: pytest.LogCaptureFixture) -> None:
    order = RowKernel(lambda a: a.sort(dim=-1).values, "the order")
    a = torch.tensor([[3.0, 1.0], [1.0, 2.0]])
    for _ in range(2):
        assert order(a).tolist() == [[1.0, 3.0], [1.0, 2.0]]
    assert caplog.text.count("the order runs as many small torch operations: torch.sort") == 1


STAY = torch.tensor([-1.0, 0.0, 0.0, 0.0]).expand(2, 4)


def shares(task: Task) -> Tensor:
    """Return the camera's depths as shares of 10 m; pixels out of range (-1) count as 1."""
    pixels = task.env.gtd["depth_range_pixels"]
    return torch.where(pixels < 0.0, 1.0, pixels / 10.0)


def test_an_image_is_given_in_fewer_bits() -> None:
    cfgs = {"depth": ImageCfg(), "half": ImageCfg(dtype="float16"), "near": ImageCfg(dtype="float32", largest=5.0)}
    task = make(2, camera=True, images=cfgs)
    obs, _ = task.reset()
    seen = shares(task)
    assert (obs["depth"].dtype, obs["half"].dtype, obs["near"].dtype) == (torch.uint8, torch.float16, torch.float32)
    torch.testing.assert_close(obs["depth"].float(), 255.0 * seen, rtol=0.0, atol=0.5 + 1e-4)
    torch.testing.assert_close(obs["half"].float(), seen, rtol=2.0**-11, atol=1e-6)
    torch.testing.assert_close(obs["near"], (2.0 * seen).clamp(max=1.0), rtol=1e-6, atol=1e-6)
    space = task.observation_space["depth"]
    assert (space.shape, space.dtype) == (tuple(obs["depth"].shape[1:]), np.uint8)
    assert space.contains(obs["depth"][0].numpy())
    assert task.observation_space["half"].contains(obs["half"][0].numpy())
    with pytest.raises(UnknownNameError, match="image 'colour' reads 'rgb_pixels', which is neither"):
        make(1, camera=True, images={"colour": ImageCfg(key="rgb_pixels")})


def test_images_of_the_past_come_first_and_end_with_the_episode() -> None:
    task = make(2, camera=True, images={"depth": ImageCfg(dtype="float32", history=3)}, episode_len_steps=4)
    obs, _ = task.reset()
    first = shares(task)[:, 0]
    assert all(torch.equal(obs["depth"][:, k], first) for k in range(3))
    kept, seen = obs["depth"].clone(), [first.clone()]
    for _ in range(3):
        again, *_ = task.step(STAY)
        seen.append(shares(task)[:, 0].clone())
    assert torch.equal(obs["depth"], kept)  # what was given is not written again
    torch.testing.assert_close(again["depth"], torch.stack(seen[1:], dim=1))
    obs, *_, truncated, _ = task.step(STAY)
    assert truncated.all()
    assert all(torch.equal(obs["depth"][:, k], obs["depth"][:, 2]) for k in range(3))


def test_the_last_image_of_an_episode_is_of_its_last_instant() -> None:
    images = {"depth": ImageCfg(dtype="float32", history=2)}
    task, blind = (make(2, camera=True, images=given, episode_len_steps=5) for given in (images, {}))
    first = task.reset()[0]["depth"][:, 1].clone()
    blind.reset()
    for each in (task, blind):
        each.env.gtd["sim_steps"][1] = 3
    actions = torch.tensor([[1.0, 0.2, 0.5, 0.0], [0.5, -0.2, -0.5, 0.0]])
    seen = [first]
    for step in range(1, 8):
        obs, _, terminated, truncated, info = task.step(actions)
        again, *_ = blind.step(actions)
        ended = terminated | truncated
        assert ended.tolist() == [step == 5, step in (2, 7)]
        torch.testing.assert_close(obs["depth"][:, 1], shares(task)[:, 0])
        torch.testing.assert_close(obs["depth"][:, 1], shares(blind)[:, 0])
        assert torch.equal(obs["observations"], again["observations"])
        assert torch.equal(info["final_depth"][~ended], obs["depth"][~ended])
        torch.testing.assert_close(info["final_depth"][:, 0], seen[-1])
        if ended.any():
            assert (info["final_depth"][ended][:, 1] - obs["depth"][ended][:, 1]).abs().max() > 0.01
            assert (info["final_depth"][ended][:, 1] - seen[-1][ended]).abs().max() > 0.0
            cells = info["final_observation"][ended][:, 17:].view(-1, 8, 8)  # of the same image
            corner = info["final_depth"][ended][:, 1, :17, :30].amin(dim=(1, 2))
            torch.testing.assert_close(cells[:, 0, 0], corner)
        seen.append(obs["depth"][:, 1].clone())
