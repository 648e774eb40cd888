"""The Crazyflie's controllers in flight: gains in counts, integrals, rates, resets, and what they do not fly. Their
laws are held to the firmware in ``tests/cross/test_crazyflie.py``, their Warp code to torch in ``test_cascade.py``.
Feed-forward and limits of the Crazyflie's laws by hand, for cases that the vectors of the firmware leave out.
Torques of the Crazyflie's power distribution, by hand.
"""

from dataclasses import replace
from itertools import pairwise
from math import acos

import pytest
import torch

from aerial_gym import physics
from aerial_gym.config.autopilots import BrescianiniCfg, CrazyflieLeeCfg, CrazyfliePidCfg, MellingerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie import brescianini
from aerial_gym.control.crazyflie.controller import BrescianiniController, CrazyflieLeeController, MellingerController
from aerial_gym.control.crazyflie.distribution import rotor_signs, torque_per_count
from aerial_gym.control.crazyflie.mellinger import FlatTarget, MellingerGains, mellinger_control
from aerial_gym.control.crazyflie.pid import PidGains, PidLevel, outer_loop
from aerial_gym.control.gains import derive_inclination
from aerial_gym.control.lee import unit_z
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp, quat_rotate
from aerial_gym.physics.law_memory import fresh_law_memory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS
from tests.refusals import assert_refused

F64 = torch.float64
DT = 0.002
X500, TUNED = ROBOTS.get("x500"), ROBOTS.get("crazyflie_21")
MELLINGER, PID = "crazyflie_mellinger_control", "crazyflie_pid_control"
BRESCIANINI, LEE = "crazyflie_brescianini_control", "crazyflie_lee_control"


def make_law(name: str, robot: RobotCfg = X500, dt: float = DT, **changes):
    cfg = replace(CONTROLLERS.get(name), **changes)
    vehicle = physics.vehicle_from_config(robot, num_envs=1, dtype=F64)
    return make_controller(cfg, vehicle, 9.81, dt=dt, control=robot.control)


