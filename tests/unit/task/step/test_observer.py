"""Observations and commands: delays, low passes, histories, noise, dropouts, groups, and faults of sensors."""

from dataclasses import replace
from itertools import pairwise
from math import exp

import numpy as np
import pytest
import torch
from scipy.signal import lfilter
from torch import Tensor

from aerial_gym.config.task_terms import ActionCfg, FaultCfg, ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import ACTIONS, Task
from aerial_gym.task.terms.actions import Action
from tests.refusals import assert_refused
from tests.repetitions import frequent_values
from tests.unit.task.hover import make

LENGTH = 9  # Steps of an episode


def fly(**entry: object) -> tuple[Task, Tensor, Tensor]:
    """Return a task, what it showed and what is true, (steps, E, ...), over two and a half episodes of two ages."""
    entries = (ObservationCfg(term="position_error_world", **entry), ObservationCfg(term="robot_position"))
    task = make(3, policy=entries, episode_len_steps=LENGTH)
    rows = [task.reset()[0]["observations"].clone()]
    task.env.gtd["sim_steps"][1] = 4
    for step in range(2 * LENGTH + 4):
        rows.append(task.step(0.1 * torch.ones(3, 4) * (step % 3))[0]["observations"].clone())
    result = torch.stack(rows)
    return task, result[..., :-3], -result[..., -3:]  # the target is the origin


def list_episodes(row: int) -> list[list[int]]:
    """Return the numbers of observations of each episode of an environment: after the last step comes the next one's first."""
    first = LENGTH - (4 if row == 1 else 0)
    starts = [0, first, first + LENGTH, first + 2 * LENGTH, 10**6]
    return [[t for t in range(2 * LENGTH + 5) if a <= t < b] for a, b in pairwise(starts)]


@pytest.mark.parametrize(
    ("delay", "history", "scale"),
    frequent_values([(0, 1, 1.0), (2, 1, 1.0), (0, 3, 2.0), (3, 2, -0.5)], [(0, 1, 1.0), (3, 2, -0.5)]),
)
def test_an_entry_is_late_and_shows_its_past_within_the_episode(delay: int, history: int, scale: float) -> None:
    """Entry h of the oldest-first history at step t is the truth at t - delay - (H - 1 - h), or that of the first step."""
    task, shown, truth = fly(delay_steps=delay, history=history, scale=scale)
    assert task.num_observations == 3 * history + 3
    for row in range(3):
        for episode in list_episodes(row):
            for t in episode:
                times = [max(t - delay - (history - 1 - h), episode[0]) for h in range(history)]
                expected = scale * torch.cat([truth[time, row] for time in times])
                torch.testing.assert_close(shown[t, row], expected, rtol=0.0, atol=0.0)


def test_a_drawn_delay_holds_for_an_episode_and_takes_all_values() -> None:
    entries = (ObservationCfg(term="position_error_world", delay_steps=(1, 3)), ObservationCfg(term="robot_position"))
    task = make(64, policy=entries, episode_len_steps=8)
    seen = [task.reset()[0]["observations"].clone()]
    delays = task.values["observation_delay"][:, 0].clone()
    assert sorted(set(delays.tolist())) == [1.0, 2.0, 3.0]
    for _ in range(6):
        seen.append(task.step(torch.full((64, 4), 0.2))[0]["observations"].clone())
        assert torch.equal(task.values["observation_delay"][:, 0], delays)
    rows, last = torch.arange(64), torch.stack(seen)
    expected = -last[6 - delays.long(), rows, 3:]
    assert torch.equal(last[6, :, :3], expected)
    task.step(torch.zeros(64, 4))
    task.step(torch.zeros(64, 4))  # the next episodes
    assert (task.values["observation_delay"][:, 0] != delays).any()


