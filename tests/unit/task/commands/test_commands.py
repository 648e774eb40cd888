"""Where targets are and when they move on: against where they must be by hand or by a formula."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline, make_interp_spline

from aerial_gym.config.task_terms import CommandCfg, ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.task import COMMANDS, REWARDS, Command, Task
from aerial_gym.task.commands.polynomial import control_point_weights, derivative_weights, minimum_snap_weights
from aerial_gym.task.terms.term import Term
from tests.refusals import assert_refused
from tests.unit.task.hover import make, put

STAY = torch.zeros(3, 4)
CONTACT = {"contact": TerminationCfg(term="contact", kind="crash")}


def test_a_point_is_where_it_is_said_and_without_one_there_is_no_distance() -> None:
    task = make(3, command=CommandCfg(generator="point", params={"position": [1.0, 2.0, 3.0]}))
    obs, _ = task.reset()
    assert task.target_position.tolist() == [[1.0, 2.0, 3.0]] * 3
    torch.testing.assert_close(obs["observations"][:, :3], task.target_position - task.env.gtd["robot_position"])
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
    task._reset_environments(begins, counted=False)
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
        put(task, (point, away, POINTS[0] if step else away))
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
    put(task, torch.zeros(3, 3))
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
        put(task, positions)
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
    assert_refused(ConfigError, "command fleeing: parameter", make, 1, command=replace(task.cfg.command, params={}))


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


LIMITS = {"max_speed": 8.0, "max_acceleration": 30.0}
AT_REST = [(1, np.zeros(3)), (2, np.zeros(3)), (3, np.zeros(3))]


def fit_spline(points: np.ndarray, times: np.ndarray) -> BSpline:
    """Return the spline of degree 7 through points (K, 3) that begins and ends at rest. By the theorem of Holladay and
    de Boor it has the least snap of all curves that do."""
    return make_interp_spline(times, points, k=7, bc_type=(AT_REST, AT_REST))


def tracks(num_envs: int = 5, points: int = 5, *, seed: int = 0) -> Task:
    params = {"points": points, "size": [1.5, 1.0, 0.5], "center": [0.0, 1.0, 2.0], **LIMITS}
    task = make(num_envs, command=CommandCfg(generator="polynomial", params=params), seed=seed)
    task.reset()
    return task


def read_draws(task: Task) -> tuple[np.ndarray, np.ndarray]:
    own = task.values.own
    return own["track_points"].double().view(task.num_envs, 3, -1).mT.numpy(), own["track_time"].double().numpy()


def test_polynomials_of_two_points_and_control_points_are_the_known_ones() -> None:
    """35 u^4 - 84 u^5 + 70 u^6 - 20 u^7: zero velocity, acceleration and jerk at both ends."""
    ((_, weights),) = minimum_snap_weights(2).transpose(0, 2, 1)
    np.testing.assert_allclose(weights, [0, 0, 0, 0, 35, -84, 70, -20], atol=1e-10)
    square = np.array([0.0, 0.0, 1.0]).reshape(1, 3, 1)  # u² has 0, 0, 1 and 2 u has 0, 2
    assert control_point_weights(square).ravel().tolist() == [0.0, 0.0, 1.0]
    assert control_point_weights(derivative_weights(square)).ravel().tolist() == [0.0, 2.0]


@pytest.mark.parametrize("points", [3, 5, 10])
def test_pieces_meet_with_six_derivatives_and_sum_to_one(points: int) -> None:
    """Weights of all points sum to 1, so that a track moves with its points; steps at knots are round-off of 7! terms."""
    form = minimum_snap_weights(points)
    np.testing.assert_allclose(form.sum(-1), [[1.0] + [0.0] * 7] * (points - 1), atol=1e-9)
    for _ in range(7):
        np.testing.assert_allclose(form.sum(1)[:-1], form[1:, 0], atol=1e-9 * np.abs(form).max())
        form = derivative_weights(form)


@pytest.mark.parametrize("points", [pytest.param(2, marks=pytest.mark.slow), 5])
def test_a_target_flies_the_spline_of_its_points(points: int) -> None:
    """Place, velocity and acceleration are scipy's, and so each is the derivative of the one before; at the end it
    stays. Bounds: 200 roundings of float32 of numbers of the size of the largest one."""
    task = tracks(points=points)
    knots, times = read_draws(task)
    names = ("target_position", "target_velocity", "target_acceleration")
    splines = [fit_spline(p, t * np.arange(points)) for p, t in zip(knots, times, strict=True)]
    for step in range(300):
        if step:
            task.step(torch.zeros(5, 4))
        assert (task.env.gtd["sim_steps"] == step).all()
        for order, name in enumerate(names):
            ends = (points - 1) * times
            expected = np.stack([s(min(0.01 * step, e), nu=order) for s, e in zip(splines, ends, strict=True)])
            scale = max(1.0, LIMITS["max_speed"], LIMITS["max_acceleration"]) if order else 3.0
            np.testing.assert_allclose(task.values.own[name].numpy(), expected, atol=200 * 6e-8 * scale, rtol=0)


def test_no_target_exceeds_a_limit_and_a_control_point_is_at_one() -> None:
    """Of 300 tracks, in float64: within both limits, and one of the control points is as far out as a limit allows."""
    knots, times = read_draws(tracks(300, seed=4))
    forms = (
        derivative_weights(minimum_snap_weights(5)),
        derivative_weights(derivative_weights(minimum_snap_weights(5))),
    )
    for p, t in zip(knots, times, strict=True):
        spline, at = fit_spline(p, t * np.arange(5)), np.linspace(0.0, 4.0 * t, 2001)
        shares = []
        for order, (form, limit) in enumerate(zip(forms, LIMITS.values(), strict=True), start=1):
            assert np.linalg.norm(spline(at, nu=order), axis=-1).max() <= limit * (1.0 + 1e-5)
            shares.append(np.linalg.norm(control_point_weights(form) @ p, axis=-1).max() / t**order / limit)
        assert max(shares) == pytest.approx(1.0, rel=1e-5)


def test_points_are_drawn_in_the_box_by_mask_and_by_environment() -> None:
    task = tracks(400)
    knots, times = read_draws(task)
    low, high = np.array([-1.5, 0.0, 1.5]), np.array([1.5, 2.0, 2.5])
    assert (knots >= low - 1e-6).all()
    assert (knots <= high + 1e-6).all()
    assert (knots.min((0, 1)) < low + 0.05).all()
    assert (knots.max((0, 1)) > high - 0.05).all()
    few = read_draws(tracks(3))
    assert np.array_equal(few[0], knots[:3])
    assert np.array_equal(few[1], times[:3])
    mask = torch.arange(400) % 2 == 0
    task._reset_environments(mask)
    again, later = read_draws(task)
    assert np.array_equal(again[~mask], knots[~mask])
    assert np.array_equal(later[~mask], times[~mask])
    assert (again[mask] != knots[mask]).all()


@pytest.mark.parametrize(("changes", "message"), [
    ({"points": 1}, "points = 1: must be 2 to 10"),
    ({"max_speed": 0.0}, "max_speed = 0.0: must be > 0 and finite"),
    ({"max_acceleration": float("nan")}, "max_acceleration = nan"),
    ({"size": [0.0, 0.0, 0.0]}, "and not all 0"),
])  # fmt: skip
def test_tracks_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    params = {"size": [1.0, 1.0, 1.0], **LIMITS, **changes}
    with pytest.raises(ConfigError, match=f"command polynomial: .*{message}"):
        make(1, command=CommandCfg(generator="polynomial", params=params))
