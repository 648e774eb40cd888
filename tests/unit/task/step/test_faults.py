"""Faults of sensors against what they are by definition: when they begin and end, what they show, who has them."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import FaultCfg, ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import Task
from tests.unit.task.hover import make

LENGTH = 12
"""Steps of an episode."""

LOST = FaultCfg(how="lost", begin_steps=(2, 5), duration_steps=(1, 4))
JUMP = FaultCfg(how="jump", begin_steps=3, duration_steps=(2, 6), size=0.5)


def fly(num_envs: int, fault: FaultCfg, *, steps: int = LENGTH - 1, **given: int) -> tuple[Task, Tensor, Tensor]:
    """Return a task, what two terms with one fault showed and what is true, (steps + 1, E, 3): from a reset on."""
    shown = ObservationCfg(term="position_error_world", fault="gps", dropout_value=-7.0, scale=2.0)
    truth = ObservationCfg(term="robot_position")
    policy, faults = (shown, replace(truth, fault="gps"), truth), {"gps": fault}
    task = make(num_envs, policy=policy, faults=faults, episode_len_steps=LENGTH, **given)
    rows = [task.reset()[0]["observations"].clone()]
    rows += [task.step(0.1 * torch.ones(num_envs, 4))[0]["observations"].clone() for _ in range(steps)]
    result = torch.stack(rows)
    torch.testing.assert_close(result[..., 3:6].isfinite(), torch.ones_like(result[..., 3:6], dtype=torch.bool))
    return task, result[..., :6], result[..., 6:]


def fault_active(task: Task) -> Tensor:
    """Return when the fault of each environment lasts, bool (LENGTH, E), from what was drawn."""
    begin, duration = task.values["fault_steps"].unbind(-1)
    time = torch.arange(LENGTH).unsqueeze(-1)
    return (time >= begin) & (time < begin + duration)


def test_a_lost_sensor_shows_its_value_from_its_step_on_for_its_duration() -> None:
    task, shown, truth = fly(40, LOST)
    gone = fault_active(task).unsqueeze(-1)
    assert torch.equal(shown[..., :3], torch.where(gone, -14.0, -2.0 * truth))  # scale comes last
    assert torch.equal(shown[..., 3:], torch.where(gone, 0.0, truth))
    begin, duration = task.values["fault_steps"].unbind(-1)
    assert set(begin.tolist()) == {2.0, 3.0, 4.0, 5.0}
    assert set(duration.tolist()) == {1.0, 2.0, 3.0, 4.0}


def test_a_jump_adds_one_offset_an_entry_to_all_that_the_sensor_says() -> None:
    task, shown, truth = fly(40, JUMP)
    jumped = fault_active(task).unsqueeze(-1)
    offsets = task.values["fault_draws"][:, 1:]
    torch.testing.assert_close(shown[..., :3], 2.0 * (-truth + jumped * offsets), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(shown[..., 3:], truth + jumped * offsets, rtol=0.0, atol=1e-6)
    assert float(offsets.abs().max()) <= 0.5
    assert float(offsets.std()) == pytest.approx(0.5 / 3**0.5, rel=0.2)  # uniform


def test_the_next_episode_has_a_fault_of_its_own() -> None:
    task, *_ = fly(20, JUMP)
    before = task.values["fault_draws"].clone()
    task.step(torch.zeros(20, 4))
    task.step(torch.zeros(20, 4))
    assert (task.values["fault_draws"] != before).all()


def test_so_many_episodes_have_it() -> None:
    """A share within 5 standard deviations of a binomial, sqrt(p (1 - p) / n)."""
    share, count = 0.3, 2000
    _, shown, _ = fly(count, replace(LOST, share=share), steps=5)
    had = (shown[..., 3:] == 0.0).all(-1).any(0)
    assert float(had.double().mean()) == pytest.approx(share, abs=5.0 * (share * (1.0 - share) / count) ** 0.5)


def test_faults_that_do_not_fit_are_refused() -> None:
    term = ObservationCfg(term="robot_position", fault="gps")
    with pytest.raises(ConfigError, match="no fault 'gps'. Known: none"):
        make(1, policy=(term,))
    with pytest.raises(ConfigError, match="TaskCfg.faults.gps: no observation has it"):
        make(1, faults={"gps": LOST})
    for fault, changes, message in (
        (LOST, {"how": "drift"}, r"FaultCfg.how = 'drift': must be lost or jump"),
        (JUMP, {"size": 0.0}, r"FaultCfg.size = 0.0: must be > 0 and finite of a jump"),
        (LOST, {"begin_steps": (5, 2)}, r"FaultCfg.begin_steps = \(5, 2\)"),
        (LOST, {"share": 0.0}, r"FaultCfg.share = 0.0"),
    ):
        with pytest.raises(ConfigError, match=message):
            replace(fault, **changes)
