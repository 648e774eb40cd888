"""PX4's cascade as a controller: units, filters, limits and integrals, each against what it must do exactly. Its laws
are held to PX4's own library in ``tests/cross/test_px4.py``, its Warp twin to torch in ``test_cascade.py``.
The mixer at the limits of the motors gives the numbers of PX4's unit tests.
Thrust and attitude setpoints of PX4's position control: numbers by hand, and SciPy.
"""

from cmath import exp
from dataclasses import replace
from math import pi, sin, sqrt

import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym import EFFECTS, ROBOTS, physics
from aerial_gym.config.autopilots import Px4Cfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg, RateLoopCfg
from aerial_gym.config.loader import build
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.allocation import Allocation, allocation_matrix
from aerial_gym.control.filters.biquad import apply_filter, butterworth, notch
from aerial_gym.control.px4.cascade import (
    MixerOutput,
    PositionGains,
    attitude_from_thrust,
    mix,
    quat_from_axes,
    velocity_control,
)
from aerial_gym.control.px4.controller import Px4Controller
from aerial_gym.control.px4.parameters import signal_of_thrust_share, unit_wrench
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics.law_memory import fresh_law_memory

F64 = torch.float64
CPU = torch.device("cpu")
X500 = ROBOTS.get("x500")
GAZEBO = ROBOTS.get("x500_px4")
"""With the motor limits of PX4's Gazebo model, 150 to 1000 rad/s, and PX4's default parameters."""

PX4_DEFAULTS = replace(GAZEBO.control.px4, IMU_GYRO_CUTOFF=40.0)
"""With its gyro filter too."""


def make_law(
    name: str, robot: RobotCfg = X500, *, px4: Px4Cfg | None = None, dt: float = 0.002,
    control: ControlCfg | None = None,
) -> Px4Controller:  # fmt: skip
    cfg = CONTROLLERS.get(name)
    cfg = cfg if px4 is None else replace(cfg, px4=px4)
    return make_controller(cfg, physics.vehicle_from_config(robot, num_envs=1, dtype=F64), 9.81, dt=dt, control=control)


def fly(
    name: str, action: list[float], span: float, *, robot: RobotCfg = GAZEBO, px4: Px4Cfg | None = PX4_DEFAULTS,
    wind: float = 0.0, dt: float = 0.004,
) -> list[physics.BodyState]:  # fmt: skip
    """Return the states of every 0.1 s of a flight from hover, on the fused backend; wind along x [m/s]."""
    vehicle = physics.vehicle_from_config(robot, num_envs=1)
    pairs = [(EFFECTS.get("rotor_drag"), torch.tensor([[0.3, 0.3, 0.0]]))]
    pairs.append((EFFECTS.get("constant_wind"), torch.tensor([[wind, 0.0, 0.0]])))
    cfg, backend = CONTROLLERS.get(name), physics.WarpBackend()
    cfg = cfg if px4 is None else replace(cfg, px4=px4)
    backend.allocate(physics.build_model(vehicle, pairs), make_controller(cfg, vehicle, 9.81, dt=dt), integrator="rk4")
    state = physics.state_at_rest(1, vehicle.num_rotors, device=CPU, dtype=torch.float32)
    state.rotor_speed.fill_(physics.rotor_state_for_thrust(robot.rotor, robot.body.mass * 9.81 / vehicle.num_rotors))
    states = []
    for _ in range(round(span / 0.1)):
        backend.step(state, torch.tensor([action]), dt, round(0.1 / dt))
        states.append(physics.BodyState(**{key: value.clone() for key, value in vars(state).items()}))
    return states


def test_normalised_commands_are_those_of_px4s_mixer() -> None:
    """Quadrotor in X: roll 1 is sqrt(1/2) of each rotor's thrust T, yaw and thrust 1 all of it: 4 sqrt(1/2) T l, 4 T k, 4 T."""
    torque, thrust = unit_wrench(Allocation(physics.vehicle_from_config(X500, num_envs=1, dtype=F64), 9.81))
    tilt = 4.0 * sqrt(0.5) * 20.0 * 0.174
    torch.testing.assert_close(torque, torch.tensor([tilt, tilt, 4.0 * 20.0 * 0.025], dtype=F64))
    assert thrust == pytest.approx(80.0)


