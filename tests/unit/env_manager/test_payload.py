"""A payload that the vehicles of an environment carry together: starts, step, collisions, backends, refusals."""

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import pytest
import torch

from aerial_gym import ROBOTS, EnvManager
from aerial_gym.config.environment import ContactCfg, EnvironmentCfg
from aerial_gym.config.vehicles import PayloadCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import ConfigError
from tests.unit.env_manager.test_several_vehicles import WIDE, actions, build

E = 3
QUAD = "base_quadrotor"
PAYLOAD = PayloadCfg(mass=0.1, cable_length=0.8, cables="rigid", anchor=(0.0, 0.0, -0.02))


def carrier_env(payload: PayloadCfg | None = PAYLOAD, **changes: Any) -> EnvironmentCfg:
    return replace(WIDE, payload=payload, reset_together=True, physics_steps_per_env_step=4, **changes)


def build_carriers(count: int = 3, env: EnvironmentCfg | None = None, **options: Any) -> EnvManager:
    built = build([{"name": QUAD, "count": count}], env_name=env or carrier_env(), sim_name="base_sim_2ms", **options)
    built.reset()
    return built


def cable_lengths(env: EnvManager) -> torch.Tensor:
    """Return the distances from the anchors to the payload [m], (E, V)."""
    from aerial_gym.math.quaternion import quat_rotate

    attitude = env.gtd["robot_orientation"].flatten(0, 1)
    anchor = quat_rotate(attitude, torch.tensor(PAYLOAD.anchor).expand(len(attitude), 3)).view(env.num_envs, -1, 3)
    return (env.gtd["payload_position"].unsqueeze(1) - env.gtd["robot_position"] - anchor).norm(dim=-1)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_an_episode_starts_on_taut_cables(count: int) -> None:
    """Vehicles stand evenly on a circle above the payload; everything has one velocity; derived states agree."""
    env = build_carriers(count)
    torch.testing.assert_close(cable_lengths(env), torch.full((E, count), 0.8), rtol=1e-4, atol=0.0)
    places = env.gtd["robot_position"]
    apart = (places[:, 0] - places[:, 1]).norm(dim=-1)
    torch.testing.assert_close(apart, torch.full((E,), 1.6 * sin(0.5) * sin(pi / count)), rtol=0.1, atol=0.0)
    below = places[..., 2].mean(dim=1) - env.gtd["payload_position"][:, 2]
    torch.testing.assert_close(below, torch.full((E,), 0.8 * cos(0.5)), rtol=0.05, atol=0.0)
    velocity = env.gtd["robot_linvel"]
    assert torch.equal(velocity, env.gtd["payload_linvel"].unsqueeze(1).expand_as(velocity))
    assert torch.equal(env.gtd["robot_state_tensor"][..., :3], places)
    assert torch.equal(env.gtd["robot_state_tensor"][..., 7:10], velocity)


@pytest.mark.parametrize("backend", ["warp", "torch", "mujoco"])
def test_cables_keep_their_length_in_flight(backend: str) -> None:
    """30 steps of 8 ms under velocity commands on every backend: within 0.1 mm of the length, and of the fused kernel."""
    pytest.importorskip(backend)
    ends = []
    for name in dict.fromkeys(("warp", backend)):
        env = build_carriers(backend=name)
        for step in range(30):
            env.step(actions(torch.arange(3.0 * E) + step).view(E, 3, 4))
        torch.testing.assert_close(cable_lengths(env), torch.full((E, 3), 0.8), rtol=0.0, atol=1e-4)
        assert env.gtd["payload_tension"].abs().max() > 0.1
        ends.append(torch.cat((env.gtd["payload_position"].unsqueeze(1), env.gtd["robot_position"]), dim=1).clone())
    torch.testing.assert_close(ends[0], ends[-1], rtol=0.0, atol=1e-3)


def test_the_poses_of_the_step_are_recorded_for_the_collision_test() -> None:
    env = build_carriers()
    start = env.gtd["robot_position"].clone()
    env.step(torch.zeros(E, 3, 4))
    vehicles = env.vehicles
    assert vehicles is not None
    poses = vehicles._followed
    assert torch.equal(poses.position[0].view(E, 3, 3), start)
    assert torch.equal(poses.position[-1].view(E, 3, 3), env.gtd["robot_position"])
    assert torch.equal(poses.attitude[-1].view(E, 3, 4), env.gtd["robot_orientation"])


