"""The Crazyflie's controllers in flight: gains in counts, integrals, rates, resets, and what they do not fly.

Their laws are held to the firmware in ``tests/cross/test_crazyflie.py``, their Warp twins to torch in ``test_cascade.py``.
"""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.autopilots.crazyflie import CrazyfliePidCfg, MellingerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.crazyflie.controller import MellingerController, PidController
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics import BodyState, TorchBackend, build_model, state_at_rest, vehicle_from_config
from aerial_gym.physics.law_memory import fresh_law_memory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS

F64 = torch.float64
DT = 0.002
X500, TUNED = ROBOTS.get("x500"), ROBOTS.get("crazyflie_21")
MELLINGER, PID = "crazyflie_mellinger_control", "crazyflie_pid_control"


def law_of(name: str, robot: RobotCfg = X500, dt: float = DT, **changes):
    cfg = replace(CONTROLLERS.get(name), **changes)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    return make_controller(cfg, vehicle, 9.81, dt=dt, control=robot.control)


def at_rest(turn: tuple[float, float, float] = (0.0, 0.0, 0.0), rate: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    attitude, ang_vel = quat_exp(torch.tensor([turn], dtype=F64)), torch.tensor([rate], dtype=F64)
    return replace(state, attitude=attitude, ang_vel=ang_vel)


def told(law, state: BodyState, action: list[float]) -> torch.Tensor:
    memory = fresh_law_memory(law.needs, 1, state.position)
    return law.command(state, torch.tensor([action], dtype=F64), memory)[0]


def fly(
    law, robot: RobotCfg, seconds: float, action: list[float], *, heavier: float = 1.0, dt: float = DT
) -> list[BodyState]:
    """Return the states of each 0.1 s of a flight from hover, of a vehicle that may weigh more than the law knows."""
    plant = replace(robot, body=replace(robot.body, mass=heavier * robot.body.mass))
    backend, state = TorchBackend(), at_rest()
    backend.allocate(build_model(vehicle_from_config(plant, num_envs=1, dtype=F64)), law, integrator="euler")
    state.rotor_speed.fill_(robot.rotor.speed_at(robot.body.mass * 9.81 / 4))
    found = []
    for _ in range(round(seconds / 0.1)):
        backend.step(state, torch.tensor([action], dtype=F64), dt, round(0.1 / dt))
        found.append(BodyState(**{name: tensor.clone() for name, tensor in vars(state).items()}))
    return found


@pytest.mark.parametrize("turn", [(1e-4, 0.0, 0.0), (0.0, -1e-4, 0.0), (0.0, 0.0, 1e-4), (5e-5, 7e-5, -3e-5)])
def test_derived_mellinger_is_the_geometric_law_in_counts(turn: tuple[float, float, float]) -> None:
    """Small turns, rates and distances: the same speeds as ``lee_position_control``, but for terms of second order."""
    state = at_rest(turn, tuple(3.0 * x for x in turn))
    found = told(law_of(MELLINGER), state, [1e-4, -2e-4, 1e-4, 0.0])
    lee = law_of("lee_position_control").rotor_command(state, torch.tensor([[1e-4, -2e-4, 1e-4, 0.0]], dtype=F64))
    hover = X500.rotor.speed_at(X500.body.mass * 9.81 / 4)
    assert float((lee - hover).abs().max()) > 1e-3
    torch.testing.assert_close(found, lee, atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", [MELLINGER, PID])
@pytest.mark.parametrize("robot", ["x500", "tinyprop", "racing_quadrotor"])
def test_at_rest_they_hold_the_weight(name: str, robot: str) -> None:
    cfg = ROBOTS.get(robot)
    law = law_of(name, cfg)
    lift = rotor_thrust(law.allocation.vehicle, told(law, at_rest(), [0.0] * 4)).sum()
    assert float(lift) == pytest.approx(cfg.body.mass * 9.81, rel=1e-9)
    check_closed_loop(cfg, CONTROLLERS.get(name), gravity=9.81, dt=DT, integrator="euler", names=(robot, name))


@pytest.mark.parametrize("name", [MELLINGER, PID])
def test_a_crazyflie_flies_with_what_it_comes_with(name: str) -> None:
    """At its own rates, 500 and 100 Hz, the numbers of the robot file (``test_registered_flights.py`` flies it)."""
    rates = (
        {"rate_hz": 500.0} if name == MELLINGER else {"rate_hz": 100.0, "crazyflie_pid": CrazyfliePidCfg(rate_hz=500.0)}
    )
    law = law_of(name, TUNED, **rates)
    assert isinstance(law, MellingerController | PidController)
    assert law.timing.law == (1 if name == MELLINGER else 5)
    assert law.timing.loop == 1
    if isinstance(law, MellingerController):
        assert law.gains.attitude[0].tolist() == [70000.0, 70000.0, 60000.0]
        assert float(law.gains.mass_thrust[0]) == 132000.0
    else:
        assert law.gains.rates.proportional[0].tolist() == [250.0, 250.0, 120.0]
        assert law.gains.rates.limit[0].tolist() == [33.3, 33.3, 166.7]


@pytest.mark.parametrize(
    ("changes", "ends"),
    [
        ({"crazyflie_pid": CrazyfliePidCfg(velocity_ki=(0.0, 0.0, 2.0))}, True),
        ({"crazyflie_pid": CrazyfliePidCfg(velocity_ki=(0.0, 0.0, 0.0))}, False),
    ],
)
def test_integrals_hold_a_weight_that_nobody_declared(changes: dict, ends: bool) -> None:
    """3 % more weight: ``K_v K_p e = 0.03 g`` of lift stays without the integral."""
    law = law_of(PID, dt=0.02, **changes)
    assert isinstance(law, PidController)
    sunk = -float(fly(law, X500, 10.0, [0.0] * 4, heavier=1.03, dt=0.02)[-1].position[0, 2])
    if ends:
        assert abs(sunk) < 2e-3
    else:
        unit = float(law.gains.velocity.proportional[0, 2] * law.gains.position.proportional[0, 2]) * 1000.0
        assert sunk == pytest.approx(0.03 * float(law.gains.thrust_base[0]) / unit, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (MELLINGER, {"mellinger": MellingerCfg(kd_omega_rp=20.0)}),
        (PID, {"crazyflie_pid": CrazyfliePidCfg(rate_kd=(2.5, 2.5, 1.0), attitude_kd=(0.3, 0.3, 0.3))}),
    ],
)
def test_a_reset_gives_no_kick(name: str, changes: dict) -> None:
    """The first command of a body that leans and turns is that without differences; the next one is not."""
    state, action = at_rest((0.05, 0.02, 0.3), (0.3, -0.2, 0.1)), [0.0, 0.0, 0.0, 0.0]
    with_it, without = law_of(name, **changes), law_of(name)
    torch.testing.assert_close(told(with_it, state, action), told(without, state, action), atol=1e-9, rtol=0)
    later = replace(state, ang_vel=1.1 * state.ang_vel)
    ends = []
    for law in (with_it, without):
        _, memory = law.command(
            state, torch.tensor([action], dtype=F64), fresh_law_memory(law.needs, 1, state.position)
        )
        ends.append(law.command(later, torch.tensor([action], dtype=F64), memory)[0])
    assert float((ends[0] - ends[1]).abs().max()) > 1e-3


def test_what_is_far_below_does_not_turn_it_over() -> None:
    """2 m down at 1.25 N/m is more than a Crazyflie weighs: as the firmware has it the thrust would point down."""
    end = fly(law_of(MELLINGER, TUNED), TUNED, 1.0, [0.0, 0.0, -2.0, 0.0])
    assert all(float(state.attitude[0, 3]) > 0.99 for state in end)
    assert float(end[-1].position[0, 2]) < -0.5


@pytest.mark.parametrize("name", [MELLINGER, PID])
def test_what_does_not_fit_is_refused_by_name(name: str) -> None:
    for robot, why in (
        ("typhoon_hexarotor", "has 6 rotors"),
        ("omnidirectional_octarotor", "reversible"),
        ("neural_fly_quad", "do not turn it about each axis"),
    ):
        with pytest.raises(ConfigError, match=rf"four rotors in an X .*{why}.*Take lee_position_control"):
            law_of(name, ROBOTS.get(robot))
    with pytest.raises(ConfigError, match="law 'velocity': the Crazyflie's controllers fly to a position"):
        law_of(name, law="velocity")
    with pytest.raises(ConfigError, match="are 2 autopilots"):
        replace(CONTROLLERS.get(MELLINGER), crazyflie_pid=CrazyfliePidCfg())
    with pytest.raises(ConfigError, match="no rate loop to reach"):
        replace(CONTROLLERS.get(MELLINGER), delay=0.01)
    with pytest.raises(ConfigError, match=r"CrazyfliePidCfg.rate_kp = \(1.0, -1.0, 1.0\): must be >= 0"):
        CrazyfliePidCfg(rate_kp=(1.0, -1.0, 1.0))
    with pytest.raises(ConfigError, match="CrazyfliePidCfg.rate_hz = 0: must be > 0"):
        CrazyfliePidCfg(rate_hz=0.0)
    with pytest.raises(ConfigError, match="MellingerCfg.mass = 0: must be > 0"):
        MellingerCfg(mass=0.0)


@pytest.mark.parametrize("name", [MELLINGER, PID])
def test_an_axis_that_a_robot_leaves_alone_is_left_alone(name: str) -> None:
    """No torque about z is asked for, and nothing is infinite."""
    robot = replace(X500, control=replace(X500.control, attitude_frequency=(5.0, 5.0, 0.0)))
    law = law_of(name, robot)
    turned = told(law, at_rest((0.0, 0.0, 0.5), (0.0, 0.0, 0.4)), [0.0] * 4)
    torch.testing.assert_close(turned, told(law, at_rest(), [0.0] * 4), rtol=1e-9, atol=0)