@pytest.mark.parametrize("factor", [0.0, 0.3, 1.0])
def test_the_thrust_curve_is_undone(factor: float) -> None:
    share = torch.linspace(0.0, 1.0, 11, dtype=F64)
    signal = signal_of_thrust_share(share, factor)
    torch.testing.assert_close(factor * signal**2 + (1.0 - factor) * signal, share, atol=1e-15, rtol=0)


def test_rotors_follow_the_curve_that_the_autopilot_assumes() -> None:
    """With THR_MDL_FAC = 0 thrust grows with the signal: hover thrust u gives 150 + 850 u = 689 rad/s, the hover speed."""
    law = make_law("px4_rate_control", GAZEBO, px4=PX4_DEFAULTS)
    hover = float(law.gains.position.hover[0, 0])
    speed = sqrt(1.656 * 9.81 / 4 / 8.54858e-6)
    assert hover == pytest.approx((speed - 150.0) / 850.0)
    state = physics.state_at_rest(1, 4, device=CPU, dtype=F64)
    command = law.rotor_command(state, torch.zeros(1, 4, dtype=F64))
    torch.testing.assert_close(command, torch.full((1, 4), speed, dtype=F64))


def test_the_gyro_filter_has_its_cutoff() -> None:
    """A sine at the cut-off comes out with 1/sqrt(2) of its size, a constant as it is, from the first sample on."""
    rate, cutoff = 500.0, 40.0
    filter = butterworth(cutoff, rate)
    assert filter is not None
    assert butterworth(0.0, rate) is None
    kept, begins, out = torch.zeros(1, 6, dtype=F64), torch.ones(1, 1, dtype=torch.bool), []
    for k in range(500):
        sample = torch.tensor([[torch.sin(torch.tensor(2 * pi * cutoff * k / rate, dtype=F64)), 0.7, 0.0]], dtype=F64)
        result, kept = apply_filter(sample, kept, begins, filter)
        begins = torch.zeros_like(begins)
        out.append(result[0])
    sine, constant, empty = torch.stack(out).unbind(-1)
    assert float(sine[-125:].square().mean().sqrt() * sqrt(2.0)) == pytest.approx(sqrt(0.5), rel=1e-9)
    torch.testing.assert_close(constant, torch.full_like(constant, 0.7), atol=1e-12, rtol=0)
    assert not empty.any()


def test_a_notch_stops_its_frequency_and_is_as_wide_as_told() -> None:
    """``H = 0`` in the middle, 1 at rest and at half the rate; the edges of half the power are the width apart, exactly."""
    rate, middle, width = 500.0, 87.0, 20.0
    band = notch(middle, width, rate)
    assert notch(0.0, width, rate) is None

    def power(frequency: float) -> float:
        z = exp(-2j * pi * frequency / rate)
        return abs((band.b0 + band.b1 * z + band.b2 * z * z) / (1.0 + band.a1 * z + band.a2 * z * z)) ** 2

    assert power(middle) < 1e-25
    assert power(0.0) == pytest.approx(1.0, abs=1e-12)
    assert power(0.5 * rate) == pytest.approx(1.0, abs=1e-12)
    below = brentq(lambda f: power(f) - 0.5, 1.0, middle)
    above = brentq(lambda f: power(f) - 0.5, middle, 240.0)
    assert above - below == pytest.approx(width, rel=1e-9)


def test_notches_act_on_the_body_rates_before_the_low_pass() -> None:
    px4 = Px4Cfg(IMU_GYRO_CUTOFF=60.0, IMU_GYRO_NF0_FRQ=87.0, IMU_GYRO_NF1_FRQ=150.0, IMU_GYRO_NF1_BW=10.0)
    law, end = make_law("px4_rate_control", px4=replace(px4, MC_ROLLRATE_I=0.0)), []
    for frequency in (87.0, 150.0, 120.0):
        state, memory, commands = physics.state_at_rest(1, 4, device=CPU, dtype=F64), None, []
        memory = fresh_law_memory(law.needs, 1, state.position)
        for k in range(400):
            state.ang_vel[0, 0] = 0.1 * sin(2.0 * pi * frequency * k * 0.002)
            command, memory = law.command(state, torch.zeros(1, 4, dtype=F64), memory)
            commands.append(command[0])
        end.append(float(torch.stack(commands[-100:]).std(0).max() / command.mean()))
    assert max(end[:2]) < 1e-6 * end[2]


