"""Race tracks: what is drawn of them against its limits and its distribution, and what can be touched of a gate."""

from dataclasses import replace
from math import hypot, pi

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, EnvManager
from aerial_gym.config.environment import EnvironmentCfg, GatePlaceCfg, LayoutCfg, TrackCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler, quat_rotate
from tests.builders import simulation

ROUNDING = 1e-5
PLACES = ("gate_position", "gate_orientation", "pole_position")
NOMINAL = ("gate_nominal_position", "gate_nominal_orientation", "pole_nominal_position")


def simulate(env: str | EnvironmentCfg, num_envs: int, *, seed: int = 0, first_env: int = 0) -> EnvManager:
    sim = {"sim": "base_sim_2ms", "env": env, "num_envs": num_envs, "seed": seed, "first_env": first_env}
    return simulation("crazyflie_21_brushless_racing", "lee_attitude_control", **sim)


def assert_uniform(values: Tensor, low: float, high: float) -> None:
    """Quarters of the range hold a quarter each, within four standard deviations of the binomial share."""
    assert float(values.min()) >= low - ROUNDING
    assert float(values.max()) <= high + ROUNDING
    shares = torch.histc(values, bins=4, min=low, max=high) / values.numel()
    assert (shares - 0.25).abs().max() < 4.0 * (0.25 * 0.75 / values.numel()) ** 0.5


def test_offsets_are_uniform_about_the_listed_places() -> None:
    env = simulate("racing_env", 1000)
    env.reset()
    track, gtd = env.cfg.track, env.gtd
    listed = torch.tensor([gate.position for gate in track.gates])
    torch.testing.assert_close(gtd["gate_nominal_position"], listed.expand(1000, -1, -1))
    torch.testing.assert_close(gtd["pole_nominal_position"], torch.tensor(track.poles).expand(1000, -1, -1))
    away = gtd["gate_position"] - listed
    turn = euler_from_quat(gtd["gate_orientation"].flatten(0, 1)).unflatten(0, (1000, -1))
    turn = turn - torch.tensor([gate.euler for gate in track.gates])
    turn = (turn + pi).remainder(2.0 * pi) - pi
    poles = gtd["pole_position"] - gtd["pole_nominal_position"]
    for axis in range(3):
        assert_uniform(away[..., axis], track.gate_position_low[axis], track.gate_position_high[axis])
        assert_uniform(turn[..., axis], track.gate_euler_low[axis], track.gate_euler_high[axis])
        assert_uniform(poles[..., axis], track.pole_low[axis], track.pole_high[axis])
    pairs = torch.corrcoef(torch.cat((away, turn, poles), dim=-1).flatten(1).T) - torch.eye(36)
    assert pairs.abs().max() < 5.0 / 1000**0.5  # 630 pairs of independent numbers


def test_what_stands_there_is_what_is_told() -> None:
    env = simulate("racing_random_track_env", 10)
    env.reset()
    gtd = env.gtd
    assert torch.equal(gtd["obstacle_position"][:, :4], gtd["gate_position"])
    assert torch.equal(gtd["obstacle_orientation"][:, :4], gtd["gate_orientation"])
    assert torch.equal(gtd["obstacle_position"][:, 4:], gtd["pole_position"])


def test_a_reset_by_mask_leaves_other_tracks_alone() -> None:
    env = simulate("racing_random_track_env", 64)
    env.reset()
    mask, first = torch.arange(64) % 2 == 0, env.gtd["gate_position"].clone()
    for key in (*PLACES, *NOMINAL):
        env.gtd[key].fill_(7.0)  # what is not written shows
    env.reset(mask)
    for key in (*PLACES, *NOMINAL):
        assert (env.gtd[key][~mask] == 7.0).all(), key
        assert (env.gtd[key][mask] != 7.0).all(), key
    assert (env.gtd["gate_position"][mask] != first[mask]).all()


def test_a_drawn_track_keeps_its_distances() -> None:
    """Within its rectangle always; distances where there is room, which is so in 19 of 20 tracks at the least."""
    env = simulate("racing_random_track_env", 2000)
    env.reset()
    layout, gtd = env.cfg.track.layout, env.gtd
    gates, poles, start = gtd["gate_nominal_position"], gtd["pole_nominal_position"], gtd["robot_position"][:, None]
    for places in (gates, poles):
        assert (places[..., :2] >= torch.tensor(layout.lower) - ROUNDING).all()
        assert (places[..., :2] <= torch.tensor(layout.upper) + ROUNDING).all()

    def share_nearer(a: Tensor, b: Tensor, least: float) -> float:
        apart = (a[:, :, None, :2] - b[:, None, :, :2]).norm(dim=-1)
        if a is b:
            apart = apart + 100.0 * torch.eye(a.shape[1])
        return float((apart.flatten(1).amin(dim=1) < least - ROUNDING).float().mean())

    assert share_nearer(gates, gates, layout.gate_distance) < 0.05
    assert share_nearer(gates, poles, layout.pole_to_gate) < 0.05
    assert share_nearer(poles, poles, layout.pole_distance) < 0.01
    assert share_nearer(start, gates, layout.start_distance) < 0.05
    last = torch.cat((start, gates[:, :-1]), dim=1)
    way = gates - last
    ahead = quat_rotate(gtd["gate_nominal_orientation"].flatten(0, 1), torch.tensor([[1.0, 0.0, 0.0]]).expand(8000, 3))
    heading = torch.atan2(way[..., 1], way[..., 0])
    yaw = torch.atan2(ahead[:, 1], ahead[:, 0]).view(2000, 4)
    assert_uniform((yaw - heading + pi).remainder(2.0 * pi) - pi, -layout.yaw_range, layout.yaw_range)
    unit = way[..., :2] / way[..., :2].norm(dim=-1, keepdim=True)
    beside = (poles - last)[..., :2]
    away = (beside[..., 0] * unit[..., 1] - beside[..., 1] * unit[..., 0]).abs()
    assert float((away < layout.corridor + ROUNDING).float().mean()) > 0.5  # on the way where there is room


