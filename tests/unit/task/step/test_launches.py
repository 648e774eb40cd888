"""How many kernels a step launches: on a GPU each costs a microsecond or two, whatever it does."""

from collections import Counter
from dataclasses import replace

import pytest
import torch
import warp as wp
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from warp._src.context import Launch

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.interop.rows import RowFunction
from aerial_gym.task import task_registry
from tests.unit.task.hover import begin, build_task

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
RANDOMIZE = {"body.mass": RandomizeCfg(low=0.9, high=1.1)}
RANDOMIZE |= {"rotor.thrust_map": EACH_ROTOR, "rotor.time_constant": EACH_ROTOR}


@pytest.mark.parametrize(
    ("name", "randomize", "most"),
    [("position_setpoint_task", {}, 6), ("position_setpoint_task", RANDOMIZE, 6), ("navigation_task", {}, 34)],
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
        task._begin(torch.tensor([True, False]))
    assert masks.copied == 1
