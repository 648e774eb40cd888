"""Our answers to the random states of ``crazyflie_vectors``, beside the firmware's, in our frames."""

from collections.abc import Iterator
from math import inf

import numpy as np
import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie import brescianini, pid
from aerial_gym.control.crazyflie.brescianini import BrescianiniGains
from aerial_gym.control.crazyflie.distribution import rotor_counts, rotor_signs
from aerial_gym.control.crazyflie.geometric import WIDTH as INTEGRALS
from aerial_gym.control.crazyflie.geometric import IntegralGains, geometric_control
from aerial_gym.control.crazyflie.mellinger import WIDTH, FlatTarget, MellingerGains, mellinger_control
from aerial_gym.control.lee import LeeGains, position_control
from aerial_gym.math.quaternion import quat_from_euler, quat_normalize, quat_rotate
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.state import BodyState
from aerial_gym.robots import ROBOTS
from tests.cross.firmware import crazyflie_vectors as made
from tests.cross.firmware.draws import load_vectors

DT = 0.002
"""Of the firmware's attitude loop [s]."""

GRAVITY = 9.81
"""The firmware's [m/s²]."""

BRESCIANINI_MASS = 0.029
"""Compiled into the firmware's controller of Brescianini [kg], as what follows: numbers that its source has."""

BRESCIANINI_INERTIA = ((16.6e-6, 0.83e-6, 0.72e-6), (0.83e-6, 16.6e-6, 1.8e-6), (0.72e-6, 1.8e-6, 29.3e-6))
"""[kg m²]."""

BRESCIANINI_COLLECTIVE = 1.0, 18.0
"""Least and largest thrust per mass [m/s²]."""

BRESCIANINI_RATE_TAU = 0.015, 0.015, 0.0075
"""Of body rates [s]."""

BRESCIANINI_RATES = 30.0, 10.0
"""Largest wanted rates of tilting and about body z [rad/s]; none that was drawn is as large."""

LOOSE = 1.5707
"""An inclination that is no limit [rad]."""

Pair = tuple[Tensor, Tensor]


def read_vectors() -> dict[str, Tensor]:
    """Return the firmware's answers by name, as they stand in the file."""
    return load_vectors(made.VECTORS, made.states_checksum())


def _split(rows: np.ndarray, *widths: int) -> list[Tensor]:
    return list(torch.from_numpy(rows).double().split(widths, dim=-1))


def _state(attitude: Tensor, position: Tensor, velocity: Tensor, gyro: Tensor) -> BodyState:
    rates = torch.deg2rad(gyro)
    return BodyState(
        position=position, attitude=attitude, lin_vel=velocity, ang_vel=rates,
        rotor_speed=position.new_zeros(len(position), 4),
    )  # fmt: skip