def test_a_layout_without_room_takes_what_comes_closest() -> None:
    """Two gates 1 m apart do not fit into 0.2 m: the second is as far from the first as some of 64 draws can be."""
    base = ENVIRONMENTS.get("racing_random_track_env")
    narrow = LayoutCfg(lower=(-0.1, -0.1), upper=(0.1, 0.1), start_distance=0.0)
    track = replace(base.track, gates=base.track.gates[:2], poles=(), layout=narrow)
    env = simulate(replace(base, track=track, assets=(replace(base.assets[0], count=2),)), 200)
    env.reset()
    first, second = env.gtd["gate_nominal_position"][..., :2].unbind(1)
    assert (second.abs() <= 0.1 + ROUNDING).all()
    assert float((second - first).norm(dim=-1).min()) > 0.09  # anywhere it would be 0.1 on average


def straight(**changes: object) -> EnvironmentCfg:
    """One gate that stands where it is listed, turned by 40 deg, and a pole behind it."""
    base = ENVIRONMENTS.get("racing_env")
    track = TrackCfg(gates=(GatePlaceCfg(position=(0.5, -0.2, 1.0), euler=(0.0, 0.0, 0.7)),), poles=((2.0, 2.0, 1.55),))
    assets = tuple(replace(asset, count=1) for asset in base.assets)
    return replace(base, track=replace(track, **changes), assets=assets)


def put(env: EnvManager, gate: tuple[float, float, float]) -> None:
    state, turn = env.robot_manager.tensors.state, quat_from_euler(torch.tensor([[0.0, 0.0, 0.7]]))
    state.position.copy_(torch.tensor([0.5, -0.2, 1.0]) + quat_rotate(turn, torch.tensor([gate])))
    state.attitude.copy_(turn.expand(env.num_envs, 4))
    state.lin_vel.zero_()
    state.ang_vel.zero_()


@pytest.mark.parametrize(("place", "clearance"), [
    ((0.0, 0.0, 0.0), hypot(0.025, 0.165) - 0.035),  # bars begin 20 cm to the sides, and 1 cm ahead and behind
    ((0.0, 0.1, 0.0), hypot(0.025, 0.065) - 0.035),
    ((0.0, 0.0, -0.1), hypot(0.025, 0.1) - 0.035),
    ((0.0, 0.15, 0.0), hypot(0.025, 0.015) - 0.035),  # a side bar: negative
    ((0.0, 0.0, 0.28), None),  # in the middle of the upper bar
    ((0.2, 0.0, -0.8), 0.2 - 0.07 - 0.05),  # before the stand, 10 cm wide
    ((0.0, 0.0, -0.8), None),
    ((0.0, 0.6, 0.0), hypot(0.025, 0.6 - 0.36 - 0.035) - 0.035),  # beside the frame
])  # fmt: skip
def test_frame_and_stand_can_be_touched_and_the_opening_not(place, clearance) -> None:
    """Distances of spheres of 3.5 cm at 3.5 cm from both axes; a hover of one step moves the vehicle by less than 1 mm."""
    env = simulate(straight(), 3)
    env.reset()
    put(env, place)
    env.step(torch.zeros(3, 4))
    assert env.gtd["crashes"].tolist() == [clearance is None or clearance < 0.0] * 3
    if clearance is not None:
        torch.testing.assert_close(env.gtd["robot_clearance"], torch.full((3,), clearance), atol=1e-3, rtol=0.0)


@pytest.mark.parametrize(("height", "touches"), [(1.0, True), (1.5, True), (1.65, False)])
def test_a_pole_ends_at_its_top(height: float, touches: bool) -> None:
    env = simulate(straight(), 1)
    env.reset()
    state = env.robot_manager.tensors.state
    state.position.copy_(torch.tensor([[2.03, 2.0, height]]))
    env.step(torch.zeros(1, 4))
    assert bool(env.gtd["crashes"]) == touches


RACE = ENVIRONMENTS.get("racing_env")
UNIT = LayoutCfg(lower=(0.0, 0.0), upper=(1.0, 1.0))
GATE = GatePlaceCfg(position=(0.0, 0.0, 1.0))


@pytest.mark.parametrize(("make", "message"), [
    (lambda: TrackCfg(gates=()), "TrackCfg.gates = .*: needs at least one"),
    (lambda: straight(gate_euler_low=(0.1, 0.0, 0.0)), r"gate_euler_low = .* must not exceed"),
    (lambda: replace(UNIT, upper=(1.0, -1.0)), "must not exceed"),
    (lambda: replace(UNIT, yaw_range=4.0), "yaw_range = 4.0: must be 0 to pi"),
    (lambda: replace(RACE, assets=()), r"needs gates \(count: 4, keep: true\), poles"),
    (lambda: replace(RACE, assets=RACE.assets[::-1]), "its gates and poles are the first assets"),
    (lambda: TrackCfg(gates=(GATE,), poles=((0.0, 0.0, 1.0),) * 2, layout=UNIT), "layout draws one pole, at most, on the way"),
])  # fmt: skip
def test_tracks_that_cannot_be_are_refused(make, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()