def at_rest(turn: tuple[float, float, float] = (0.0, 0.0, 0.0), rate: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    state = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    attitude, ang_vel = quat_exp(torch.tensor([turn], dtype=F64)), torch.tensor([rate], dtype=F64)
    return replace(state, attitude=attitude, ang_vel=ang_vel)


def rest_state(robot: RobotCfg) -> physics.BodyState:
    vehicle = physics.vehicle_from_config(robot, num_envs=1, dtype=F64)
    return physics.state_at_rest(1, vehicle.num_rotors, device=torch.device("cpu"), dtype=F64)


def brescianini_demand(law: BrescianiniController, state: physics.BodyState, *, yaw: float = 0.0) -> torch.Tensor:
    """Return thrust [N] and body rates [rad/s] that Brescianini's law asks for to be at the origin with a yaw [rad]."""
    still, heading = torch.zeros(1, 3, dtype=F64), torch.tensor([yaw], dtype=F64)
    target = FlatTarget(position=still, velocity=still, acceleration=still, yaw=heading, rates=still)
    return brescianini.outer_loop(state, target, law.gains, gravity=9.81, max_inclination=1.0)


def run_law(law, state: physics.BodyState, action: list[float]) -> torch.Tensor:
    memory = fresh_law_memory(law.needs, 1, state.position)
    return law.command(state, torch.tensor([action], dtype=F64), memory)[0]


def fly(
    law, robot: RobotCfg, seconds: float, action: list[float], *, heavier: float = 1.0, dt: float = DT
) -> list[physics.BodyState]:
    """Return the states of each 0.1 s of a flight from hover, of a vehicle that may weigh more than the law knows."""
    plant = replace(robot, body=replace(robot.body, mass=heavier * robot.body.mass))
    backend, state = physics.TorchBackend(), at_rest()
    backend.allocate(
        physics.build_model(physics.vehicle_from_config(plant, num_envs=1, dtype=F64)), law, integrator="euler"
    )
    state.rotor_speed.fill_(physics.rotor_state_for_thrust(robot.rotor, robot.body.mass * 9.81 / 4))
    result = []
    for _ in range(round(seconds / 0.1)):
        backend.step(state, torch.tensor([action], dtype=F64), dt, round(0.1 / dt))
        result.append(physics.BodyState(**{name: tensor.clone() for name, tensor in vars(state).items()}))
    return result


@pytest.mark.parametrize("name", [MELLINGER, BRESCIANINI])
@pytest.mark.parametrize("turn", [(1e-4, 0.0, 0.0), (0.0, -1e-4, 0.0), (0.0, 0.0, 1e-4), (5e-5, 7e-5, -3e-5)])
def test_with_derived_gains_they_are_the_geometric_law(name: str, turn: tuple[float, float, float]) -> None:
    """Turns, rates and distances of 1e-4: the speeds of ``lee_position_control``, but for terms of second order."""
    state = at_rest(turn, tuple(3.0 * x for x in turn))
    state.lin_vel[0] = torch.tensor([-2e-4, 1e-4, 1e-4], dtype=F64)
    result = run_law(make_law(name), state, [1e-4, -2e-4, 1e-4, 0.0])
    lee = make_law("lee_position_control").rotor_command(state, torch.tensor([[1e-4, -2e-4, 1e-4, 0.0]], dtype=F64))
    hover = physics.rotor_state_for_thrust(X500.rotor, X500.body.mass * 9.81 / 4)
    assert float((lee - hover).abs().max()) > 1e-3
    torch.testing.assert_close(result, lee, atol=0, rtol=2e-8)


FIRMWARES_RATES = {
    MELLINGER: {"rate_hz": 500.0},
    LEE: {"rate_hz": 500.0},
    PID: {"rate_hz": 100.0, "crazyflie_pid": CrazyfliePidCfg(rate_hz=500.0)},
    BRESCIANINI: {"rate_hz": 100.0, "brescianini": BrescianiniCfg(rate_hz=500.0)},
}


@pytest.mark.parametrize("name", [MELLINGER, PID, LEE, BRESCIANINI])
def test_a_crazyflie_flies_with_its_own_numbers(name: str) -> None:
    law = make_law(name, TUNED, **FIRMWARES_RATES[name])
    assert law.timing.law == (1 if name in (MELLINGER, LEE) else 5)
    assert law.timing.loop == 1
    if isinstance(law, MellingerController):
        assert law.gains.attitude[0].tolist() == [70000.0, 70000.0, 60000.0]
        assert float(law.gains.mass_thrust[0]) == 132000.0
    elif isinstance(law, CrazyflieLeeController):
        assert law.gains.lee.attitude[0].tolist() == [0.007, 0.007, 0.008]
        assert law.gains.attitude_integral[0].tolist() == [0.03] * 3
        assert not law.gains.position_integral.any()
    elif isinstance(law, BrescianiniController):
        assert law.gains.position[0].tolist() == pytest.approx([1.0 / 0.09] * 3)
        assert law.gains.velocity[0].tolist() == pytest.approx([1.7 / 0.3] * 3)
        assert law.gains.rate[0].tolist() == pytest.approx([1.0 / 0.015, 1.0 / 0.015, 1.0 / 0.0075])
        assert (float(law.gains.attitude[0]), float(law.gains.mixing[0])) == (4.0, 1.0)
        assert (float(law.gains.least_thrust[0]), float(law.gains.most_thrust[0])) == (1.0, 18.0)
    else:
        assert law.gains.rates.proportional[0].tolist() == [250.0, 250.0, 120.0]
        assert law.gains.rates.limit[0].tolist() == [33.3, 33.3, 166.7]


@pytest.mark.parametrize(("changes", "ends"), [
    ({"crazyflie_pid": CrazyfliePidCfg(velocity_ki=(0.0, 0.0, 2.0))}, True),
    pytest.param({"crazyflie_pid": CrazyfliePidCfg(velocity_ki=(0.0, 0.0, 0.0))}, False, marks=pytest.mark.slow),
])  # fmt: skip
def test_integrals_hold_a_weight_that_nobody_declared(changes: dict, ends: bool) -> None:
    """3 % more weight: ``K_v K_p e = 0.03 g`` of lift stays without the integral."""
    law = make_law(PID, dt=0.02, **changes)
    sunk = -float(fly(law, X500, 10.0, [0.0] * 4, heavier=1.03, dt=0.02)[-1].position[0, 2])
    if ends:
        assert abs(sunk) < 2e-3
    else:
        unit = float(law.gains.velocity.proportional[0, 2] * law.gains.position.proportional[0, 2]) * 1000.0
        assert sunk == pytest.approx(0.03 * float(law.gains.thrust_base[0]) / unit, rel=1e-3)


@pytest.mark.parametrize(("name", "changes"), [
    (MELLINGER, {"mellinger": MellingerCfg(kd_omega_rp=20.0)}),
    (PID, {"crazyflie_pid": CrazyfliePidCfg(rate_kd=(2.5, 2.5, 1.0), attitude_kd=(0.3, 0.3, 0.3))}),
])  # fmt: skip
def test_a_reset_gives_no_kick(name: str, changes: dict) -> None:
    """The first command of a body that leans and turns is that without differences; the next one is not."""
    state, action = at_rest((0.05, 0.02, 0.3), (0.3, -0.2, 0.1)), [0.0, 0.0, 0.0, 0.0]
    with_it, without = make_law(name, **changes), make_law(name)
    torch.testing.assert_close(run_law(with_it, state, action), run_law(without, state, action), atol=1e-9, rtol=0)
    later, action = replace(state, ang_vel=1.1 * state.ang_vel), torch.tensor([action], dtype=F64)
    ends = []
    for law in (with_it, without):
        _, memory = law.command(state, action, fresh_law_memory(law.needs, 1, state.position))
        ends.append(law.command(later, action, memory)[0])
    assert float((ends[0] - ends[1]).abs().max()) > 1e-3


def test_what_is_far_below_does_not_flip_it() -> None:
    """2 m down at 1.25 N/m is more than a Crazyflie weighs: as the firmware has it the thrust would point down."""
    end = fly(make_law(MELLINGER, TUNED), TUNED, 1.0, [0.0, 0.0, -2.0, 0.0])
    assert all(float(state.attitude[0, 3]) > 0.99 for state in end)
    assert float(end[-1].position[0, 2]) < -0.5


@pytest.mark.slow
def test_brescianini_leans_within_the_inclination_for_a_far_lower_setpoint() -> None:
    """2 m down at 1 / (0.3 s)² is more than any weight: without the limit it would turn over to thrust downwards."""
    law = make_law(BRESCIANINI, TUNED)
    leant = [quat_rotate(s.attitude, unit_z(s.position))[0, 2] for s in fly(law, TUNED, 1.5, [0.5, 0.0, -2.0, 0.0])]
    largest = derive_inclination(law.allocation.vehicle, law.allocation, 9.81)
    assert 0.3 < acos(float(min(leant))) < largest + 0.05


def test_brescianini_has_derived_thrust_limits() -> None:
    law = make_law(BRESCIANINI)
    lying, upside_down = (float(brescianini_demand(law, at_rest((roll, 0.0, 0.0)))[0, 0]) for roll in (1.55, 3.0))
    assert lying == pytest.approx(float(law.allocation.high.sum()), rel=1e-9)
    assert upside_down == pytest.approx(0.1 * X500.body.mass * 9.81, rel=1e-12)


def test_brescianini_holds_thrust_and_rates_for_its_rate_loop() -> None:
    law = make_law(BRESCIANINI, **FIRMWARES_RATES[BRESCIANINI])
    states = [at_rest((0.1 * k, 0.0, 0.0), (0.0, 0.1 * (k == 3), 0.0)) for k in range(6)]
    memory, result = fresh_law_memory(law.needs, 1, states[0].position), []
    for state in states:
        command, memory = law.command(state, torch.zeros(1, 4, dtype=F64), memory)
        result.append(command)
    same = [bool(torch.equal(a, b)) for a, b in pairwise(result)]
    assert same == [True, True, False, False, False]
    assert law.memory_at_rest(torch.zeros(4, dtype=F64)).tolist() == pytest.approx(
        [X500.body.mass * 9.81, 0.0, 0.0, 0.0]
    )
    assert torch.equal(result[4], result[0])


def test_brescianini_flies_vehicles_that_are_no_crazyflie() -> None:
    for robot in ("typhoon_hexarotor", "neural_fly_quad"):
        cfg = ROBOTS.get(robot)
        law = make_law(BRESCIANINI, cfg)
        lift = rotor_thrust(law.allocation.vehicle, run_law(law, rest_state(cfg), [0.0] * 4)).sum()
        assert float(lift) == pytest.approx(cfg.body.mass * 9.81, rel=1e-9)
    assert float(law.gains.mixing[0]) == float(law.gains.rate[0, 2]) == 0.0


@pytest.mark.parametrize("name", [MELLINGER, PID])
def test_what_does_not_fit_is_refused_by_name(name: str) -> None:
    for robot, why in (
        ("typhoon_hexarotor", "has 6 rotors"),
        ("omnidirectional_octarotor", "reversible"),
        ("neural_fly_quad", "do not turn it about each axis"),
    ):
        with pytest.raises(ConfigError, match=rf"four rotors in an X .*{why}.*Take lee_position_control"):
            make_law(name, ROBOTS.get(robot))
    with pytest.raises(ConfigError, match="law 'velocity': the Crazyflie's controllers control position only"):
        make_law(name, law="velocity")
    with pytest.raises(ConfigError, match="are 2 autopilots"):
        replace(CONTROLLERS.get(MELLINGER), crazyflie_pid=CrazyfliePidCfg())
    with pytest.raises(ConfigError, match="no rate loop to reach"):
        replace(CONTROLLERS.get(MELLINGER), delay=0.01)
    with pytest.raises(ConfigError, match=r"CrazyfliePidCfg.rate_kp = \(1.0, -1.0, 1.0\): must be >= 0"):
        CrazyfliePidCfg(rate_kp=(1.0, -1.0, 1.0))
    assert_refused(ConfigError, "CrazyfliePidCfg.rate_hz = 0.0: must be > 0", CrazyfliePidCfg, rate_hz=0.0)
    assert_refused(ConfigError, "MellingerCfg.mass = 0.0: must be > 0", MellingerCfg, mass=0.0)


def test_what_brescianini_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="law 'velocity': the Crazyflie's controllers control position only"):
        make_law(BRESCIANINI, law="velocity")
    with pytest.raises(ConfigError, match=r"BrescianiniCfg.mixing_factor = 1.5: must be from 0 to 1"):
        BrescianiniCfg(mixing_factor=1.5)
    with pytest.raises(ConfigError, match=r"BrescianiniCfg.coll_min = 2.0: must be below coll_max = 2.0"):
        BrescianiniCfg(coll_min=2.0, coll_max=2.0)
    times = ("tau_xy", "tau_z", "tau_rp", "tau_rp_rate", "tau_yaw_rate")
    for name in (*times, "omega_rp_max", "omega_yaw_max", "coll_max"):
        assert_refused(ConfigError, rf"BrescianiniCfg.{name} = 0.0: must be > 0", BrescianiniCfg, **{name: 0.0})


