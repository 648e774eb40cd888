"""Wakes between the vehicles of an environment: closed forms, similarity of sources, independence, order of the splitting."""

from dataclasses import replace
from math import cos, exp, log2
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import ROBOTS, EnvManager
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.rotors import hover_speed
from tests.unit.env_manager.test_batch_independence import assert_same
from tests.unit.env_manager.test_several_vehicles import WIDE, actions, build

WAKE = {"downwash": {"force": 0.5, "sigma": 0.3}}
QUAD = ROBOTS.get("base_quadrotor")
UPRIGHT = torch.tensor([0.0, 0.0, 0.0, 1.0])
LAWS = {
    "downwash": {"force": 0.5, "sigma": 0.3},
    "downwash_jet": {"force": 0.5, "spread": 0.2},
    "downwash_core": {"force": 0.5, "sigma": 0.3, "power": 6.0},
}


def with_wake(robot: RobotCfg = QUAD, **effects: Any) -> RobotCfg:
    return replace(robot, effects=effects or WAKE)


def build_wakes(count: int, robot: RobotCfg | None = None, **options: Any) -> EnvManager:
    env = build([{"name": robot or with_wake(), "count": count, "kind": "quad"}], **options)
    env.reset()
    return env


def hover(env: EnvManager, *places: tuple[float, float, float], kind: str = "quad", first: int = 0) -> None:
    """Put vehicles at rest at places, with rotors that carry their weight."""
    gtd = env.kinds[kind].gtd
    for v, place in enumerate(places):
        gtd["robot_position"][:, first + v] = torch.tensor(place)
    gtd["robot_orientation"][:] = UPRIGHT
    for key in ("robot_linvel", "robot_body_angvel"):
        gtd[key].zero_()


def wakes(env: EnvManager, kind: str = "quad", law: str = "downwash") -> Tensor:
    """Return the downward forces of the launch that has just been flown [N], (E, V)."""
    return env.kinds[kind].gtd[f"effect_{law}"][..., -1]


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_the_wakes_of_all_others_add_up(backend: str) -> None:
    """Right below one vehicle: the full force, and none on it. Below two, one of them sigma beside: 1 + exp(-1/2)."""
    env = build_wakes(3, backend=backend)
    hover(env, (0.0, 0.0, 3.0), (0.0, 0.0, 2.0), (0.3, 0.0, 1.0))
    env.fly(1)
    expected = 0.5 * torch.tensor([0.0, 1.0, 2.0 * exp(-0.5)])
    torch.testing.assert_close(wakes(env)[0], expected, rtol=1e-5, atol=1e-6)
    env.fly(1)  # the controller answers, from the second substep on
    fall = env.gtd["robot_linvel"][0, 1, 2] / (2.0 * env.sim_cfg.dt)
    assert float(fall) == pytest.approx(-0.5 / 0.25, rel=0.1)
    assert "downwash_position" not in env.gtd


