"""What a task computes as kernels is what its torch functions compute, and what cannot be traced is said and still done."""

import logging

import pytest
import torch
from torch import Tensor

from aerial_gym.task import OBSERVATIONS, Task
from aerial_gym.task.step.row_kernels import RowKernel
from aerial_gym.task.terms.term import Term
from tests.repetitions import rare_values
from tests.unit.task.hover import begin
from tests.unit.task.navigation import make

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
        expected = rows.compute()
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
