"""What is refused, warned of and accepted before a flight, against flights in the torch backend."""

import logging
from dataclasses import replace

import pytest
import torch

from aerial_gym.control import CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.hover import HOVER_RANGE
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics import EFFECTS, BodyState, TorchBackend, build_model, vehicle_from_config
from aerial_gym.robots import ROBOTS

F64 = torch.float64
DT, GRAVITY = 0.01, 9.81


def is_refused(robot: str, controller: str, effects: dict[str, dict[str, float]]) -> bool:
    cfg = replace(ROBOTS.get(robot), effects=effects, effects_source="test")
    law, names = CONTROLLERS.get(controller), (robot, controller)
    try:
        check_closed_loop(cfg, law, gravity=GRAVITY, dt=DT, integrator="euler", names=names)
    except ConfigError:
        return True
    return False


def last_ways(robot: str, controller: str, delays: list[float]) -> list[float]:
    """Return the way [m] that vehicles go between 6 and 7 s after a start with a lean of 0.1 rad and 0.2 m/s."""
    cfg, law_cfg, rows = ROBOTS.get(robot), CONTROLLERS.get(controller), len(delays)
    vehicle = vehicle_from_config(cfg, num_envs=rows, dtype=F64)
    law = make_controller(law_cfg, vehicle, GRAVITY, dt=DT, control=cfg.control)
    late = (EFFECTS.get("actuation_delay"), torch.tensor(delays, dtype=F64).unsqueeze(-1))
    backend, turn, weight = TorchBackend(), torch.zeros(rows, 3, dtype=F64), torch.zeros(rows, 6, dtype=F64)
    turn[:, 0], weight[:, 2] = 0.1, cfg.body.mass * GRAVITY
    state = BodyState(
        position=torch.zeros_like(turn), attitude=quat_exp(turn), lin_vel=0.2 * torch.ones_like(turn),
        ang_vel=0.2 * torch.ones_like(turn), rotor_speed=Allocation(vehicle, GRAVITY).speed_for_wrench(weight),
    )  # fmt: skip
    backend.allocate(build_model(vehicle, [late]), law, integrator="euler")
    action = torch.zeros(rows, len(law.action_names), dtype=F64)
    backend.step(state, action, DT, 600)
    before = state.position.clone()
    backend.step(state, action, DT, 100)
    return (state.position - before).norm(dim=-1).tolist()


@pytest.mark.parametrize(
    ("robot", "controller", "held", "lost"),
    [
        ("crazyflie_21", "crazyflie_lee_control", [0.0, 0.005], [0.01]),
        ("magpie", "pid_velocity_control", [0.0, 0.005], [0.01]),
    ],
)
def test_what_flies_away_is_refused_and_what_hovers_is_not(robot, controller, held, lost) -> None:
    """Dead times [s] on both sides of the limit; the first two robots were 17 and 29 m away with 10 ms."""
    ways = last_ways(robot, controller, held + lost)
    for delay, way in zip(held + lost, ways, strict=True):
        assert (way > HOVER_RANGE) is (delay in lost)
        assert is_refused(robot, controller, {"actuation_delay": {"delay": delay}}) is (delay in lost)


@pytest.mark.slow
def test_a_limit_cycle_that_holds_its_place_causes_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert not is_refused("crazyflie_2x_arpl", "crazyflie_pid_control", {"actuation_delay": {"delay": 0.0156}})
    assert len(caplog.records) == 1


def test_effects_that_a_law_does_not_know_cause_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    payload = {"payload_mass": {"dm": 0.02}}
    with caplog.at_level(logging.WARNING):
        assert not is_refused("base_quadrotor", "lee_position_control", payload)
        (record,) = caplog.records
        assert "payload_mass" in record.getMessage()
        caplog.clear()
        assert not is_refused("base_quadrotor", "lee_attitude_control", payload)
        assert not is_refused("base_quadrotor", "lee_position_control", {"payload_mass": {"dm": 1e-4}})
        drag = {"rotor_drag": {"dx": 0.1, "dy": 0.1, "dz": 0.1}}
        assert not is_refused("base_quadrotor", "lee_position_control", drag)
    assert not caplog.records


def test_what_cannot_be_lifted_is_refused_unless_asked_to_warn(caplog: pytest.LogCaptureFixture) -> None:
    weak = {"thrust_coefficient": {"scale": 0.3}}
    assert is_refused("base_quadrotor", "lee_position_control", weak)
    robot = replace(ROBOTS.get("base_quadrotor"), effects=weak, effects_source="test")
    anyway = replace(CONTROLLERS.get("lee_position_control"), if_unstable="warn")
    with caplog.at_level(logging.WARNING):
        check_closed_loop(robot, anyway, gravity=GRAVITY, dt=DT, integrator="euler", names=("weak", "it"))
    assert len(caplog.records) == 1
