"""Every registered robot hovers under every geometric controller that fits it. Flights take 100 Hz, the coarsest
registered sim, where time step and rotor lag leave the smallest margins. The slow suite flies all sims.
Every registered controller holds a robot at rest; ``tests/cross/test_batch_size.py`` has other motions, in batches.
A vehicle whose arm is another than the robot file says, with an autopilot that knows it and one that does not.
Position and attitude by themselves: vehicles whose rotors push in every direction, in air and under water.
"""

from dataclasses import replace
from itertools import product
from math import atan, exp, pi, sqrt

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import make_gains
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate_inverse
from aerial_gym.physics import TorchBackend, build_model, state_at_rest, vehicle_from_config
from aerial_gym.physics.model import robot_effects
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import (
    GRAVITY,
    MEANT_FOR,
    PUSH,
    WIND,
    ControlFlight,
    fly_robot,
    geometric_controllers,
    misfit_reason,
    robot_controllers,
    robots_by_dynamics,
    target_robot,
)
from tests.builders import simulation
from tests.physics.vehicles import F64
from tests.repetitions import frequent_values, thin_values

ALLOWED = dict.fromkeys(("position", "pose"), 0.2)
ALLOWED |= dict.fromkeys(("velocity", "steering", "acceleration", "attitude", "rates"), 0.02)
"""Error after 10 s, in the units of the command: a tenth of the room's side, a twenty-fifth of the largest initial value."""

SLOW = {"px4_velocity_control": 0.25, "crazyflie_pid_control": 0.5}
"""Limits of laws that need more than 10 s, as an integral unwinds or a speed limit holds them: half of the largest initial
velocity [m/s] and of the room's half width [m]. A law that diverges exceeds them."""

WEAK_YAW = {"tinyprop": 0.5}
"""Limits of position laws for robots with little yaw torque [m]: half of the room's half width; it may start backwards."""


def overshoot_limit(damping_ratio: float) -> float:
    return exp(-pi * damping_ratio / sqrt(1.0 - damping_ratio**2))


OVERSHOOT, OVERSHOOT_OF_INTEGRALS = overshoot_limit(0.69), overshoot_limit(0.4)
"""Limits as shares of the step. Gains are derived for a damping ratio near ``1 / sqrt(2)``. An integral adds overshoot; a phase
margin of 40 degrees corresponds to a damping ratio of 0.4."""

INTEGRAL = (
    "pid_rates_control", "px4_rate_control", "betaflight_rate_control", "px4_velocity_control", "px4_position_control",
)  # fmt: skip
"""Controllers whose loop has an integral."""


def assert_flies(flight: ControlFlight, cfg: RobotCfg) -> None:
    allowed = SLOW.get(flight.controller, ALLOWED[flight.law])
    if flight.law == "position":
        allowed = max(allowed, WEAK_YAW.get(flight.robot, 0.0))
    assert flight.error < allowed, f"{flight.error:.3g} after 10 s"
    assert flight.tilt_rad < pi / 2
    if is_tuned(CONTROLLERS.get(flight.controller), cfg):
        return
    if flight.controller != "px4_velocity_control":  # its integral unwinds for longer
        assert flight.settling_s < 10.0
    if cfg.control.gains is None:  # other gains were not derived for this robot
        assert flight.overshoot < (OVERSHOOT_OF_INTEGRALS if flight.controller in INTEGRAL else OVERSHOOT)


def is_tuned(law: ControllerCfg, cfg: RobotCfg) -> bool:
    return law.autopilot is not None and getattr(cfg.control, law.autopilot) is not None


def coarsest_sim(law: ControllerCfg, cfg: RobotCfg) -> SimCfg:
    sims = sorted((SIMS.get(name) for name in SIMS), key=lambda sim: -sim.dt)
    return next((sim for sim in sims if not misfit_reason(cfg, law, sim)), sims[0])


FAST = [
    name
    for name, cfg in geometric_controllers().items()
    if cfg.rate_settings is None or cfg.law in ("position", "rates")
]


def select_flights() -> list[tuple[str, str]]:
    """Return every ninth robot with the position controller, and of every thirtieth flight every second controller.
    ``test_nor_with_any_other_controller_at_any_sim`` flies all of them."""
    return [
        (robot, controller)
        for i, robot in enumerate(robots_by_dynamics())
        for j, controller in enumerate(FAST)
        if (i % 9 == 0 and controller == "lee_position_control") or ((i + j) % 30 == 0 and j % 2 == 1)
    ]