@pytest.mark.parametrize("name", [MELLINGER, PID, BRESCIANINI])
def test_an_axis_that_a_robot_leaves_alone_is_left_alone(name: str) -> None:
    robot = replace(X500, control=replace(X500.control, attitude_frequency=(5.0, 5.0, 0.0)))
    law = make_law(name, robot)
    turned = run_law(law, at_rest((0.0, 0.0, 0.5), (0.0, 0.0, 0.4)), [0.0] * 4)
    torch.testing.assert_close(turned, run_law(law, at_rest(), [0.0] * 4), rtol=1e-9, atol=0)


@pytest.mark.slow
def test_lee_with_integrals_holds_a_weight_and_a_torque_that_nobody_declared() -> None:
    """3 % more weight, the centre of mass 2 mm ahead: of 0.03 g / K_p, and of x, a twentieth at most is left after 20
    s. Without integrals all of it stands after 8 s."""
    plant = replace(X500, body=replace(X500.body, com=(0.002, 0.0, 0.0)))
    kept, left = (
        fly(make_law(LEE, dt=0.02, **own), plant, span, [0.0] * 4, heavier=1.03, dt=0.02)[-1].position[0].abs()
        for own, span in (({"crazyflie_lee": CrazyflieLeeCfg(Kpos_I=(0.2, 0.2, 0.2))}, 20.0), ({}, 8.0))
    )
    stiffness = make_law(LEE, dt=0.02).gains.lee.position[0, 2]
    assert float(left[2]) == pytest.approx(0.03 * 9.81 / float(stiffness), rel=0.01)
    assert float(left[0]) > 0.02
    assert float(kept[0] / left[0]) < 0.05
    assert float(kept[2] / left[2]) < 0.05