@pytest.mark.parametrize(
    ("name", "px4", "axis", "proportional", "derivative", "unit"),
    [
        ("px4_rate_control", Px4Cfg(MC_YAW_TQ_CUTOFF=20.0, MC_YAWRATE_P=0.2, MC_YAWRATE_I=0.0), 5, 0.2, 0.0, 2.0),
        (
            "px4_rate_control",
            Px4Cfg(IMU_DGYRO_CUTOFF=20.0, MC_ROLLRATE_P=0.1, MC_ROLLRATE_I=0.0, MC_ROLLRATE_D=0.01),
            3, 0.1, 0.01, 80.0 * 0.174 * sqrt(0.5),
        ),
        (
            "px4_velocity_control",
            Px4Cfg(MPC_VELD_LP=20.0, MPC_Z_VEL_P_ACC=4.0, MPC_Z_VEL_I_ACC=0.0, MPC_Z_VEL_D_ACC=0.2),
            2, 4.0, 0.2, X500.body.mass,
        ),
    ],
)  # fmt: skip
def test_first_order_low_passes_leave_the_same_share_of_a_gap_every_run(
    name: str, px4: Px4Cfg, axis: int, proportional: float, derivative: float, unit: float
) -> None:
    """Backward Euler of ``y' = (x - y) / T``: a share ``q = 1 / (1 + dt / T)`` of the gap remains, ``T = 1 / (2 pi
    f)``. The yaw torque answers a step; roll and climb speed grow evenly, so that their filtered derivative is a
    step."""
    law, dt, slope = make_law(name, px4=px4), 0.002, 0.5
    q = 1.0 / (1.0 + 2.0 * pi * 20.0 * dt)
    state, action = physics.state_at_rest(1, 4, device=CPU, dtype=F64), torch.zeros(1, 4, dtype=F64)
    action[0, 3] = 0.05 if axis == 5 else 0.0
    memory = fresh_law_memory(law.needs, 1, state.position)
    matrix, weight = allocation_matrix(law.allocation.vehicle, 9.81)[0], X500.body.mass * 9.81
    for k in range(20):
        speed = slope * k * dt
        state.ang_vel[0, 0], state.lin_vel[0, 2] = (speed, 0.0) if axis == 3 else (0.0, speed if axis == 2 else 0.0)
        command, memory = law.command(state, action, memory)
        expected = -proportional * speed - derivative * slope * (1.0 - q**k)
        if axis == 5:
            expected = proportional * 0.05 * (1.0 - q ** (k + 1))
        wrench = matrix @ (X500.rotor.thrust_map[2] * command[0].square())
        assert float(wrench[axis]) - (weight if axis == 2 else 0.0) == pytest.approx(unit * expected, abs=1e-9)


def test_derived_gains_are_those_of_the_other_rate_loop() -> None:
    """Level and still, the first answer to a wanted rate is that of ``pid_rates_control``: the same torque per rate error."""
    state = physics.state_at_rest(1, 4, device=CPU, dtype=F64)
    action = torch.tensor([[0.1, 0.02, -0.03, 0.01]], dtype=F64)
    vehicle = physics.vehicle_from_config(X500, num_envs=1, dtype=F64)
    pid = make_controller(CONTROLLERS.get("pid_rates_control"), vehicle, 9.81, dt=0.002)
    result = make_law("px4_rate_control").rotor_command(state, action)
    torch.testing.assert_close(result, pid.rotor_command(state, action))


