"""The gates of a race track: what counts as flown through, what is known of them, and where a training begins."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, Task, task_registry
from aerial_gym.config.environment import EnvironmentCfg, GatePlaceCfg, TrackCfg
from aerial_gym.config.task_terms import CommandCfg, ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.task.commands.gates import gate_crossing_flags
from aerial_gym.task.terms.gate_path import AT_AXIS, WAY_AROUND, WAY_STRAIGHT, gate_path_direction, gate_path_length
from tests.refusals import assert_refused
from tests.unit.task.hover import begin, build_task, make, put

STAY = torch.zeros(1, 4)


def race(num_envs: int, *, name: str = "racing_task", seed: int = 0, first_env: int = 0) -> Task:
    return begin(name, num_envs, seed=seed, first_env=first_env)


def in_gate(task: Task, gate: int, place: tuple[float, float, float]) -> Tensor:
    """Return the world position of a place in the frame of each environment's gate [m], (E, 3)."""
    gtd = task.env.gtd
    turn = gtd["gate_orientation"][:, gate]
    return gtd["gate_position"][:, gate] + quat_rotate(turn, torch.tensor([place]).expand_as(turn[:, :3]))


@pytest.mark.parametrize(("before", "now", "expected"), [
    ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (True, True)),
    ((-0.1, 0.0, 0.0), (0.0, 0.0, 0.0), (True, True)),  # onto the plane
    ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (False, False)),  # from the plane: it was crossed before
    ((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), (False, False)),  # from behind
    ((-0.2, 0.0, 0.0), (-0.1, 0.0, 0.0), (False, False)),  # not yet
    ((-0.1, 0.0, 0.0), (0.1, 0.8, 0.0), (True, False)),  # crosses at y = 0.4
    ((-0.3, 0.0, 0.0), (0.1, 0.8, 0.0), (True, False)),  # at y = 0.6
    ((-0.1, 0.0, 0.0), (0.3, 0.8, 0.0), (True, True)),  # at y = 0.2
    ((-0.1, 0.0, -0.1), (0.1, 0.0, -0.3), (True, False)),  # at z = -0.2, of 0.15
    ((-0.1, -0.3, 0.2), (0.1, -0.3, 0.0), (True, False)),  # at y = -0.3
    ((-0.1, -0.25, 0.2), (0.1, -0.15, 0.0), (True, True)),
])  # fmt: skip
def test_a_crossing_is_that_of_the_straight_line(before, now, expected) -> None:
    result = gate_crossing_flags(torch.tensor([before]), torch.tensor([now]), half=(0.25, 0.15))
    assert tuple(bool(each) for each in result) == expected


def test_every_drawn_gate_is_passed_where_it_stands() -> None:
    """Each of 50 environments has gates of its own, tilted and turned; the flight goes by teleport along their axes."""
    task = race(50)
    done = torch.zeros(50)
    for gate in range(4):
        assert task.values["target_index"].tolist() == [gate] * 50
        torch.testing.assert_close(task.target_position, task.env.gtd["gate_position"][:, gate])
        for place, passes in (((-0.1, 0.1, 0.1), False), ((0.1, 0.1, 0.1), True)):
            task.values["previous_position"].copy_(in_gate(task, gate, (-0.1, 0.1, 0.1)))
            put(task, in_gate(task, gate, place))
            *_, info = task.step(torch.zeros(50, 4))
            assert info["gate_passed"].tolist() == [passes] * 50
            done += info["successes"]
    assert done.tolist() == [1.0] * 50
    assert task.values["target_index"].tolist() == [0] * 50  # in a new episode


@pytest.mark.parametrize(("before", "place", "passed", "missed"), [
    ((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), False, False),
    ((-0.1, 0.5, 0.0), (0.1, 0.5, 0.0), False, True),
    ((-0.1, 0.0, 0.5), (0.1, 0.0, 0.5), False, True),
    ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), True, False),
])  # fmt: skip
def test_from_behind_and_beside_is_no_passage(before, place, passed, missed) -> None:
    task = race(20)
    task.values["previous_position"].copy_(in_gate(task, 0, before))
    put(task, in_gate(task, 0, place))
    *_, info = task.step(torch.zeros(20, 4))
    assert (info["gate_passed"].tolist(), task.values["gate_missed"].tolist()) == ([passed] * 20, [missed] * 20)