@pytest.mark.parametrize(("robot", "controller"), select_flights())
def test_no_registered_robot_falls(robot: str, controller: str) -> None:
    cfg, law = robots_by_dynamics()[robot], geometric_controllers()[controller]
    sim = coarsest_sim(law, cfg)
    if why := misfit_reason(cfg, law, sim):
        assert why.startswith(f"law {law.law!r}: ")
        return
    assert_flies(fly_robot(cfg, law, sim, names=(robot, controller, "base_sim")), cfg)


def test_what_does_not_fit_is_refused_for_a_reason() -> None:
    """Rotors that point one way do not push sideways; water leaves nothing to lean against."""
    fitting = {
        n for n, r in robots_by_dynamics().items() if not misfit_reason(r, CONTROLLERS.get("fully_actuated_control"))
    }
    tilted = {"omnidirectional_octarotor", "base_octarotor", "base_random", "tilted_hexarotor"}
    assert fitting == tilted | {"base_rov", "bluerov2_heavy"}
    leaning = {
        n for n, r in robots_by_dynamics().items() if not misfit_reason(r, CONTROLLERS.get("lee_position_control"))
    }
    assert set(robots_by_dynamics()) - leaning == {"base_rov", "bluerov2_heavy"}


@pytest.mark.parametrize(
    ("name", "law"),
    frequent_values(
        product(("lmf2", "magpie", "octarotor"), ("position", "velocity", "acceleration", "attitude", "rates")),
        [("lmf2", "rates"), ("magpie", "position"), ("octarotor", "position")],
    ),
)
def test_published_gains_hold_their_robot(name: str, law: str) -> None:
    """Under the names of the Aerial Gym Simulator, which are a law and a robot's gains."""
    controller = f"{name}_{law}_control"
    robot = ROBOTS.get(target_robot(controller))
    flight = fly_robot(robot, CONTROLLERS.get(controller), SIMS.get("base_sim"), names=(name, controller, "base_sim"))
    assert flight.error < ALLOWED[law]
    assert flight.tilt_rad < pi / 2


def test_gains_of_the_rov_hold_it_too() -> None:
    """``(m + m_A) x'' = m (1 - x - 8 x') - (l + q |x'|) x'``: a metre to 0.30 m after 10 s, rotor lag of 5 to 20 ms aside."""
    robot, controller = ROBOTS.get("base_rov"), "rov_fully_actuated_control"
    flight = fly_robot(
        robot, CONTROLLERS.get(controller), SIMS.get("base_sim"), names=("base_rov", controller, "base_sim")
    )
    linear, quadratic = robot.effects["hull_drag"]["lx"], robot.effects["hull_drag"]["qx"]
    mass, added = robot.body.mass, robot.effects["added_mass"]["x"]

    def motion(_t: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, (mass * (1.0 - x - 8.0 * v) - (linear + quadratic * abs(v)) * v) / (mass + added)]

    expected = solve_ivp(motion, (0.0, 10.0), (0.0, 0.0), rtol=1e-9, atol=1e-9).y[0, -1]
    assert flight.response[-1] == pytest.approx(expected, abs=0.005)
    assert flight.overshoot == 0.0


def test_every_named_controller_fits_the_robot_that_it_means() -> None:
    """16 of the 22 names of the Aerial Gym Simulator; the others are `no_control` and `lee_*`, of any robot."""
    assert len(robot_controllers()) == 16
    for name, law in robot_controllers().items():
        assert not misfit_reason(ROBOTS.get(target_robot(name)), law), name


def test_in_wind_and_with_rotors_at_their_limits_a_law_does_what_its_equations_say() -> None:
    """``k_p e = F / m`` of a law without an integral; half a second of all that the rotors have delays a step by as long.
    The drag is along body x, of which the horizontal part is a cosine less."""
    robot, controller = ROBOTS.get("x500"), CONTROLLERS.get("lee_position_control")
    flight = fly_robot(robot, controller, SIMS.get("base_sim"), names=("x500", "lee_position_control", "base_sim"))
    vehicle = vehicle_from_config(robot, num_envs=1)
    law = make_controller(controller, vehicle, GRAVITY, dt=0.01, control=robot.control)
    lean = atan(PUSH)
    assert flight.wind_error == pytest.approx(PUSH * GRAVITY / float(law.gains.position[0, 0]), rel=lean**2)
    assert flight.wind_largest == pytest.approx(flight.wind_error, rel=1e-3)
    assert flight.limit_share > 0.9
    assert flight.settling_s < flight.limit_settling_s < flight.settling_s + 1.0
    assert flight.limit_error < 0.02