def test_the_observation_before_a_reset_is_that_of_the_old_episode() -> None:
    task, *_ = fly(delay_steps=2, history=2)
    for _ in range(LENGTH):
        before = task.values["past_policy_0_0"].clone()
        _, _, terminated, truncated, info = task.step(torch.zeros(3, 4))
        ended = terminated | truncated
        expected = torch.cat([before[:, 0:3], before[:, 3:6]], dim=-1)  # of 3 and 2 steps before
        assert torch.equal(info["final_observation"][ended][:, :6], expected[ended])


def test_noise_comes_before_the_delay_and_is_scaled_with_the_rest() -> None:
    now, late = (
        ObservationCfg(term="position_error_world", noise_std=0.1, scale=2.0, history=history, delay_steps=delay)
        for history, delay in ((4, 0), (3, 1))
    )
    task = make(200, policy=(now,))
    task.reset()
    for _ in range(3):
        obs, *_ = task.step(torch.zeros(200, 4))
    noise = obs["observations"].view(200, 4, 3)[:, -1] / 2.0 + task.env.gtd["robot_position"]
    assert noise.std() == pytest.approx(0.1, rel=0.1)
    assert noise.mean().abs() < 0.02
    other = make(200, policy=(late,))
    other.reset()
    for _ in range(3):
        also, *_ = other.step(torch.zeros(200, 4))
    assert torch.equal(also["observations"], obs["observations"][:, :9])