def gate_offsets(task: Task, obs: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Return the observed position of the next gate and direction through it, rotated to the world frame, (E, 3) each."""
    told = obs["observations"][:, 26:32]
    turn, position = task.env.gtd["robot_vehicle_orientation"], task.env.gtd["robot_position"]
    return position + quat_rotate(turn, told[:, :3]), quat_rotate(turn, told[:, 3:])


def test_a_gate_is_known_exactly_once_it_was_close() -> None:
    """Seen from above: 0.71 m away it is where it should be, 0.69 m away, at any height, where it is; and so it stays."""
    task = race(30)
    gtd, ahead = task.env.gtd, torch.tensor([[1.0, 0.0, 0.0]]).expand(30, 3)
    there, should = gtd["gate_position"][:, 0].clone(), gtd["gate_nominal_position"][:, 0].clone()
    turned = [quat_rotate(gtd[key][:, 0], ahead) for key in ("gate_orientation", "gate_nominal_orientation")]
    for distance, exact in ((0.71, False), (0.69, True), (1.5, True)):
        away = torch.tensor([[-0.6 * distance, 0.8 * distance, 1.3]])  # above everything
        put(task, there + away)
        obs, *_ = task.step(torch.zeros(30, 4))
        place, way = gate_offsets(task, obs)
        assert task.values["gates_seen"][:, 0].tolist() == [exact] * 30
        torch.testing.assert_close(place, there if exact else should, atol=1e-5, rtol=0.0)
        torch.testing.assert_close(way, turned[0] if exact else turned[1], atol=1e-5, rtol=0.0)
    task.reset()
    assert not task.values["gates_seen"].any()  # the start is more than 1.5 m away


def test_poles_are_told_nearest_first() -> None:
    task = race(40)
    for k in range(3):
        put(task, torch.tensor([[0.3 * k, 0.2, 1.9]]).expand(40, 3))
        obs, *_ = task.step(torch.zeros(40, 4))
        gtd, seen = task.env.gtd, task.values["poles_seen"].unsqueeze(-1)
        known = torch.where(seen, gtd["pole_position"], gtd["pole_nominal_position"])
        away = (known - gtd["robot_position"].unsqueeze(1))[..., :2]
        expected = away.gather(1, away.norm(dim=-1).argsort(dim=1)[:, :3, None].expand(-1, -1, 2))
        turn = gtd["robot_vehicle_orientation"]
        for i, told in enumerate(obs["observations"][:, -6:].split(2, dim=-1)):
            flat = torch.cat((expected[:, i], torch.zeros(40, 1)), dim=-1)
            torch.testing.assert_close(told, quat_rotate_inverse(turn, flat)[:, :2], atol=1e-5, rtol=0.0)


@pytest.mark.parametrize(("place", "length"), [
    ((-WAY_STRAIGHT - 0.3, 0.4, 0.0), 0.5 + WAY_STRAIGHT),  # 3-4-5 to the axis, then along it
    ((-0.2, 0.0, 0.1), 0.3),
    ((-3.0, 0.0, 0.0), 3.0),
    ((0.0, 0.0, 0.0), 0.0),
    ((0.3, 0.0, WAY_AROUND + 0.4), 0.5 + WAY_AROUND),  # behind, outside of the circle
    ((0.3, WAY_AROUND - 0.4, 0.0), 0.5 + WAY_AROUND),  # behind, inside of it
])  # fmt: skip
def test_the_way_through_a_gate_by_hand(place: tuple[float, float, float], length: float) -> None:
    turn = torch.nn.functional.normalize(torch.tensor([[0.1, -0.2, 0.3, 0.9]]), dim=-1)
    middle = torch.tensor([[1.0, 2.0, 3.0]])
    robot = middle + quat_rotate(turn, torch.tensor([place]))
    torch.testing.assert_close(gate_path_length(middle, turn, robot), torch.tensor([length]), atol=1e-5, rtol=0.0)


def test_the_way_leads_where_it_gets_shorter() -> None:
    generator = torch.Generator().manual_seed(0)
    place = (4.0 * torch.rand(5000, 3, dtype=torch.float64, generator=generator) - 2.0).requires_grad_()
    upright = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64).expand(5000, 4)
    (gradient,) = torch.autograd.grad(gate_path_length(torch.zeros_like(place), upright, place).sum(), place)
    x, beside = place[:, 0], place[:, 1:].norm(dim=-1)
    clear = (beside > AT_AXIS) & ((x < 0.0) | ((x.square() + (beside - WAY_AROUND).square()).sqrt() > AT_AXIS))
    expected = -torch.nn.functional.normalize(gradient, dim=-1)[clear]
    assert int(clear.sum()) > 4500
    torch.testing.assert_close(gate_path_direction(place)[clear], expected, atol=1e-12, rtol=0.0)


def test_the_way_ahead_is_told_in_the_vehicle_frame() -> None:
    task = race(20)
    gtd, ahead = task.env.gtd, torch.tensor([[1.0, 0.0, 0.0]]).expand(20, 3)
    put(task, in_gate(task, 0, (-0.2, 0.0, 0.0)))
    obs, *_ = task.step(torch.zeros(20, 4))
    told = obs["observations"][:, 20:26]
    world = quat_rotate(gtd["robot_vehicle_orientation"], told[:, :3])
    along = quat_rotate(gtd["gate_orientation"][:, 0], ahead)
    assert float((world * along).sum(-1).min()) > 0.98
    place = quat_rotate_inverse(gtd["gate_orientation"][:, 0], gtd["robot_position"] - gtd["gate_position"][:, 0])
    torch.testing.assert_close(told[:, 3:], place, atol=1e-5, rtol=0.0)


def test_what_is_rewarded_is_the_way_from_gate_to_gate() -> None:
    task = race(20)
    column = task.reward_names.index("way")
    put(task, in_gate(task, 0, (-0.2, 0.0, 0.0)))
    task.step(torch.zeros(20, 4))
    sums = []
    for place in ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (0.15, 0.0, 0.0)):
        put(task, in_gate(task, 0, place))
        before = task.values["previous_way"].clone()
        *_, info = task.step(torch.zeros(20, 4))
        sums.append((info["reward_terms"][:, column].clone(), before))
    first, second, third = sums
    torch.testing.assert_close(second[0] - first[0], 10.0 * first[1] - torch.ones(20), atol=0.1, rtol=0.0)
    gained = 10.0 * (third[1] - task.values["previous_way"])
    torch.testing.assert_close(third[0] - second[0], gained, atol=1e-3, rtol=0.0)
    assert (gained.abs() < 1.0).all()  # 5 cm are worth half a point


def test_only_a_training_begins_behind_gates() -> None:
    task = race(3000)
    params = task.cfg.command.params
    assert not task.values["first_gate"].any()
    start = task.env.gtd["robot_position"].clone()
    task.practise()
    task.reset(seed=0)
    first, gtd = task.values["first_gate"], task.env.gtd
    assert torch.equal(first, task.values["target_index"])
    assert torch.equal(gtd["robot_position"][first == 0], start[first == 0])
    share = float(params["practice_share"])
    for gate in range(4):
        expected = 1.0 - share if gate == 0 else share / 3.0
        result = float((first == gate).float().mean())
        assert abs(result - expected) < 4.0 * (expected * (1.0 - expected) / 3000.0) ** 0.5
    for gate in range(1, 4):
        rows = first == gate
        turn = gtd["gate_orientation"][rows, gate - 1]
        away = quat_rotate_inverse(turn, gtd["robot_position"][rows] - gtd["gate_position"][rows, gate - 1])
        limit = torch.tensor(params["practice_offset"])
        assert (away.abs() <= limit + 1e-5).all()
        assert (away[:, 0] >= -1e-5).all()
        velocity = quat_rotate_inverse(turn, gtd["robot_linvel"][rows])
        assert (velocity[:, 1:].abs() < 1e-5).all()
        assert 0.0 <= float(velocity[:, 0].min()) < float(velocity[:, 0].max()) <= params["practice_speed"]
    torch.testing.assert_close(gtd["robot_state_tensor"][:, :3], gtd["robot_position"])
    told = gtd["robot_clearance"].clone()
    task.env._collision.measure()
    assert torch.equal(told, gtd["robot_clearance"])
    torch.testing.assert_close(task.values["previous_position"], gtd["robot_position"])


def fly(num_envs: int, *, name: str, first_env: int = 0) -> list[Tensor]:
    task = race(num_envs, name=name, seed=2, first_env=first_env)
    task.practise()
    obs, _ = task.reset()
    seen = [obs["observations"]]
    number = torch.arange(first_env, first_env + num_envs).unsqueeze(-1)
    for step in range(40):
        obs, reward, *_ = task.step(torch.sin(number + step + torch.arange(4.0)))
        seen += [obs["observations"], reward.unsqueeze(-1)]
    return seen


@pytest.mark.parametrize("name", ["racing_task", pytest.param("racing_random_track_task", marks=pytest.mark.slow)])
def test_a_race_is_the_same_alone_and_among_many(name: str) -> None:
    many, alone = fly(37, name=name), fly(1, name=name, first_env=17)
    for row, single in zip(many, alone, strict=True):
        assert torch.equal(row[17:18], single)


def test_a_saved_race_goes_on_as_it_would_have() -> None:
    task = race(5)
    task.practise()
    task.reset()
    state = task.save_state()
    first = [task.step(torch.ones(5, 4))[0]["observations"] for _ in range(30)]
    task.load_state(state)
    assert all(torch.equal(old, task.step(torch.ones(5, 4))[0]["observations"]) for old in first)


def test_leaving_the_arena_is_a_crash_and_lifting_off_is_not() -> None:
    task = race(4)
    low = torch.tensor([[0.0, 0.0, 2.6], [3.1, 0.0, 1.0], [0.0, -3.1, 1.0], [0.5, 1.5, -0.02]])
    put(task, low)
    *_, info = task.step(torch.zeros(4, 4))
    assert info["crashes"].tolist() == [True, True, True, False]
    for _ in range(10):
        put(task, torch.tensor([[0.5, 1.5, -0.02]]).expand(4, 3))
        *_, info = task.step(torch.zeros(4, 4))
    assert info["crashes"].tolist() == [False, False, False, True]


def with_track(env: EnvironmentCfg, **changes: object) -> Task:
    return build_task(replace(task_registry.get("racing_task"), env=env, **changes), 3)


def test_a_track_of_one_gate_has_no_earlier_gate() -> None:
    base = ENVIRONMENTS.get("racing_env")
    track = TrackCfg(gates=(GatePlaceCfg(position=(0.0, 0.0, 1.0)),), poles=((1.0, 1.0, 1.5),) * 3)
    assets = (replace(base.assets[0], count=1), replace(base.assets[1], count=3))
    task = with_track(replace(base, track=track, assets=assets))
    task.practise()
    task.reset()
    assert not task.values["first_gate"].any()


PARAMS = {"width": 0.45, "height": 0.45, "sensor_range": 0.7}


@pytest.mark.parametrize(("params", "message"), [
    ({**PARAMS, "width": 0.0}, "width = 0.0, height = 0.45: must be > 0"),
    ({**PARAMS, "practice_share": 1.5}, "practice_share = 1.5: must be 0 to 1"),
])  # fmt: skip
def test_commands_that_cannot_be_are_refused(params: dict[str, object], message: str) -> None:
    command = CommandCfg(generator="track_gates", params=params)
    assert_refused(ConfigError, message, with_track, ENVIRONMENTS.get("racing_env"), command=command)


def test_gates_of_a_track_need_a_track() -> None:
    command = CommandCfg(generator="track_gates", params=PARAMS)
    assert_refused(ConfigError, "the environment", make, 1, command=command, policy=(ObservationCfg(term="attitude"),))