def test_px4s_own_gains_fly_its_x500() -> None:
    """Its defaults on its Gazebo model: stable at every step up to 10 ms, and 1 m is reached and held in wind, within 1 cm."""
    for name in ("px4_position_control", "px4_velocity_control", "px4_attitude_control", "px4_rate_control"):
        for dt in (0.001, 0.004, 0.01):
            cfg = replace(CONTROLLERS.get(name), px4=PX4_DEFAULTS)
            check_closed_loop(GAZEBO, cfg, gravity=9.81, dt=dt, integrator="rk4", names=("x500", name))
    end = fly("px4_position_control", [1.0, -1.0, 1.0, 0.5], 30.0, wind=3.0)[-1]
    torch.testing.assert_close(end.position, torch.tensor([[1.0, -1.0, 1.0]]), atol=0.01, rtol=0)


def test_speeds_and_tilt_have_their_limits() -> None:
    """50 m away: 12 m/s are wanted, at most 45 degrees leant; 50 m up 3 m/s; 50 m down 1.5 m/s. Drag takes less than 1 %."""
    away = fly("px4_position_control", [150.0, 0.0, 0.0, 0.0], 12.0)
    assert max(float(state.lin_vel[0, 0]) for state in away) == pytest.approx(12.0, rel=0.05)
    lean = [quat_rotate(state.attitude, torch.tensor([[0.0, 0.0, 1.0]]))[0, 2].acos() for state in away]
    assert float(max(lean)) < pi / 4 + 0.05
    up, down = (fly("px4_position_control", [0.0, 0.0, z, 0.0], 8.0)[-1] for z in (50.0, -50.0))
    assert float(up.lin_vel[0, 2]) == pytest.approx(3.0, rel=0.02)
    assert float(down.lin_vel[0, 2]) == pytest.approx(-1.5, rel=0.02)


def test_parameters_belong_to_the_robot() -> None:
    control = build(ControlCfg, {"px4": {"MC_ROLL_P": 7.0, "source": "flown"}}, where="here")
    assert float(make_law("px4_attitude_control", control=control).gains.attitude[0, 0]) == 7.0
    slower = make_law("px4_attitude_control", px4=Px4Cfg(rate_hz=250.0), control=control)
    assert float(slower.gains.attitude[0, 0]) == 7.0
    assert slower.timing.loop == 2
    own = make_law("px4_attitude_control", px4=Px4Cfg(MC_ROLL_P=5.0), control=control)
    assert float(own.gains.attitude[0, 0]) == 5.0
    with pytest.raises(ConfigError, match=r"MC_ROLL_PP.*MC_ROLL_P"):
        build(ControlCfg, {"px4": {"MC_ROLL_PP": 7.0}}, where="here")