def test_so_many_entries_drop_out_and_the_others_keep_their_noise() -> None:
    """A share within 5 standard deviations of a binomial, sqrt(p (1 - p) / n); others at the next step; scale comes last."""
    whole = ObservationCfg(term="position_error_world", noise_std=0.1, scale=2.0)
    shown, count, share = [], 3000, 0.8
    for entry in (whole, replace(whole, dropout=share, dropout_value=-7.0)):
        task = make(count // 3, policy=(entry,))
        first, then = task.reset()[0]["observations"].clone(), task.step(torch.zeros(count // 3, 4))[0]["observations"]
        shown.append((first, then))
    bound = 5.0 * (share * (1.0 - share) / count) ** 0.5
    lost = [dropped == -14.0 for _, dropped in zip(*shown, strict=True)]
    for full, dropped, gone in zip(*shown, lost, strict=True):
        assert float(gone.double().mean()) == pytest.approx(share, abs=bound)
        assert torch.equal(dropped[~gone], full[~gone])
    both = float((lost[0] & lost[1]).double().mean())
    assert both == pytest.approx(share**2, abs=bound)  # drawn anew


def test_a_dropped_entry_shows_what_it_held_for_so_many_steps() -> None:
    """Followed by hand beside the same task without holding, bit for bit: 12 steps, of which two end episodes."""
    dropped = ObservationCfg(term="position_error_world", noise_std=0.1, dropout=0.7, dropout_value=-7.0)
    entries = (dropped, replace(dropped, hold_steps=2))
    first, second = (make(50, policy=(entry,), episode_len_steps=5) for entry in entries)
    seen, shown = (task.reset()[0]["observations"].clone() for task in (first, second))
    begun, counts = torch.ones(50, 1, dtype=torch.bool), [0, 0, 0]
    held, age = torch.zeros(50, 3), torch.zeros(50, 3)
    for _ in range(12):
        lost = seen == -7.0
        held, age = torch.where(begun, -7.0, held), torch.where(begun, 0.0, age)
        age = torch.where(lost, age + 1.0, 0.0)
        held = torch.where(lost, torch.where(age <= 2.0, held, -7.0), seen)
        assert torch.equal(shown, held)
        events = (lost & (age > 2.0), lost & (held > -7.0), begun)
        counts = [n + int(more.sum()) for n, more in zip(counts, events, strict=True)]
        (seen, *_), (shown, _, _, truncated, _) = (task.step(torch.zeros(50, 4)) for task in (first, second))
        seen, shown = seen["observations"].clone(), shown["observations"].clone()
        begun = truncated.bool().unsqueeze(-1).clone()
    assert min(counts[:2]) > 200
    assert counts[2] == 150


def test_groups_are_given_beside_each_other() -> None:
    groups = {
        "policy": (ObservationCfg(term="position_error_world", noise_std=0.1),),
        "critic": (ObservationCfg(term="position_error_world"), ObservationCfg(term="robot_mass")),
    }
    task = make(3, observations=groups)
    obs, _ = task.reset()
    assert set(obs) == set(task.observation_space.spaces) == {"observations", "critic"}
    assert (obs["observations"].shape, obs["critic"].shape) == ((3, 3), (3, 4))
    assert torch.equal(obs["critic"][:, :3], -task.env.gtd["robot_position"])
    assert torch.equal(obs["critic"][:, 3], task.env.gtd["robot_mass"])
    *_, info = task.step(torch.zeros(3, 4))
    assert info["final_critic"].shape == (3, 4)
    with pytest.raises(ConfigError, match="observation 'observations': the name is taken"):
        make(1, observations={**groups, "observations": groups["critic"]})
    assert_refused(ConfigError, "needs a group 'policy'", make, 1, observations={"critic": groups["critic"]})


def test_a_long_past_of_a_wide_term_is_still_one_kernel() -> None:
    """A row of a kernel's input has 256 entries at most: 29 past values of 13 are more."""
    wide = tuple(ObservationCfg(term=name, history=30) for name in ("robot_state_tensor", "position_error_world"))
    task = make(2, policy=wide)
    states = [task.reset()[0]["observations"][:, -3:].clone()]
    first = task.env.gtd["robot_state_tensor"].clone()
    for _ in range(31):
        obs, *_ = task.step(torch.full((2, 4), 0.1))
        states.append(-task.env.gtd["robot_position"].clone())
    assert task._observer.rows.reason is None
    assert torch.equal(obs["observations"][:, 390:], torch.cat(states[-30:], dim=-1))
    assert torch.equal(obs["observations"][:, 377:390], task.env.gtd["robot_state_tensor"])
    assert not torch.equal(obs["observations"][:, :13], first)


FAULT_LENGTH = 12  # Steps of an episode

LOST = FaultCfg(how="lost", begin_steps=(2, 5), duration_steps=(1, 4))
JUMP = FaultCfg(how="jump", begin_steps=3, duration_steps=(2, 6), size=0.5)


def fly_with_faults(
    num_envs: int, fault: FaultCfg, *, steps: int = FAULT_LENGTH - 1, **given: int
) -> tuple[Task, Tensor, Tensor]:
    """Return a task, what two terms with one fault showed and what is true, (steps + 1, E, 3): from a reset on."""
    shown = ObservationCfg(term="position_error_world", fault="gps", dropout_value=-7.0, scale=2.0)
    truth = ObservationCfg(term="robot_position")
    policy, faults = (shown, replace(truth, fault="gps"), truth), {"gps": fault}
    task = make(num_envs, policy=policy, faults=faults, episode_len_steps=FAULT_LENGTH, **given)
    rows = [task.reset()[0]["observations"].clone()]
    rows += [task.step(0.1 * torch.ones(num_envs, 4))[0]["observations"].clone() for _ in range(steps)]
    result = torch.stack(rows)
    torch.testing.assert_close(result[..., 3:6].isfinite(), torch.ones_like(result[..., 3:6], dtype=torch.bool))
    return task, result[..., :6], result[..., 6:]


def fault_active(task: Task) -> Tensor:
    """Return when the fault of each environment lasts, bool (LENGTH, E), from what was drawn."""
    begin, duration = task.values["fault_steps"].unbind(-1)
    time = torch.arange(FAULT_LENGTH).unsqueeze(-1)
    return (time >= begin) & (time < begin + duration)


def test_a_lost_sensor_shows_its_value_from_its_step_on_for_its_duration() -> None:
    task, shown, truth = fly_with_faults(40, LOST)
    gone = fault_active(task).unsqueeze(-1)
    assert torch.equal(shown[..., :3], torch.where(gone, -14.0, -2.0 * truth))  # scale comes last
    assert torch.equal(shown[..., 3:], torch.where(gone, 0.0, truth))
    begin, duration = task.values["fault_steps"].unbind(-1)
    assert (set(begin.tolist()), set(duration.tolist())) == ({2.0, 3.0, 4.0, 5.0}, {1.0, 2.0, 3.0, 4.0})


def test_a_jump_adds_one_offset_an_entry_to_all_that_the_sensor_says() -> None:
    task, shown, truth = fly_with_faults(40, JUMP)
    jumped = fault_active(task).unsqueeze(-1)
    offsets = task.values["fault_draws"][:, 1:]
    torch.testing.assert_close(shown[..., :3], 2.0 * (-truth + jumped * offsets), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(shown[..., 3:], truth + jumped * offsets, rtol=0.0, atol=1e-6)
    assert float(offsets.abs().max()) <= 0.5
    assert float(offsets.std()) == pytest.approx(0.5 / 3**0.5, rel=0.2)  # uniform


def test_so_many_episodes_have_a_fault_of_their_own() -> None:
    task, *_ = fly_with_faults(20, JUMP)
    before = task.values["fault_draws"].clone()
    task.step(torch.zeros(20, 4))
    task.step(torch.zeros(20, 4))
    assert (task.values["fault_draws"] != before).all()
    share, count = 0.3, 2000
    _, shown, _ = fly_with_faults(count, replace(LOST, share=share), steps=5)
    had = (shown[..., 3:] == 0.0).all(-1).any(0)
    assert float(had.double().mean()) == pytest.approx(share, abs=5.0 * (share * (1.0 - share) / count) ** 0.5)


def test_faults_that_do_not_fit_are_refused() -> None:
    term = ObservationCfg(term="robot_position", fault="gps")
    assert_refused(ConfigError, "no fault 'gps'. Known: none", make, 1, policy=(term,))
    assert_refused(ConfigError, "TaskCfg.faults.gps: no observation has it", make, 1, faults={"gps": LOST})
    for fault, changes, message in (
        (LOST, {"how": "drift"}, r"FaultCfg.how = 'drift': must be one of lost, jump"),
        (JUMP, {"size": 0.0}, r"FaultCfg.size = 0.0: must be > 0 and finite of a jump"),
        (LOST, {"begin_steps": (5, 2)}, r"FaultCfg.begin_steps = \(5, 2\)"),
        (LOST, {"share": 0.0}, r"FaultCfg.share = 0.0"),
    ):
        assert_refused(ConfigError, message, replace, fault, **changes)


STEPS = 12


def commands(cfg: ActionCfg, random_commands: torch.Tensor, *, length: int = 500) -> torch.Tensor:
    task = make(random_commands.shape[1], action=cfg, episode_len_steps=length)
    task.reset()
    result = []
    for actions in random_commands:
        task.step(actions)
        key = "robot_prev_actions" if task.env.gtd["sim_steps"][0] == 0 else "robot_actions"
        result.append(task.env.gtd[key].clone())
    return torch.stack(result)


@pytest.fixture
def random_commands() -> torch.Tensor:
    return 0.2 * torch.randn(STEPS, 3, 4, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("steps", [1, 3])
def test_a_delayed_command_is_the_one_so_many_steps_earlier(steps: int, random_commands: torch.Tensor) -> None:
    result = commands(ActionCfg(delay_steps=steps), random_commands)
    times = [max(t - steps, 0) for t in range(STEPS)]
    assert torch.equal(result, random_commands[times])


def test_noise_of_a_command_is_white_and_of_its_deviation() -> None:
    """Zero actions: 12 steps of 2,000 environments and 4 entries; bounds: five standard deviations."""
    zeros = torch.zeros(STEPS, 2000, 4)
    noise = commands(ActionCfg(noise_std=0.02, delay_steps=1), zeros) / 0.02
    count = noise.numel()
    assert abs(noise.mean().item()) < 5.0 / count**0.5
    assert abs(noise.var().item() - 1.0) < 5.0 * (2.0 / count) ** 0.5
    for product in (noise[1:] * noise[:-1], noise[..., 1:] * noise[..., :-1]):
        assert abs(product.mean().item()) < 5.0 / product.numel() ** 0.5
    again = commands(ActionCfg(noise_std=0.02, delay_steps=1), zeros[:, :3]) / 0.02
    assert torch.equal(again, noise[:, :3])  # whoever else flies


@pytest.mark.parametrize(("transform", "low", "message"), [
    ("affine", (0.0,) * 3, "action affine: low has 3 numbers, but this robot takes 4. Choose a robot"),
    ("tenth", (), "action tenth: cannot be computed .IndexError"),
    ("half", (), r"action half: returns \(1, 2\) for actions \(1, 4\); the controller takes \(E, U\) = \(1, 4\)"),
])  # fmt: skip
def test_a_transform_that_gives_no_command_is_refused(transform, low, message, monkeypatch) -> None:
    monkeypatch.setitem(ACTIONS._entries, "half", Action(value=lambda actions: actions[:, :2]))
    monkeypatch.setitem(ACTIONS._entries, "tenth", Action(value=lambda actions: actions.unbind(-1)[9]))
    params = {"low": low, "high": (1.0,) * 4} if low else {}
    assert_refused(ConfigError, message, make, 1, action=ActionCfg(transform=transform, params=params))


def test_commands_forget_at_a_reset_and_are_filtered_after_their_delay(random_commands: torch.Tensor) -> None:
    result = commands(ActionCfg(delay_steps=(2, 2), filter_time_s=0.05), random_commands, length=4)
    for start in (0, 4, 8):
        fresh = commands(ActionCfg(delay_steps=2, filter_time_s=0.05), random_commands[start : start + 3])
        torch.testing.assert_close(result[start : start + 3], fresh, rtol=0.0, atol=0.0)
    result = commands(ActionCfg(filter_time_s=0.03), random_commands).double().numpy()
    gain = 1.0 - exp(-0.01 / 0.03)  # the step of the task is 10 ms
    u = random_commands.double().numpy()  # y[k] = (1 - a) y[k-1] + a u[k], begun at the first command
    expected, _ = lfilter([gain], [1.0, gain - 1.0], u, axis=0, zi=(1.0 - gain) * u[:1])
    np.testing.assert_allclose(result, expected, rtol=0.0, atol=1e-6)
    both = commands(ActionCfg(delay_steps=2, filter_time_s=0.05), random_commands)
    alone = commands(ActionCfg(filter_time_s=0.05), random_commands)
    torch.testing.assert_close(both[2:], alone[:-2], rtol=0.0, atol=0.0)


def test_a_drawn_delay_is_that_of_its_episode() -> None:
    given = torch.arange(1.0, 7.0).view(6, 1, 1).expand(6, 64, 4) * 0.01
    task = make(64, action=ActionCfg(delay_steps=(0, 2)))
    task.reset()
    delay = task.values["action_delay"][:, 0]
    assert sorted(set(delay.tolist())) == [0.0, 1.0, 2.0]
    for actions in given:
        task.step(actions)
    torch.testing.assert_close(task.env.gtd["robot_actions"][:, 0], 0.01 * (6.0 - delay))


def test_the_policys_own_action_can_be_observed() -> None:
    """Before transform and delay; 0 where an episode has just begun."""
    action = ActionCfg(transform="affine", params={"low": (0.0,) * 4, "high": (0.1,) * 4}, delay_steps=3)
    task = make(2, action=action, policy=(ObservationCfg(term="policy_action"),), episode_len_steps=2)
    obs, _ = task.reset()
    assert (obs["observations"] == 0.0).all()
    given = torch.tensor([[0.5, -0.5, 0.0, 1.0], [0.1, 0.2, 0.3, 0.4]])
    assert torch.equal(task.step(given)[0]["observations"], given)
    torch.testing.assert_close(task.env.gtd["robot_actions"], 0.05 * (given + 1.0))
    obs, *_, info = task.step(-given)
    assert (obs["observations"] == 0.0).all()
    assert torch.equal(info["final_observation"], -given)
