"""Where targets are and when they move on: against where they must be by hand or by a formula."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import torch

from aerial_gym.config.task_terms import CommandCfg, ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.task import COMMANDS, REWARDS, Command, Task
from aerial_gym.task.terms.term import Term
from tests.unit.task.hover import make

STAY = torch.zeros(3, 4)
CONTACT = {"contact": TerminationCfg(term="contact", kind="crash")}


def put(task: Task, *positions: tuple[float, float, float]) -> None:
    """Put the robots at rest somewhere; a step of 10 ms moves them by less than a millimetre."""
    state = task.env.robot_manager.tensors.state
    state.position.copy_(torch.tensor(positions))
    state.lin_vel.zero_()


def test_a_point_is_where_it_is_said() -> None:
    task = make(3, command=CommandCfg(generator="point", params={"position": [1.0, 2.0, 3.0]}))
    obs, _ = task.reset()
    assert task.target_position.tolist() == [[1.0, 2.0, 3.0]] * 3
    torch.testing.assert_close(obs["observations"][:, :3], task.target_position - task.env.gtd["robot_position"])


def test_a_task_without_a_target_has_no_distance() -> None:
    rewards = {"slow": RewardCfg(term="slow", params={"height": 1.0, "width": 1.0})}
    task = make(3, command=None, policy=(ObservationCfg(term="lin_vel_body"),), rewards=rewards, terminations=CONTACT)
    task.reset()
    *_, info = task.step(STAY)
    assert "distance" not in info
    with pytest.raises(UnknownNameError, match="reads 'target_position'"):
        _ = task.target_position


def make_task(num_envs: int) -> Task:
    command = CommandCfg(generator="drawn_pose", params={"low": (0.1, 0.2, 0.3), "high": (0.9, 0.8, 0.7)})
    task = make(num_envs, command=command, episode_len_steps=1)
    task.reset()
    return task


def test_a_drawn_heading_covers_the_turn_and_is_new_in_every_episode() -> None:
    """Quarters within four standard deviations, and both ends within a hundredth of the turn; the points are uniform too."""
    task = make_task(2000)
    first = task.values["target_yaw"].clone()
    assert ((first >= -pi) & (first <= pi)).all()
    assert float(first.min()) < -0.98 * pi < 0.98 * pi < float(first.max())
    shares = torch.histc(first, bins=4, min=-pi, max=pi) / 2000.0
    assert (shares - 0.25).abs().max() < 4.0 * (0.25 * 0.75 / 2000.0) ** 0.5
    correlation = torch.corrcoef(torch.cat([first.unsqueeze(0), task.target_position.T]))[0, 1:]
    assert correlation.abs().max() < 4.0 / 2000.0**0.5
    task.step(torch.zeros(2000, 4))
    assert (task.values["target_yaw"] != first).all()


def test_headings_of_running_episodes_stay() -> None:
    task = make_task(8)
    before, begins = task.values["target_yaw"].clone(), torch.arange(8) % 3 == 0
    task._start_episodes(begins, counted=False)
    assert torch.equal(task.values["target_yaw"] != before, begins)


POINTS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0))


@pytest.mark.parametrize("loop", [False, True])
def test_a_sequence_moves_on_where_the_robot_is_close(loop: bool) -> None:
    params = {"points": POINTS, "radius": 0.3, "loop": loop}
    done = {"done": TerminationCfg(term="sequence_done", kind="success")}
    rewards = {"reached": RewardCfg(term="target_reached", params={"value": 2.0})}
    task = make(3, command=CommandCfg(generator="sequence", params=params), terminations=done, rewards=rewards)
    task.reset()
    away, rewarded, targets = (5.0, 5.0, 5.0), [], []
    for step, point in enumerate(POINTS):
        put(task, point, away, POINTS[0] if step else away)
        obs, reward, *_, info = task.step(STAY)
        rewarded.append(reward.tolist())
        targets.append(task.values["target_index"].tolist())
        torch.testing.assert_close(obs["observations"][:, :3], task.target_position - task.env.gtd["robot_position"])
    assert rewarded == [[2.0, 0.0, 0.0], [2.0, 0.0, 2.0], [2.0, 0.0, 0.0]]
    assert targets == [[1, 0, 0], [2, 0, 1], [0, 0, 1]]  # the last one begins anew, in a new episode or by the loop
    assert info["successes"].tolist() == [not loop, False, False]
    assert task.env.gtd["sim_steps"].tolist() == [3 if loop else 0, 3, 3]
    assert task.target_position.tolist() == [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]


def test_progress_is_towards_the_target_of_the_step() -> None:
    command = CommandCfg(generator="sequence", params={"points": ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0)), "radius": 0.3})
    rewards = {"progress": RewardCfg(term="progress", params={"closer": 1.0, "further": 1.0})}
    task = make(3, command=command, rewards=rewards, terminations=CONTACT)
    task.reset()
    put(task, *[(0.0, 0.0, 0.0)] * 3)
    task.step(STAY)
    assert task.values["target_index"].tolist() == [1, 1, 1]
    _, reward, *_ = task.step(STAY)
    assert (reward.abs() < 0.01).all()


@pytest.mark.parametrize("curve", ["circle", "lemniscate", "helix"])
def test_a_trajectory_is_a_function_of_the_time_in_the_episode(curve: str) -> None:
    params = {"curve": curve, "size": (2.0, 1.0, 0.5), "period": 3.0, "center": (0.0, 0.0, 1.0)}
    entries = tuple(ObservationCfg(term=name) for name in ("target_position", "target_velocity"))
    task = make(3, command=CommandCfg(generator="trajectory", params=params), policy=entries, episode_len_steps=7)

    def place(time: float) -> np.ndarray:
        a = 2.0 * pi * time / 3.0
        x, y = np.cos(a), np.sin(a) * (np.cos(a) if curve == "lemniscate" else 1.0)
        return np.array([2.0 * x, y, 1.0 + (0.5 * np.sin(a) if curve == "helix" else 0.0)])

    def reference_motion(time: float) -> torch.Tensor:
        slope = (place(time + 1e-4) - place(time - 1e-4)) / 2e-4
        return torch.tensor(np.concatenate((place(time), slope)), dtype=torch.float32).expand(3, 6)

    obs, _ = task.reset()
    torch.testing.assert_close(obs["observations"], reference_motion(0.0), rtol=0.0, atol=1e-5)
    for step in range(1, 17):
        obs, *_, info = task.step(STAY)
        final = reference_motion(0.01 * ((step - 1) % 7 + 1))
        torch.testing.assert_close(info["final_observation"], final, rtol=0.0, atol=1e-5)
        torch.testing.assert_close(obs["observations"], reference_motion(0.01 * (step % 7)), rtol=0.0, atol=1e-5)


def test_a_random_phase_is_uniform_and_new_in_every_episode() -> None:
    params = {"curve": "circle", "size": (1.0, 1.0, 0.0), "period": 3.0, "random_phase": True}
    task = make(500, command=CommandCfg(generator="trajectory", params=params), episode_len_steps=1)
    task.reset()
    first = task.values["target_phase"].clone()
    task.step(torch.zeros(500, 4))
    assert (first != task.values["target_phase"]).all()
    shares = torch.histc(first, bins=4, min=0.0, max=2.0 * pi) / 500.0
    assert (shares - 0.25).abs().max() < 4.0 * (0.25 * 0.75 / 500.0) ** 0.5
    torch.testing.assert_close(task.target_position.norm(dim=-1), torch.ones(500))


GATES = {"centers": ((1.0, 0.0, 0.0), (1.0, 2.0, 0.0)), "yaws": (0.0, pi / 2), "width": 1.0, "height": 0.6}


def test_gates_are_passed_in_their_direction_through_their_opening() -> None:
    rewards, kinds = {"gate": RewardCfg(term="gate_passed")}, {"gate_missed": "crash", "sequence_done": "success"}
    ends = {term: TerminationCfg(term=term, kind=kind) for term, kind in kinds.items()}
    command = CommandCfg(generator="gates", params=GATES)
    task = make(3, command=command, rewards=rewards, terminations=ends, crash_reward=None)
    task.reset()
    task.values["previous_position"].copy_(torch.tensor([[0.9, 0.4, 0.2], [0.9, 0.0, 0.0], [1.1, 0.0, 0.0]]))
    result = []
    for positions in (
        [(0.9, 0.4, 0.2), (0.9, 0.0, 0.0), (1.1, 0.0, 0.0)],  # in front; in front; behind
        [(1.1, 0.45, 0.25), (1.1, 1.2, 0.0), (0.9, 0.0, 0.0)],  # passes; crosses y = 0.6: beside; from behind
        [(1.8, 1.9, 0.0), (0.9, 0.0, 0.0), (1.1, 0.0, 0.4)],  # in front of the next; in a new episode; crosses z = 0.2
        [(1.0, 2.1, 0.0), (1.1, 0.0, 0.7), (1.1, 0.0, 0.0)],  # passes the last one at x = 1.4; crosses z = 0.35: above
    ):
        put(task, *positions)
        _, reward, *_, info = task.step(STAY)
        result.append((reward.tolist(), info["crashes"].tolist(), info["successes"].tolist()))
    no = [False] * 3
    assert result[0] == ([0.0, 0.0, 0.0], no, no)
    assert result[1] == ([1.0, 0.0, 0.0], [False, True, False], no)
    assert result[2] == ([0.0, 0.0, 1.0], no, no)
    assert result[3] == ([1.0, 0.0, 0.0], [False, True, False], [True, False, False])
    assert task.values["target_index"].tolist() == [0, 0, 1]
    torch.testing.assert_close(task.target_position[2], torch.tensor([1.0, 2.0, 0.0]))
    torch.testing.assert_close(task.values["target_direction"][2], torch.tensor([0.0, 1.0]), atol=1e-6, rtol=0.0)


@pytest.mark.parametrize(("generator", "params", "message"), [
    ("points", {}, "no command generator 'points'. Did you mean 'point'"),
    ("point", {"place": 1.0}, "command point: no parameter 'place'. .*takes position"),
    ("point", {"position": (1.0, 2.0)}, "position = .*: must have 3 entries"),
    ("sequence", {"points": ()}, "parameter 'radius' is missing"),
    ("sequence", {"points": (), "radius": 1.0}, "needs at least one point"),
    ("sequence", {"points": POINTS, "radius": 0.0}, "radius = 0.0: must be > 0"),
    ("gates", {**GATES, "yaws": (0.0,)}, "2 centers and 1 yaws: needs one of each"),
    ("gates", {**GATES, "width": -1.0}, "width = -1.0, height = 0.6: must be > 0"),
    ("trajectory", {"curve": "square", "size": (1.0,) * 3, "period": 1.0}, "no curve 'square'. Known: circle, lem"),
    ("trajectory", {"curve": "circle", "size": (1.0,) * 3, "period": 0.0}, "period = 0.0: must be > 0"),
])  # fmt: skip
def test_generators_that_cannot_be_are_refused(generator: str, params: dict[str, object], message: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        make(1, command=CommandCfg(generator=generator, params=params))


def test_a_generator_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    class FleeCommand(Command):
        reads = ("robot_position",)

        def __init__(self, values, env, *, height: float) -> None:
            super().__init__(values, env)
            self._target()
            self._height = height

        def next_values(self, values):
            position = values["robot_position"]
            return {"target_position": torch.cat((position[:, :2], position[:, 2:] + self._height), dim=-1)}

    monkeypatch.setitem(COMMANDS._entries, "fleeing", FleeCommand)
    task = make(3, command=CommandCfg(generator="fleeing", params={"height": 1.5}))
    task.reset()
    for _ in range(3):
        obs, *_ = task.step(STAY)
        torch.testing.assert_close(obs["observations"][:, :3], torch.tensor([[0.0, 0.0, 1.5]] * 3))
    with pytest.raises(ConfigError, match="command fleeing: parameter 'height' is missing"):
        make(1, command=replace(task.cfg.command, params={}))


def test_a_term_that_is_no_part_of_the_kernel_sees_the_target_of_the_instant(monkeypatch: pytest.MonkeyPatch) -> None:
    params = {"curve": "circle", "size": (2.0, 1.0, 0.5), "period": 0.5}
    middle = Term(name="middle", value=lambda target_position: target_position.median(dim=-1).values)
    monkeypatch.setitem(REWARDS._entries, "middle", middle)
    command = CommandCfg(generator="trajectory", params=params)
    task = make(3, command=command, rewards={"middle": RewardCfg(term="middle")}, terminations=CONTACT)
    task.reset()
    for step in range(1, 6):
        _, reward, *_ = task.step(STAY)
        angle = 2.0 * pi * 0.01 * step / 0.5
        expected = sorted((2.0 * np.cos(angle), np.sin(angle), 0.0))[1]
        torch.testing.assert_close(reward, torch.full((3,), float(expected)), rtol=0.0, atol=1e-5)