def test_what_does_not_fit_is_refused_by_name() -> None:
    cfg = CONTROLLERS.get("px4_position_control")
    for robot in ("base_octarotor", "base_random"):
        with pytest.raises(ConfigError, match="some push down at this vehicle's hover"):
            make_law("px4_position_control", ROBOTS.get(robot))
    with pytest.raises(ConfigError, match="law 'pose': not in PX4's cascade"):
        make_controller(replace(cfg, law="pose"), physics.vehicle_from_config(X500, num_envs=1), 9.81, dt=0.002)
    for name, px4, message in (
        ("px4_position_control", Px4Cfg(MPC_THR_MIN=0.3), r"hover thrust 0.203 must be between MPC_THR_MIN = 0.3"),
        ("px4_rate_control", Px4Cfg(IMU_GYRO_CUTOFF=251.0), r"IMU_GYRO_CUTOFF = 251: must be below half of the 500 Hz"),
        ("px4_rate_control", Px4Cfg(IMU_GYRO_NF1_FRQ=300.0), r"IMU_GYRO_NF1_FRQ = 300: must be below half of the 500"),
        ("px4_rate_control", Px4Cfg(IMU_GYRO_NF0_FRQ=50.0, IMU_GYRO_NF0_BW=260.0), r"IMU_GYRO_NF0_BW = 260: must be"),
        ("px4_rate_control", Px4Cfg(rate_hz=300.0), "Px4Cfg.rate_hz = 300 Hz"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_law(name, px4=px4)
    with pytest.raises(ConfigError, match="has its own gains and rate loop"):
        ControllerCfg(summary="-", law="rates", px4=Px4Cfg(), rate_loop=RateLoopCfg())
    bad = {"MC_ROLL_P": -1.0, "MC_YAW_WEIGHT": 0.0, "THR_MDL_FAC": 1.5, "MPC_TILTMAX_AIR": 90.0, "IMU_GYRO_NF0_BW": 0.0}
    for field, value in bad.items():
        with pytest.raises(ConfigError, match=f"Px4Cfg.{field} = "):
            Px4Cfg(**{field: value})


UNIT_TEST = torch.tensor(
    [[0.25, 0.25, 5, 0.25], [-0.25, -0.25, 5, 0.25], [-0.25, 0.25, -5, 0.25], [0.25, -0.25, -5, 0.25]]
)
"""The mixing matrix of PX4's unit tests: a quadrotor of 1 m by 1 m and a moment ratio of 0.05, not normalised."""

QUADROTOR = UNIT_TEST / torch.tensor([0.25 * 2**0.5, 0.25 * 2**0.5, 5.0, 0.25])
"""The same, normalised."""


def mix_row(wanted: list[float], airmode: int, columns: Tensor = QUADROTOR, *, low: float = 0.0) -> MixerOutput:
    rows = columns.to(F64).unsqueeze(0)
    return mix(rows, torch.tensor([wanted], dtype=F64), torch.full(rows.shape[:2], low, dtype=F64), airmode=airmode)


@pytest.mark.parametrize(("wanted", "airmode", "short"), [
    ([0.1, -0.1, 0.1, 0.5], 0, [0, 0, 0]),
    ([-0.4, 0.0, 0.0, 0.1], 0, [-1, 0, 0]),
    ([-0.4, 0.0, 0.0, 0.1], 1, [0, 0, 0]),
    ([0.0, 0.0, -0.4, 0.1], 1, [0, 0, -1]),
    ([0.0, 0.0, -0.4, 0.1], 2, [0, 0, 0]),
    ([0.0, 1.2, 0.1, 0.5], 1, [0, 1, 1]),
])  # fmt: skip
def test_it_tells_which_torque_is_not_given(wanted: list[float], airmode: int, short: list[int]) -> None:
    torch.testing.assert_close(mix_row(wanted, airmode).short, torch.tensor([short], dtype=F64))


@pytest.mark.parametrize("airmode", [0, 1, 2])
def test_lost_torque_is_that_of_least_squares(airmode: int) -> None:
    """Six random motors: torque that NumPy finds in the signals; all of it is lost where a motor was clamped."""
    rng = np.random.default_rng(airmode)
    columns, wanted = rng.uniform(-1.0, 1.0, (300, 6, 4)), rng.uniform(-0.6, 0.6, (300, 4))
    columns[..., 3] = rng.uniform(0.5, 1.0, (300, 6))
    low = np.full((300, 6), 0.05)
    output = mix(*(torch.from_numpy(rows) for rows in (columns, wanted, low)), airmode=airmode)
    clamped = 0
    for column, command, signal, short in zip(columns, wanted, output.signal.numpy(), output.short, strict=True):
        given, residual, *_ = np.linalg.lstsq(column, signal, rcond=None)
        whole = residual[0] < 1e-16
        clamped += not whole
        lost = command[:3] - given[:3] * whole
        assert short.tolist() == np.where(np.abs(lost) > 1e-6, np.sign(lost), 0.0).tolist()
    assert 20 < clamped < 280


def test_the_integral_waits_for_the_torque_that_airmode_would_give() -> None:
    vehicle = physics.vehicle_from_config(ROBOTS.get("x500"), num_envs=1, dtype=F64)
    grown = []
    for airmode in (0, 1):
        px4 = Px4Cfg(MC_ROLLRATE_P=0.5, MC_ROLLRATE_I=0.5, MC_RR_INT_LIM=10.0, MC_AIRMODE=airmode)
        law = make_controller(replace(CONTROLLERS.get("px4_rate_control"), px4=px4), vehicle, 9.81, dt=0.002)
        state, memory = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64), None
        memory = fresh_law_memory(law.needs, 1, state.position)
        for _ in range(10):
            _, memory = law.command(state, torch.tensor([[-0.95, 0.3, 0.0, 0.0]], dtype=F64), memory)
        grown.append(float(memory.numbers[0, 0]))
    assert grown[1] == pytest.approx(10.0 * grown[0])  # told one run late


def test_another_airmode_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"MC_AIRMODE = 3: must be 0, 1 or 2"):
        Px4Cfg(MC_AIRMODE=3)