@pytest.mark.slow
def test_an_integral_of_velocity_brings_a_vehicle_back_against_the_wind() -> None:
    robot, controller = ROBOTS.get("neural_fly_quad"), "px4_position_control"
    flight = fly_robot(robot, CONTROLLERS.get(controller), SIMS.get("base_sim"), names=("quad", controller, "base_sim"))
    assert flight.wind_error < 0.25 * flight.wind_largest


def test_a_velocity_loop_drifts_with_the_wind_by_the_share_that_its_gain_leaves() -> None:
    """``m k_v v = d (w - v)`` with ``d w`` a tenth of the weight, along a body that leans by little."""
    robot, controller = ROBOTS.get("x500"), CONTROLLERS.get("lee_velocity_control")
    flight = fly_robot(robot, controller, SIMS.get("base_sim"), names=("x500", "lee_velocity_control", "base_sim"))
    law = make_controller(controller, vehicle_from_config(robot, num_envs=1), GRAVITY, dt=0.01, control=robot.control)
    drag = PUSH * GRAVITY / WIND
    expected = drag * WIND / (float(law.gains.velocity[0, 0]) + drag)
    assert flight.wind_error == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("sim", SIMS)
@pytest.mark.parametrize("controller", geometric_controllers())
@pytest.mark.parametrize("robot", robots_by_dynamics())
def test_nor_with_any_other_controller_at_any_sim(robot: str, controller: str, sim: str) -> None:
    cfg, law = robots_by_dynamics()[robot], geometric_controllers()[controller]
    if not misfit_reason(cfg, law, SIMS.get(sim)):
        assert_flies(fly_robot(cfg, law, SIMS.get(sim), names=(robot, controller, sim)), cfg)