@pytest.mark.parametrize("count", [7, 12])
def test_the_wakes_of_many_add_up(count: int) -> None:
    """``sum over j above i of force exp(-d_ij² / 2 sigma²)`` for hovering vehicles, in a block of 7 and in two of 6."""
    env = build_wakes(count, controller_name="rotor_speed_control")
    env.gtd["rotor_speed"].fill_(float(hover_speed(env.robot_manager.declared, 9.81).flatten()[0]))
    place = torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
    hover(env, *[tuple(row) for row in place.tolist()])
    env.fly(1)
    square = (place[:, None, :2] - place[None, :, :2]).square().sum(-1)
    push = 0.5 * torch.exp(-0.5 * square / 0.3**2) * (place[None, :, 2] > place[:, None, 2])
    torch.testing.assert_close(wakes(env), push.sum(1).expand(3, -1), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_two_vehicles_feel_what_the_effect_states(law: str) -> None:
    """The lower one of two flies as a single vehicle with the upper one at ``downwash_position``, for one substep."""
    places = (0.1, -0.2, 1.5), (0.0, 0.0, 2.2)
    robot = with_wake(**{law: LAWS[law], "com_offset": {"x": 0.01, "y": -0.005, "z": 0.0}})
    law_of_rotors = {"controller_name": "rotor_speed_control"}
    pair, alone = build_wakes(2, robot, **law_of_rotors), build(robot_name=robot, **law_of_rotors)
    alone.reset()
    hover(pair, *places)
    for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel", "rotor_speed"):
        alone.gtd[key].copy_(pair.gtd[key][:, 0])
    alone.gtd["downwash_position"][:] = torch.tensor(places[1])
    alone.robot_manager.take_writes()
    for env in (pair, alone):
        env.fly(1)
    assert wakes(pair, law=law)[0, 0] > 0.01
    torch.testing.assert_close(pair.gtd["robot_linvel"][:, 0], alone.gtd["robot_linvel"], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_a_wake_acts_between_body_origins(backend: str) -> None:
    """Origin below origin gives the full force, wherever the centre of mass is and however the lower vehicle is turned."""
    robot = with_wake(**WAKE, com_offset={"x": 0.2, "y": 0.0, "z": 0.0})
    options = {"backend": backend, "controller_name": "rotor_speed_control"}
    pair, alone = build_wakes(2, robot, **options), build(robot_name=robot, **options)
    alone.reset()
    hover(pair, (0.0, 0.0, 2.0), (0.0, 0.0, 1.0))
    pair.gtd["robot_orientation"][:, 1] = torch.tensor([0.0, 0.0, 0.70710678, 0.70710678])
    for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel", "rotor_speed"):
        alone.gtd[key].copy_(pair.gtd[key][:, 1])
    alone.gtd["downwash_position"][:] = torch.tensor([0.0, 0.0, 2.0])
    alone.robot_manager.take_writes()
    for env in (pair, alone):
        env.fly(1)
    torch.testing.assert_close(wakes(pair)[:, 1], torch.full((3,), 0.5), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(pair.gtd["robot_linvel"][:, 1], alone.gtd["robot_linvel"], rtol=1e-4, atol=1e-6)


def test_the_wake_follows_the_lift_of_its_source() -> None:
    """None below stopped rotors, twice as much below twice the thrust, cos(a) below a tilted vehicle, none if inverted."""
    env = build_wakes(2)
    speed = env.gtd["rotor_speed"]
    tilt = 0.4
    for share, attitude, expected in (
        (0.0, UPRIGHT, 0.0),
        (2.0**0.5, UPRIGHT, 2.0),
        (1.0, torch.tensor([0.19866933, 0.0, 0.0, 0.98006658]), cos(tilt)),
        (1.0, torch.tensor([1.0, 0.0, 0.0, 0.0]), 0.0),
    ):
        env.reset()
        hover(env, (0.0, 0.0, 2.0), (0.0, 0.0, 1.0))
        env.gtd["robot_orientation"][:, 0] = attitude
        speed[:, 0] *= share
        env.fly(1)
        torch.testing.assert_close(wakes(env)[:, 1], torch.full((3,), 0.5 * expected), rtol=1e-4, atol=1e-6)


def test_sources_of_another_kind_are_similar() -> None:
    """Force and width of a source with k times the rotors and c times the lift: c / k² and k times, so that the momentum
    flux through a plane, the integral of the force over it, grows with the lift alone."""
    small = replace(ROBOTS.get("crazyflie_21"), effects={"downwash": {"force": 0.05, "sigma": 0.1}})
    large = replace(ROBOTS.get("tinyprop"), effects={})
    env = build([{"name": small, "count": 1, "kind": "small"}, {"name": large, "count": 1, "kind": "large"}])
    env.reset()
    k, c = 0.0381 / 0.023, large.body.mass / small.body.mass
    for beside in (0.0, 0.2):
        hover(env, (beside, 0.0, 0.0), kind="small")
        hover(env, (0.0, 0.0, 1.0), kind="large")
        for kind in env.kinds.values():  # carries its weight
            kind.gtd["rotor_speed"][:] = hover_speed(kind.robot_manager.declared, 9.81)
        env.fly(1)
        expected = 0.05 * c / k**2 * exp(-0.5 * (beside / (0.1 * k)) ** 2)
        torch.testing.assert_close(wakes(env, "small")[:, 0], torch.full((3,), expected), rtol=1e-4, atol=1e-7)
    forces = []
    for first, second in ((1.0, 100.0), (100.0, 1.0), (1.0, 1.0)):  # heights of the sources
        env = build([{"name": small, "count": 2, "kind": "small"}, {"name": large, "count": 1, "kind": "large"}])
        env.reset()
        hover(env, (0.0, 0.0, 0.0), (0.05 * first, 0.0, first), kind="small")
        hover(env, (0.05 * second, 0.0, second), kind="large")
        env.fly(1)
        forces.append(wakes(env, "small")[:, 0].clone())
    assert (forces[0] > 0.01).all()
    assert (forces[1] > 0.01).all()
    torch.testing.assert_close(forces[0] + forces[1], forces[2], rtol=1e-6, atol=0.0)
    with pytest.raises(
        ConfigError, match=r"downwash of several kinds: give rotor.radius \[m\] of robot base_quadrotor"
    ):
        build([{"name": small, "kind": "small"}, {"name": "base_quadrotor"}])


@pytest.mark.parametrize("backend", ["torch", "mujoco"])
def test_backends_agree(backend: str) -> None:
    """Two vehicles that cross, 20 substeps of 2 ms: positions within 10 µm of the fused kernel's."""
    pytest.importorskip(backend)
    ends = []
    for name in ("warp", backend):
        env = build_wakes(2, backend=name, sim_name="base_sim_2ms")
        hover(env, (-0.05, 0.0, 1.0), (0.05, 0.0, 1.5))
        for _ in range(20):
            env.step(torch.zeros(3, 2, 4))
        assert wakes(env)[:, 0].min() > 0.1
        ends.append(env.gtd["robot_position"].clone())
    torch.testing.assert_close(*ends, rtol=0.0, atol=1e-5)


def test_an_environment_is_the_same_alone_and_among_others() -> None:
    """Bit for bit, also with drawn wakes and beside an environment with a vehicle that is not a number."""
    drawn = {"effects.downwash.force": RandomizeCfg(how="value", low=0.1, high=0.4)}
    ends = []
    for num_envs, first in ((3, 0), (1, 2)):
        env = build_wakes(4, QUAD, num_envs=num_envs, first_env=first, randomize=drawn)
        own = torch.arange(first, first + num_envs, dtype=torch.float32)
        env.gtd["robot_position"].mul_(0.001)
        for step in range(6):
            given = actions(own.unsqueeze(1) + torch.arange(4.0) + step)
            given[own == 1, 0] = torch.nan
            env.step(given)
        assert wakes(env)[-1].max() > 0.1
        if num_envs > 1:
            assert torch.isfinite(wakes(env)[1, 1:]).all()
            assert torch.equal(env.draws()["effects.downwash.force"], env.gtd["effect_downwash"][..., 0])
        ends.append({key: value[-1].clone() for key, value in env.gtd.items() if key != "num_obstacles_in_env"})
    assert_same(*ends)


def test_wakes_reach_a_kernel_that_is_composed_again() -> None:
    """Its memory is new. A push of 0.5 N on 0.25 kg for 10 ms changes the speed by 20 mm/s."""
    env = build_wakes(2, controller_name="rotor_speed_control")
    speeds = []
    for recomposes in (False, True):
        env.reset()
        hover(env, (0.0, 0.0, 2.0), (0.0, 0.0, 1.0))
        env.fly(1)
        backend, speed = env.robot_manager.backend, env.gtd["rotor_speed"].clone()
        if recomposes:
            before = backend.wake_memory()[0].data_ptr()
            backend._compose(backend._model, backend._law)
            assert backend.wake_memory()[0].data_ptr() != before
            hover(env, (0.0, 0.0, 2.0), (0.0, 0.0, 1.0))
            env.fly(1)  # which packs all parameters
            env.gtd["rotor_speed"].copy_(speed)
        hover(env, (0.0, 0.0, 1.0), (0.0, 0.0, 2.0))  # the other one is pushed now
        env.fly(1)
        torch.testing.assert_close(backend.wake_memory()[0].view(3, 2), wakes(env), rtol=0.0, atol=0.0)
        speeds.append(env.gtd["robot_linvel"][..., 2].clone())
    assert (speeds[0][:, 0] < speeds[0][:, 1] - 0.01).all()
    assert torch.equal(*speeds)


def test_vehicles_without_the_effect_have_no_pass() -> None:
    env = build_wakes(2, QUAD)
    assert env.vehicles is not None
    assert env.vehicles._wakes is None


def test_the_error_of_held_wakes_is_of_first_order_in_the_launch() -> None:
    """A vehicle passes below another at 2 m/s for 64 ms. Halving the substeps of a launch halves the error: slope 1 ± 0.1."""
    cfg, sim, speeds = replace(WIDE, physics_steps_per_env_step=64), replace(SIMS.get("base_sim"), dt=0.001), {}
    for span in (1, 4, 8, 16):
        env = build_wakes(2, env_name=cfg, sim_name=sim, num_envs=1)
        hover(env, (-0.25, 0.0, 1.0), (0.0, 0.0, 1.5))
        env.gtd["robot_linvel"][:, 0, 0] = 2.0
        env.robot_manager.act(torch.tensor([[2.0, 0.0, 0.0, 0.0], [0.0] * 4]))
        for _ in range(64 // span):
            env.fly(span)
        speeds[span] = float(env.gtd["robot_linvel"][0, 0, 2])
    errors = [abs(speeds[span] - speeds[1]) / (span - 1) for span in (4, 8, 16)]
    assert log2(errors[2] / errors[1]) == pytest.approx(0.0, abs=0.1)
    assert log2(errors[1] / errors[0]) == pytest.approx(0.0, abs=0.1)


def test_laws_of_other_causes_are_not_held() -> None:
    """Only laws of downwash depend on other vehicles; ``without_wakes`` leaves the rest to the check of the loop."""
    from aerial_gym.physics.effects.wakes import hold_wake, without_wakes

    drag = EFFECTS.get("rotor_drag")
    assert hold_wake(drag, torch.zeros(1, 3))[0] is drag
    robot = replace(QUAD, effects=WAKE | {"rotor_drag": {"dx": 0.1, "dy": 0.1, "dz": 0.1}})
    drawn = {name: RandomizeCfg(low=0.9, high=1.1) for name in ("effects.downwash.force", "body.mass")}
    left, kept = without_wakes(robot, drawn)
    assert list(left.effects) == ["rotor_drag"]
    assert list(kept) == ["body.mass"]