def test_the_integral_of_attitude_takes_away_what_a_torque_leaves() -> None:
    plant = replace(X500, body=replace(X500.body, com=(0.002, 0.0, 0.0)))
    own = CrazyflieLeeCfg(KI=(1.0, 1.0, 0.1))
    laws = make_law(LEE, dt=0.02, crazyflie_lee=own), make_law(LEE, dt=0.02)
    spans = zip(laws, (15.0, 8.0), strict=True)
    kept, left = (float(fly(law, plant, s, [0.0] * 4, dt=0.02)[-1].position[0, 0].abs()) for law, s in spans)
    assert left > 0.02
    assert kept < 0.1 * left
    gains, weight = laws[0].gains, X500.body.mass * 9.81
    most = (gains.attitude_integral * gains.attitude_limit)[0]
    torch.testing.assert_close(most, 0.5 * laws[0].allocation.torque_authority(weight))


def run_mellinger(**target: list[float]) -> tuple[list[float], list[float]]:
    """Return thrust and moment in counts at rest and level with an inclination limit; masses and gains are simple numbers."""
    widths = {"mass": 1, "mass_thrust": 1, "rate_difference": 1}
    values = {"mass": 0.5, "mass_thrust": 100.0, "position": 1.0, "rate": 20.0, "attitude": 7.0}
    gains = MellingerGains(
        **{
            name: torch.full((1, widths.get(name, 3)), values.get(name, 0.0), dtype=F64)
            for name in MellingerGains.__annotations__
        }
    )
    rows = {name: torch.tensor([target.get(name, [0.0, 0.0, 0.0])], dtype=F64) for name in FlatTarget.__annotations__}
    flat = FlatTarget(**(rows | {"yaw": torch.zeros(1, dtype=F64)}))
    state = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    thrust, moment, _ = mellinger_control(
        state, flat, torch.zeros(1, 8, dtype=F64), gains, gravity=10.0, dt=0.01, max_inclination=0.5
    )
    return thrust[0].tolist(), moment[0].tolist()