@pytest.mark.parametrize("controller", thin_values(CONTROLLERS, 3))
def test_a_robot_at_rest_stays_there(controller: str) -> None:
    sideways = controller == "fully_actuated_control"
    name = "omnidirectional_octarotor" if sideways else MEANT_FOR.get(controller.partition("_")[0], "x500")
    robot, cpu = ROBOTS.get(name), torch.device("cpu")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    law = make_controller(CONTROLLERS.get(controller), vehicle, GRAVITY, dt=0.01, control=robot.control)
    effects = robot_effects(robot, num_envs=1, device=cpu, dtype=F64)
    backend = TorchBackend()
    backend.allocate(build_model(vehicle, effects, gravity=GRAVITY), law, integrator="euler")
    weight, allocation = torch.zeros(1, 6, dtype=F64), Allocation(vehicle, GRAVITY)
    weight[:, 2] = robot.body.mass * GRAVITY - robot.control.buoyancy
    speed = allocation.speed_for_wrench(weight)
    hover = {"no_control": allocation.allot(weight).thrust, "rotor_speed_control": speed}
    state = state_at_rest(1, vehicle.num_rotors, device=cpu, dtype=F64)
    state.rotor_speed.copy_(speed)
    rest = [tensor.clone() for tensor in state.tensors()]
    backend.step(state, hover.get(controller, torch.zeros(1, len(law.action_names), dtype=F64)), 0.01, 15)
    for tensor, expected in zip(state.tensors(), rest, strict=True):
        torch.testing.assert_close(tensor, expected, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize(
    ("backend", "tolerance"), [pytest.param("torch", 1e-6, marks=pytest.mark.slow), ("warp", 2e-5)]
)
@pytest.mark.parametrize("effectiveness", ["actual", "nominal"])
def test_a_longer_arm_tilts_only_an_autopilot_that_does_not_know_it(
    backend: str, tolerance: float, effectiveness: str
) -> None:
    """A hub d further forward gives the torque ``-d T`` more about y. Unknown, flight settles where the attitude law asks for
    as much against it: with T = m g / 4 + i M, its entry i = -1 / (4 l) of the nominal inverse and the commanded torque M,
    ``M = d T`` gives ``-K sin pitch = M = (d m g / 4) / (1 + d / (4 l))``. Known, it settles level."""
    ends = {"how": "offset", "low": (-0.015, 0.0, 0.0), "high": (0.015, 0.0, 0.0)}
    robot = replace(ROBOTS.get("base_quadrotor_doubled_inertia"), control=ControlCfg(effectiveness=effectiveness))
    env = simulation(
        robot, "lee_attitude_control", num_envs=5, seed=1, randomize={"mounts.1.position": RandomizeCfg(**ends)},
        differentiable=backend == "torch", dtype=F64 if backend == "torch" else torch.float32, backend=backend,
    )  # fmt: skip
    env.reset()
    with torch.no_grad():
        for _ in range(700):
            env.step(torch.zeros(5, 4))
    further, weight = env.draws()["mounts.1.position"][:, 0].double(), robot.body.mass * 9.81
    torque = further * weight / 4.0 / (1.0 + further / (4.0 * 0.13))
    stiffness = env.robot_manager.controller.gains.attitude[:, 1].double()
    pitch = torch.zeros(5, dtype=F64) if effectiveness == "actual" else torch.asin(-torque / stiffness)
    result = (
        env.gradient_tensors["robot_euler_angles"] if backend == "torch" else env.gtd["robot_euler_angles"].double()
    )
    assert further.abs().max() > 0.01
    torch.testing.assert_close(result[:, 1], pitch, atol=tolerance, rtol=tolerance)
    torch.testing.assert_close(result[:, 0], 0.0 * pitch, atol=tolerance, rtol=0)


def fly(robot: str, controller: str, actions: torch.Tensor, steps: int) -> EnvManager:
    env = simulation(robot, controller, num_envs=len(actions))
    env.reset()
    for _ in range(steps):
        env.step(actions)
    return env


@pytest.mark.parametrize(
    "robot", ["base_octarotor", "base_rov", pytest.param("bluerov2_heavy", marks=pytest.mark.slow)]
)
def test_a_place_is_held_in_any_attitude(robot: str) -> None:
    """Level, on its side, nose up and nearly upside down, at one and the same place; q and -q are one attitude. A centre of
    buoyancy above that of mass rights the vehicle, which a law without an integral answers with an error e about each body
    axis: ``K_i sin e = (r x B)_i``; some 0.03 rad for ``base_rov`` (0.11 N m), 0.1 rad for the BlueROV2 (1.3 N m)."""
    euler = torch.tensor([[0.0, 0.0, 0.0], [pi / 2, 0.0, 0.0], [0.0, -1.2, 0.5], [2.7, 0.0, 0.0]])
    wanted = quat_from_euler(euler)
    place = torch.tensor([[0.3, -0.2, 0.1]]).expand(4, -1)
    env = fly(robot, "fully_actuated_control", torch.cat((place, wanted), dim=-1), 1500)
    attitude = env.gtd["robot_orientation"]
    assert (env.gtd["robot_position"] - place).norm(dim=-1).max() < 0.03
    half = torch.acos((attitude * wanted).sum(-1).abs().clamp(max=1.0))
    torch.testing.assert_close(torch.sin(2.0 * half), lean_angle(robot, attitude), rtol=0.0, atol=ATTITUDE)


ATTITUDE = 1e-3
"""[rad]: a float32 cosine of half an angle that is one spacing (6e-8) below one belongs to an angle of 7e-4."""


def lean_angle(name: str, attitude: torch.Tensor) -> torch.Tensor:
    """Return the sine of the angle at which attitude gains hold a buoyancy's moment, (E,); 0 without buoyancy."""
    cfg = ROBOTS.get(name)
    buoyancy = cfg.effects.get("buoyancy", dict.fromkeys(("force", "x", "y", "z"), 0.0))
    vehicle = vehicle_from_config(cfg, num_envs=1, dtype=torch.float32)
    gains = make_gains(
        CONTROLLERS.get("fully_actuated_control"), cfg.control, vehicle, Allocation(vehicle, 9.81), gravity=9.81,
        dt=0.01,
    )  # fmt: skip
    up = quat_rotate_inverse(attitude, torch.tensor([[0.0, 0.0, buoyancy["force"]]]).expand(len(attitude), -1))
    lever = torch.tensor([[buoyancy[axis] for axis in "xyz"]]).expand_as(up)
    return (torch.linalg.cross(lever, up) / gains.attitude).norm(dim=-1)


def test_a_heading_is_steered_while_a_velocity_is_held() -> None:
    """1 m/s along the vehicle's own x at a yaw of 0.8 rad: the world velocity has that direction."""
    env = fly("lmf1", "lee_velocity_steering_angle_control", torch.tensor([[1.0, 0.0, 0.0, 0.8]]), 600)
    assert env.gtd["robot_euler_angles"][0, 2].item() == pytest.approx(0.8, abs=1e-3)
    expected = torch.tensor([0.8]).cos().item(), torch.tensor([0.8]).sin().item()
    assert env.gtd["robot_linvel"][0, :2].tolist() == pytest.approx(expected, abs=1e-3)
