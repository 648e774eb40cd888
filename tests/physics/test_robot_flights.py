"""Every registered robot hovers under every geometric controller that fits it. Flights take 100 Hz, the coarsest
registered sim, where time step and rotor lag leave the smallest margins. The slow suite flies all sims."""

from itertools import product
from math import atan, exp, pi, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.env_manager import SIMS
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import (
    GRAVITY,
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
from tests.repetitions import frequent_values

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
