"""What a task computes as kernels is what its torch functions compute, and what cannot be traced is said and still done."""

import logging

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.task import Task
from aerial_gym.task.by_row import ByRow
from aerial_gym.task.observations import OBSERVATIONS, ObservationTerm
from tests.unit.task.navigation import make


@pytest.fixture(scope="module", params=["position_setpoint_task", "navigation_task"])
def flown(request: pytest.FixtureRequest) -> Task:
    """A task after some steps of random actions."""
    task = make(5, camera=True) if request.param == "navigation_task" else task_registry.make_task(
        request.param, num_envs=5, device="cpu", seed=0
    )  # fmt: skip
    task.reset()
    generator = torch.Generator().manual_seed(0)
    for _ in range(3):
        task.step(2.0 * torch.rand(5, 4, generator=generator) - 1.0)
    return task


def test_kernels_of_the_shipped_tasks_compute_what_torch_does(flown: Task) -> None:
    """Same types and truth values; numbers within round-off of a few operations on numbers of order one to ten."""
    state = tuple(vars(flown.state()).values())
    actions = torch.rand(5, 4)
    pairs = [
        ((flown._observe(*state),), (flown._finite_observation(*state),)),
        (flown._judge(*flown._judged()), flown._judgement(*flown._judged())),
        ((flown._command(actions),), (flown._action.value(actions, flown._action_params),)),
    ]
    for found, expected in pairs:
        for a, b in zip(found, expected, strict=True):
            assert a.dtype == b.dtype
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5)
    assert (flown._observe.reason, flown._judge.reason, flown._command.reason) == (None, None, None)


def test_nothing_is_apart_in_the_shipped_tasks(flown: Task) -> None:
    """The image is one row of nearest distances already."""
    assert flown._apart == ()


def test_a_term_that_cannot_be_traced_is_named_and_still_right(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A median sorts, which no kernel does: it runs as torch operations, in its column."""
    middle = ObservationTerm(width=1, value=lambda state: state.position.sort(dim=-1).values[:, 1:2])
    monkeypatch.setitem(OBSERVATIONS, "distance", middle)
    with caplog.at_level(logging.WARNING):
        task = make(4)
    assert [task.cfg.observations[i].term for i in task._apart] == ["distance"]
    assert "observation term 'distance' runs as torch operations of its own: torch.sort" in caplog.text
    names = [entry.term for entry in task.cfg.observations]
    column = sum(OBSERVATIONS[name].width or 4 for name in names[: names.index("distance")])
    obs, _ = task.reset()
    expected = middle.value(task.state())[:, 0]
    assert torch.equal(obs["observations"][:, column], expected)


def test_a_function_that_cannot_be_traced_runs_as_torch_does(caplog: pytest.LogCaptureFixture) -> None:
    order = ByRow(lambda a: a.sort(dim=-1).values, "the order")
    a = torch.tensor([[3.0, 1.0], [1.0, 2.0]])
    for _ in range(2):
        assert order(a).tolist() == [[1.0, 3.0], [1.0, 2.0]]
    assert caplog.text.count("the order runs as many small torch operations: torch.sort") == 1