NUMBERS = {"position": 1.0, "velocity": 2.0, "integral": 0.5, "derivative": 0.0}
LIMITS = {"speed": 10.0, "up": 3.0, "down": 1.0, "least_thrust": 0.12, "most_thrust": 0.9, "margin": 0.3, "tilt": 0.8,
          "hover": 0.5, "gravity": 9.8}  # fmt: skip


def make_gains(**changes: float) -> PositionGains:
    rows = {name: torch.full((1, 3), value, dtype=F64) for name, value in NUMBERS.items()}
    return PositionGains(
        **rows, **{name: torch.tensor([[value]], dtype=F64) for name, value in (LIMITS | changes).items()}
    )


def control(error: list[float], integral: list[float], **changes: float) -> tuple[list[float], list[float]]:
    """Return thrust and integral after a run of 0.01 s."""
    rows = (torch.tensor([row], dtype=F64) for row in (error, integral, [0.0, 0.0, 0.0]))
    _, thrust, after = velocity_control(*rows, make_gains(**changes), 0.01)
    return thrust[0].tolist(), after[0].tolist()


@pytest.mark.parametrize(("error", "integral", "after"), [
    (0.5, -9.0, -8.9975),  # at the least thrust, but upwards
    (-0.5, -9.0, -9.0),  # at the least thrust, and downwards
    (0.5, 9.0, 9.0),  # at the most thrust, and upwards
    (-0.5, 9.5, 9.4975),  # at the most thrust, but downwards
])  # fmt: skip
def test_the_vertical_integral_leaves_a_limit_of_thrust(error: float, integral: float, after: float) -> None:
    """It grows by ``0.5 e 0.01`` unless the thrust is at a limit that the error would exceed more."""
    assert control([0.0, 0.0, error], [0.0, 0.0, integral])[1][2] == pytest.approx(after, abs=1e-12)


def test_full_vertical_thrust_without_a_margin_leaves_no_lateral_thrust() -> None:
    assert control([1.0, 0.0, 5.0], [0.0, 0.0, 9.0], margin=0.0)[0] == pytest.approx([0.0, 0.0, 0.9], abs=1e-12)


def test_a_quaternion_of_axes_is_scipys() -> None:
    """Random turns, most of which need one of the three forms for large angles."""
    rotations = Rotation.random(500, random_state=0)
    axes = torch.from_numpy(rotations.as_matrix())
    actual, expected = quat_from_axes(*axes.unbind(-1)), torch.from_numpy(rotations.as_quat())
    forms = expected.abs().argmax(-1)
    assert forms.unique().tolist() == [0, 1, 2, 3]
    sign = (actual * expected).sum(-1, keepdim=True).sign()
    torch.testing.assert_close(sign * actual, expected, rtol=0.0, atol=1e-14)


def test_an_attitude_points_its_thrust_and_keeps_the_heading() -> None:
    """Body z is along the thrust, body x in the vertical plane of the heading and on its side."""
    rng = np.random.default_rng(0)
    thrust = rng.normal(size=(100, 3)) + np.array([0.0, 0.0, 4.0])
    yaw = rng.uniform(-np.pi, np.pi, 100)
    heading = np.stack((np.cos(yaw), np.sin(yaw), 0.0 * yaw), axis=1)
    attitude = Rotation.from_quat(attitude_from_thrust(torch.from_numpy(thrust), torch.from_numpy(heading)).numpy())
    x, _, z = np.moveaxis(attitude.as_matrix(), 2, 0)
    np.testing.assert_allclose(z, thrust / np.linalg.norm(thrust, axis=1)[:, None], atol=1e-14)
    np.testing.assert_allclose(x[:, 0] * heading[:, 1], x[:, 1] * heading[:, 0], atol=1e-14)
    assert ((x * heading).sum(1) > 0.0).all()