def test_mellinger_feeds_forward_acceleration_and_rates() -> None:
    """Thrust is ``100 m (g + a)``, moment ``20 w`` for wanted rates w of a level vehicle at its target."""
    thrust, moment = run_mellinger(acceleration=[0.0, 0.0, 3.0], rates=[0.1, -0.2, 0.3])
    assert thrust == pytest.approx([650.0])
    assert moment == pytest.approx([2.0, -4.0, 6.0])


def test_mellinger_keeps_a_tenth_of_the_weight_for_a_far_lower_target() -> None:
    assert run_mellinger(position=[0.0, 0.0, -50.0])[0] == pytest.approx([50.0])


def test_the_velocity_setpoint_is_at_most_a_tenth_above_its_limit() -> None:
    """5 m ahead with 10 1/s asks for 50 m/s; the limit of 2 m/s allows 2.2 m/s, and 1 deg s/m makes 2.2 deg of pitch."""
    rows = {name: torch.zeros(1, 3, dtype=F64) for name in PidLevel.__annotations__}
    levels = [PidLevel(**(rows | {"proportional": torch.full((1, 3), gain, dtype=F64)})) for gain in (10.0, 1.0)]
    gains = PidGains(
        position=levels[0], velocity=levels[1], attitude=levels[0], rates=levels[0],
        most_velocity=torch.full((1, 3), 2.0, dtype=F64),
        **{name: torch.full((1, 1), 20.0, dtype=F64) for name in ("most_tilt", "thrust_base", "least_thrust")},
    )  # fmt: skip
    state = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    position = state.position + torch.tensor([[5.0, 0.0, 0.0]], dtype=F64)
    setpoint, _ = outer_loop(state, position, torch.zeros(1, 6, dtype=F64), gains, dt=0.01)
    assert setpoint[0].tolist() == pytest.approx([20.0, 0.0, 2.2])


def test_torque_of_one_count_is_that_of_four_rotors_with_their_shares() -> None:
    """A count of thrust is 1/65535 of the largest; half a count acts at each arm about x and y, a whole one turns about z."""
    vehicle = physics.vehicle_from_config(ROBOTS.get("crazyflie_2x_arpl"), num_envs=1, dtype=torch.float64)
    allocation = Allocation(vehicle, 9.81)
    torque = torque_per_count(vehicle, allocation, rotor_signs("position", vehicle, allocation, 9.81), 9.81)
    count = 0.1420 / 65535.0
    lateral = 4.0 * 0.028 * 0.5 * count
    assert torque.tolist() == pytest.approx([lateral, lateral, 4.0 * count * 1.45e-10 / 2.431e-8], rel=1e-3)