def test_vehicles_on_slack_cables_fly_as_without_a_payload() -> None:
    """Bit for bit, one launch of four substeps against four of one; the payload falls by g t²/2 at the ends of substeps."""
    carriers = build_carriers(env=carrier_env(replace(PAYLOAD, cables="slack")))
    free = build_carriers(env=carrier_env(None))
    for key in ("robot_position", "robot_linvel", "robot_orientation", "robot_body_angvel", "rotor_speed"):
        free.gtd[key].copy_(carriers.gtd[key])
    carriers.gtd["payload_position"].copy_(carriers.gtd["robot_position"][:, 0])
    place, speed = (carriers.gtd[f"payload_{key}"].clone() for key in ("position", "linvel"))
    for env in (carriers, free):
        env.step(torch.zeros(E, 3, 4))
    assert not carriers.gtd["payload_tension"].any()
    assert torch.equal(carriers.gtd["robot_position"], free.gtd["robot_position"])
    assert torch.equal(carriers.gtd["robot_orientation"], free.gtd["robot_orientation"])
    dt, steps = 0.002, 4
    fallen = place + dt * steps * speed - torch.tensor([0.0, 0.0, 9.81 * dt**2 * steps * (steps + 1) / 2])
    torch.testing.assert_close(carriers.gtd["payload_position"], fallen, rtol=0.0, atol=1e-4)


def test_resets_and_saved_states() -> None:
    """A reset of one environment leaves the other payloads; a saved state flies on bit for bit."""
    env = build_carriers()
    env.step(torch.zeros(E, 3, 4))
    before = env.gtd["payload_position"].clone()
    env.reset(torch.tensor([False, True, False]))
    moved = (env.gtd["payload_position"] != before).any(dim=1)
    assert moved.tolist() == [False, True, False]
    state = env.save_state()
    ends = []
    for _ in range(2):
        env.load_state(state)
        env.step(torch.zeros(E, 3, 4))
        ends.append({key: env.gtd[key].clone() for key in ("payload_position", "payload_linvel", "payload_tension")})
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])
    with pytest.raises(ConfigError, match=r"reset_together is true"):
        env.reset(torch.ones(E, 3, dtype=torch.bool))


def test_a_payload_below_the_ground_is_a_crash_of_its_vehicles() -> None:
    env = build_carriers(env=carrier_env(ground_height=-400.0))
    env.gtd["robot_position"][1, :, 2] += -399.99 - env.gtd["payload_position"][1, 2]
    env.gtd["payload_position"][1, 2] = -399.99
    env.gtd["payload_linvel"][1, 2] = -60.0
    env.step(torch.zeros(E, 3, 4))
    assert env.gtd["crashes"].all(dim=1).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("robots", "options", "message"),
    [
        ([{"name": QUAD, "count": 5}], {}, "up to 4 vehicles of one kind carry it, not 5 of 1 kinds"),
        ([{"name": QUAD}, {"name": "tinyprop"}], {}, "not 2 of 2 kinds"),
        (
            [{"name": QUAD, "count": 2}],
            {"env_name": replace(carrier_env(), reset_together=False)},
            "reset_together: true",
        ),
        (
            [{"name": QUAD, "count": 2}],
            {"env_name": carrier_env(contact=ContactCfg(friction=0.5), ground_height=0.0)},
            "it has no contact forces",
        ),
        ([{"name": QUAD, "count": 2}], {"sim_name": replace(SIMS.get("base_sim"), integrator="rk4")}, "not rk4"),
        ([{"name": "morphy", "count": 2}], {}, "robot morphy: a vehicle with joints carries no payload"),
        ([{"name": "base_quadrotor_with_payload", "count": 2}], {}, "effect slung_payload does not go with payload"),
        (
            [{"name": QUAD, "count": 2}],
            {"env_name": carrier_env(replace(PAYLOAD, angle=0.0), vehicle_clearance=0.1)},
            "vehicles start 0 m apart and need",
        ),
        ([{"name": QUAD}], {}, "Give a single one the effect slung_payload"),
    ],
)
def test_refusals_name_the_remedy(robots: list[dict[str, Any]], options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(robots, **{"env_name": carrier_env()} | options)


def test_wakes_act_on_carriers() -> None:
    """The payload's launches of one substep hold the wakes of the start of the step."""
    robot = replace(ROBOTS.get(QUAD), effects={"downwash": {"force": 0.5, "sigma": 0.3}})
    env = build([{"name": robot, "count": 2, "kind": "quad"}], env_name=carrier_env(), sim_name="base_sim_2ms")
    env.reset()
    env.gtd["robot_position"][:, 0, 2] += 0.3
    env.step(torch.zeros(E, 2, 4))
    assert (env.gtd["effect_downwash"][:, 1, -1] > 0.0).all()
    assert not env.gtd["effect_downwash"][:, 0, -1].any()