def lee_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return thrust [N] and torque [N m], (N, 4); the firmware's integrals are off, as ours has none. Ours keeps a tenth of
    the weight upwards in what it wants, the firmware does not: states that want less are left out."""
    gains, rows = made.lee_states()
    mass, inertia, position, velocity, attitude, rate = _split(gains, 1, 3, 3, 3, 3, 3)
    q, at, moving, gyro, goal, goal_velocity, yaw = _split(rows, 4, 3, 3, 3, 3, 3, 1)
    own = LeeGains(
        position=position, velocity=velocity, attitude=attitude, rate=rate, mass=mass[:, 0], inertia=torch.diag_embed(inertia),
        gravity=GRAVITY, max_yaw_rate=inf, max_inclination=LOOSE,
    )  # fmt: skip
    # Ours comes to rest at its goal: a wanted velocity is one that is taken off the measured one.
    state = _state(quat_normalize(q), at, moving - goal_velocity, gyro)
    wrench = position_control(state, torch.cat((goal, torch.deg2rad(yaw)), dim=-1), own)
    upwards = position[:, 2] * (goal - at)[:, 2] + velocity[:, 2] * (goal_velocity - moving)[:, 2] + GRAVITY
    kept = upwards > 0.1 * GRAVITY
    return wrench[kept, 2:], vectors["lee"][kept]


def lee_integral_pair(vectors: dict[str, Tensor], *, integrals: bool = True) -> Pair:
    """Return thrust [N] and torque [N m], (STEPS, RUNS, 4), of runs of ten steps, integrals without limits or off."""
    gains, rows = made.lee_integral_states()
    mass, inertia, position, velocity, attitude, rate, far, turned = _split(gains, 1, 3, 3, 3, 3, 3, 3, 3)
    lee = LeeGains(
        position=position, velocity=velocity, attitude=attitude, rate=rate, mass=mass[:, 0], inertia=torch.diag_embed(inertia),
        gravity=GRAVITY, max_yaw_rate=inf, max_inclination=LOOSE,
    )  # fmt: skip
    free = torch.full_like(far, inf if integrals else 0.0)
    own = IntegralGains(
        lee=lee, position_integral=far, position_limit=free, attitude_integral=turned, attitude_limit=free
    )
    kept, result = mass.new_zeros(made.RUNS, INTEGRALS), []
    for state, target in _steps(rows):
        thrust, torque, kept = geometric_control(state, target, kept, own, dt=DT)
        result.append(torch.cat((thrust.unsqueeze(-1), torque), dim=-1))
    return torch.stack(result), vectors["lee_integrals"].transpose(0, 1)


def mellinger_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return thrust and moments [counts], (STEPS, RUNS, 4), of runs of ten steps."""
    gains, rows = made.mellinger_states()
    named = dict(zip(made.MELLINGER, torch.from_numpy(gains).double().unsqueeze(-1).unbind(1), strict=True))

    def axis_gains(name: str) -> Tensor:
        return torch.cat((named[f"{name}_xy"], named[f"{name}_xy"], named[f"{name}_z"]), dim=-1)

    own = MellingerGains(
        mass=named["mass"], mass_thrust=named["massThrust"], position=axis_gains("kp"), velocity=axis_gains("kd"),
        position_integral=axis_gains("ki"), position_limit=axis_gains("i_range"), attitude=axis_gains("kR"),
        rate=axis_gains("kw"), attitude_integral=axis_gains("ki_m"),
        attitude_limit=axis_gains("i_range_m"), rate_difference=named["kd_omega_rp"],
    )  # fmt: skip
    kept, result = own.mass.new_zeros(made.RUNS, WIDTH), []
    for state, target in _steps(rows):
        thrust, moment, kept = mellinger_control(state, target, kept, own, gravity=GRAVITY, dt=DT)
        result.append(torch.cat((thrust, moment.trunc()), dim=-1))
    return torch.stack(result), _nose_down(vectors["mellinger"]).transpose(0, 1)


def pid_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return thrust and moments [counts], (STEPS, RUNS, 4), of runs of ten steps, of which two move position and velocity."""
    rows, own = _split(made.pid_states(), 3, 3, 3, 3, 3, 1), default_pid_gains(made.RUNS)
    outer, inner, told, result = torch.zeros(made.RUNS, pid.OUTER_NUMBERS, dtype=torch.float64), None, None, []
    for k, step in enumerate(zip(*(part.unbind(1) for part in rows), strict=True)):
        angles, at, moving, gyro, goal, yaw = step
        state = _state(quat_from_euler(torch.deg2rad(angles)), at, moving, gyro)
        if told is None or k % 5 == 0:
            told, outer = pid.outer_loop(state, goal, outer, own, dt=5 * DT)
        if inner is None:  # the firmware begins with no rates before
            inner = torch.cat((pid.initial_memory_of_attitude_loops(state)[:, :9], torch.zeros_like(at)), dim=-1)
        moment, inner = pid.inner_loop(state, torch.cat((told[:, 1:], yaw), dim=-1), inner, own, dt=DT)
        result.append(torch.cat((told[:, :1], moment.trunc()), dim=-1))
    return torch.stack(result), _nose_down(vectors["pid"]).transpose(0, 1)


def brescianini_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return thrust [N] and torque [N m], (STEPS, RUNS, 4), of runs of ten steps, of which two move thrust and wanted rates."""
    gains, rows = made.brescianini_states()
    own, wish, result = firmware_brescianini_gains(gains, mixing=1.0), torch.zeros(0), []
    for k, step in enumerate(torch.from_numpy(rows).double().unbind(1)):
        state, target = _follow(step)
        if k % 5 == 0:
            wish = brescianini.outer_loop(state, target, own, gravity=GRAVITY)
        result.append(torch.cat((wish[:, :1], brescianini.rate_torque(state.ang_vel, wish[:, 1:], own)), dim=-1))
    return torch.stack(result), vectors["brescianini"].transpose(0, 1)


def brescianini_reduced_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return the wanted rates of the tilt alone [rad/s], (RUNS, 3), which the firmware's torques show. Without the heading
    it turns about an axis that it takes in the world, where the report, and ours, take it in the body: ours are seen in the
    world."""
    gains, rows = made.brescianini_states()
    own = firmware_brescianini_gains(gains, mixing=0.0)
    state, target = _follow(torch.from_numpy(rows[:, 0]).double())
    actual = brescianini.outer_loop(state, target, own, gravity=GRAVITY)[:, 1:] - target.rates
    reference = torch.linalg.solve(own.inertia, vectors["brescianini_reduced"][:, 1:]) / own.rate + state.ang_vel
    return quat_rotate(state.attitude, actual), reference - target.rates


def firmware_brescianini_gains(gains: np.ndarray, *, mixing: float) -> BrescianiniGains:
    """Return drawn gains (N, 5), in the order of ``crazyflie_vectors.BRESCIANINI``, with what the firmware has compiled in."""
    tau_xy, zeta_xy, tau_z, zeta_z, tau_rp = _split(gains, 1, 1, 1, 1, 1)
    tau, zeta = torch.cat((tau_xy, tau_xy, tau_z), dim=-1), torch.cat((zeta_xy, zeta_xy, zeta_z), dim=-1)

    def row(*numbers: float) -> Tensor:
        return tau.new_tensor(numbers).expand(len(tau), -1)

    (least, most), (tilting, heading) = BRESCIANINI_COLLECTIVE, BRESCIANINI_RATES
    return BrescianiniGains(
        mass=row(BRESCIANINI_MASS), inertia=tau.new_tensor(BRESCIANINI_INERTIA).expand(len(tau), 3, 3), position=1.0 / tau**2,
        velocity=2.0 * zeta / tau, attitude=1.0 / tau_rp, mixing=row(mixing), rate=1.0 / row(*BRESCIANINI_RATE_TAU),
        least_thrust=row(least), most_thrust=row(most), tilt_rate_limit=row(tilting), yaw_rate_limit=row(heading),
    )  # fmt: skip


def _steps(rows: np.ndarray) -> Iterator[tuple[BodyState, FlatTarget]]:
    """Yield the states and the targets of the steps of runs, (RUNS, STEPS, 20): of position, velocity and yaw."""
    for rows_of_step in torch.from_numpy(rows).double().unbind(1):
        yield _follow(torch.nn.functional.pad(rows_of_step, (0, 4)))


def _follow(rows: Tensor) -> tuple[BodyState, FlatTarget]:
    """Return the state and the target of rows (N, 24)."""
    q, at, moving, gyro, goal, velocity, yaw, acceleration, yaw_rate = rows.split((4, 3, 3, 3, 3, 3, 1, 3, 1), dim=-1)
    rates = torch.cat((torch.zeros_like(goal[:, :2]), torch.deg2rad(yaw_rate)), dim=-1)
    target = FlatTarget(
        position=goal, velocity=velocity, acceleration=acceleration, yaw=torch.deg2rad(yaw[:, 0]), rates=rates
    )
    return _state(quat_normalize(q), at, moving, gyro), target


def power_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return the counts of the four rotors, (N, 4), of which the firmware's are whole numbers."""
    vehicle = vehicle_from_config(ROBOTS.get("crazyflie_21"), num_envs=1, dtype=torch.float64)
    signs = rotor_signs("position", vehicle, Allocation(vehicle, GRAVITY), GRAVITY)
    counts = _nose_down(torch.from_numpy(made.power_states()).double())
    return rotor_counts(counts[:, :1], counts[:, 1:], signs.tolist()), vectors["power"]


def default_pid_gains(num_envs: int) -> pid.PidGains:
    """Return the gains that the Crazyflie comes with: ``pid_rate``, ``pid_attitude``, ``velCtlPid``, ``posCtlPid``."""

    def rows(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64).expand(num_envs, -1)

    def level(
        p: tuple[float, ...], i: tuple[float, ...], d: tuple[float, ...], limit: tuple[float, ...]
    ) -> pid.PidLevel:
        return pid.PidLevel(proportional=rows(*p), integral=rows(*i), derivative=rows(*d), limit=rows(*limit))

    none, far = (0.0, 0.0, 0.0), (5000.0, 5000.0, 5000.0)
    return pid.PidGains(
        position=level((2.0, 2.0, 2.0), (0.0, 0.0, 0.5), none, far),
        velocity=level((25.0, 25.0, 25.0), (1.0, 1.0, 15.0), none, far),
        attitude=level((6.0, 6.0, 6.0), (3.0, 3.0, 1.0), (0.0, 0.0, 0.35), (20.0, 20.0, 360.0)),
        rates=level((250.0, 250.0, 120.0), (500.0, 500.0, 16.7), (2.5, 2.5, 0.0), (33.3, 33.3, 166.7)),
        most_velocity=rows(1.0, 1.0, 1.0), most_tilt=rows(20.0), thrust_base=rows(36000.0), least_thrust=rows(20000.0),
    )  # fmt: skip


def _nose_down(counts: Tensor) -> Tensor:
    """Return thrust, roll, pitch, yaw [counts] of the firmware with moments about our axes."""
    return counts * counts.new_tensor((1.0, 1.0, -1.0, -1.0))
