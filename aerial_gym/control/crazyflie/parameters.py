"""Parameters of the Crazyflie's controllers as rows of tensors, with defaults derived from the vehicle.

Derived gains are those of ``control.gains``: torque at hover per attitude and rate error, acceleration per position and
velocity error. Controllers with output in counts get torques in counts. Integrals are slower than their proportional part by
a², with the a of that module.
Letters: E environments, R rotors.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import degrees, tan

import torch
from torch import Tensor

from aerial_gym.config.autopilots import BrescianiniCfg, CrazyflieLeeCfg, CrazyfliePidCfg, MellingerCfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie.brescianini import BrescianiniGains
from aerial_gym.control.crazyflie.distribution import MOST_COUNTS, rotor_signs, torque_per_count
from aerial_gym.control.crazyflie.geometric import IntegralGains
from aerial_gym.control.crazyflie.mellinger import MellingerGains
from aerial_gym.control.crazyflie.pid import MOST_MOMENT, THRUST_PER_OUTPUT, PidGains, PidLevel
from aerial_gym.control.gains import frequency_ratio_of_loop, make_gains_with_timing
from aerial_gym.control.lee import LEAST_LIFT, LeeGains
from aerial_gym.control.timing import Timing
from aerial_gym.physics.vehicle import Vehicle

INTEGRAL_SHARE = 0.5  # Default limit of an integral, as a share of the largest moment
LEAST_OF_HOVER = 5.0 / 9.0  # Least thrust as a share of hover thrust: 20000 of 36000 counts of a Crazyflie


class GainsOfVehicle:
    """Derived gains of a declared vehicle, as rows for all environments."""

    def __init__(
        self, cfg: ControllerCfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float,
        timing: Timing,
    ) -> None:  # fmt: skip
        base: LeeGains = make_gains_with_timing(cfg, control, vehicle, allocation, gravity=gravity, timing=timing)
        self.base, self.vehicle, self.slow = base, vehicle, frequency_ratio_of_loop(control.phase_margin) ** 2
        self.row = vehicle.rows_for_all_envs
        self.authority = allocation.torque_authority(float(vehicle.mass[0]) * base.gravity)  # [N m]
        self.mass, self.most_thrust = float(vehicle.mass[0]), allocation.largest_thrust()  # [kg], [N]
        self.gravity, self.tilt = base.gravity, base.max_inclination
        self.position, self.velocity = base.position[0], base.velocity[0]
        self.attitude, self.rate = base.attitude[0], base.rate[0]  # [N m/rad], [N m s/rad]
        self.of_rate = base.rate[0] / vehicle.inertia[0].diagonal()  # 1/s
        self.of_attitude = _quotient_or_zero(base.attitude[0], base.rate[0])
        self.of_position = _quotient_or_zero(base.position[0], base.velocity[0])

    def explicit_or_derived(self, numbers: Sequence[float] | None, derived: Tensor | Sequence[float]) -> Tensor:
        """Return the given numbers, or else the derived ones, as a row."""
        return self.row(derived if numbers is None else numbers)

    def axis_gains(self, xy: float | None, z: float | None, derived: Tensor) -> Tensor:
        """Return the given numbers for x and y and for z, or else the derived ones (3,), as a row."""
        return self.row([float(d) if g is None else g for g, d in zip((xy, xy, z), derived, strict=True)])


class GainsOfVehicleInCounts(GainsOfVehicle):
    """Derived gains with torques in counts."""

    def __init__(
        self, cfg: ControllerCfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float,
        timing: Timing,
    ) -> None:  # fmt: skip
        super().__init__(cfg, control, vehicle, allocation, gravity=gravity, timing=timing)
        signs = rotor_signs(cfg.law, vehicle, allocation, gravity)
        self.signs: list[list[float]] = signs.tolist()  # equal in all environments: constants of the fused kernel
        unit = torque_per_count(vehicle, allocation, signs, gravity)
        self.per_newton = MOST_COUNTS / float(allocation.high[0].sum())
        self.attitude, self.rate = self.attitude / unit, self.rate / unit  # counts per rad, per rad/s


def _quotient_or_zero(gains: Tensor, divisor: Tensor) -> Tensor:
    """Return quotients, 0 for uncontrolled axes."""
    return torch.where(divisor > 0.0, gains / torch.where(divisor > 0.0, divisor, 1.0), 0.0)


def _integral_limit(limit: Tensor, integral: Tensor) -> Tensor:
    """Return the limits of integrals (E, 3), 0 where the integral gain is 0."""
    return torch.where(integral > 0.0, limit, torch.zeros_like(limit))


def _pid_level(proportional: Tensor, integral: Tensor, derivative: Tensor, limit: Tensor) -> PidLevel:
    return PidLevel(
        proportional=proportional, integral=integral, derivative=derivative, limit=_integral_limit(limit, integral)
    )


def mellinger_gains(own: MellingerCfg, derived: GainsOfVehicleInCounts) -> MellingerGains:
    """Return the gains of ``crazyflie_mellinger_control``, the same in all environments."""
    axes, mass = derived.axis_gains, derived.mass if own.mass is None else own.mass
    none = torch.zeros(3)
    far, turned = axes(own.ki_xy, own.ki_z, none), axes(own.ki_m_xy, own.ki_m_z, none)
    return MellingerGains(
        mass=derived.row([mass]),
        mass_thrust=derived.row([derived.per_newton if own.massThrust is None else own.massThrust]),
        position=axes(own.kp_xy, own.kp_z, mass * derived.position),
        velocity=axes(own.kd_xy, own.kd_z, mass * derived.velocity),
        position_integral=far,
        position_limit=_integral_limit(axes(own.i_range_xy, own.i_range_z, none), far),
        attitude=axes(own.kR_xy, own.kR_z, 0.5 * derived.attitude),
        rate=axes(own.kw_xy, own.kw_z, derived.rate),
        attitude_integral=turned,
        attitude_limit=_integral_limit(axes(own.i_range_m_xy, own.i_range_m_z, none), turned),
        rate_difference=derived.row([own.kd_omega_rp]),
    )


def pid_gains(own: CrazyfliePidCfg, derived: GainsOfVehicleInCounts) -> PidGains:
    """Return the gains of ``crazyflie_pid_control``, the same in all environments."""
    given, row = derived.explicit_or_derived, derived.row
    tilting = degrees(1.0) / derived.gravity * derived.velocity
    lifting = derived.mass * derived.per_newton / THRUST_PER_OUTPUT * derived.velocity
    velocity = given(own.velocity_kp, torch.cat((tilting[:2], lifting[2:])))
    rate = given(own.rate_kp, derived.rate / degrees(1.0))
    spun = given(own.rate_ki, rate[0] * derived.of_rate / derived.slow)
    largest = INTEGRAL_SHARE * MOST_MOMENT / torch.where(spun[0] > 0.0, spun[0], torch.inf)
    hover = derived.mass * derived.gravity * derived.per_newton if own.thrust_base is None else own.thrust_base
    none, free = row((0.0, 0.0, 0.0)), row((torch.inf,) * 3)
    return PidGains(
        position=_pid_level(given(own.position_kp, derived.of_position), row(own.position_ki), none, free),
        velocity=_pid_level(
            velocity, given(own.velocity_ki, velocity[0] * derived.of_position / derived.slow), none, free
        ),
        attitude=_pid_level(
            given(own.attitude_kp, derived.of_attitude),
            row(own.attitude_ki),
            row(own.attitude_kd),
            row(own.attitude_limit),
        ),
        rates=_pid_level(rate, spun, row(own.rate_kd), given(own.rate_limit, largest)),
        most_velocity=row(own.velocity_max),
        most_tilt=row([own.tilt_limit]),
        thrust_base=row([hover]),
        least_thrust=row([LEAST_OF_HOVER * hover if own.thrust_min is None else own.thrust_min]),
    )


def integral_gains(own: CrazyflieLeeCfg, derived: GainsOfVehicle) -> IntegralGains:
    """Return the gains of ``crazyflie_lee_control``, the same in all environments; integral gains only if given."""
    given, mass, base = derived.explicit_or_derived, derived.mass if own.mass is None else own.mass, derived.base
    position, attitude = given(own.Kpos_P, derived.position), given(own.KR, derived.attitude)
    far = derived.row(own.Kpos_I)
    turned = derived.row(own.KI)
    side = derived.gravity * tan(derived.tilt)
    most = INTEGRAL_SHARE * derived.position.new_tensor((side, side, derived.gravity))
    lee = replace(
        base,
        position=position,
        velocity=given(own.Kpos_D, derived.velocity),
        attitude=attitude,
        rate=given(own.Kw, derived.rate),
        mass=derived.row([mass])[:, 0],
    )
    return IntegralGains(
        lee=lee,
        position_integral=far,
        position_limit=_integral_limit(given(own.Kpos_I_limit, _quotient_or_zero(most, far[0])), far),
        attitude_integral=turned,
        attitude_limit=_integral_limit(
            given(own.KI_limit, _quotient_or_zero(INTEGRAL_SHARE * derived.authority, turned[0])), turned
        ),
    )


def brescianini_gains(own: BrescianiniCfg, derived: GainsOfVehicle) -> BrescianiniGains:
    """Return the gains of ``crazyflie_brescianini_control``, the same in all environments.

    Roll and pitch share the slower of their time constants. Heading has none: its share of the attitude error slows it down.
    Uncontrolled axes have no rate gain.
    """
    axes, row, mass = derived.axis_gains, derived.row, derived.mass
    natural = derived.position.sqrt()
    frequency = axes(_inverse_or_none(own.tau_xy), _inverse_or_none(own.tau_z), natural)
    damping = axes(own.zeta_xy, own.zeta_z, 0.5 * _quotient_or_zero(derived.velocity, natural))
    tilting = derived.of_attitude[:2]
    slower = float(tilting[tilting > 0.0].min()) if bool((tilting > 0.0).any()) else 0.0
    attitude = slower if own.tau_rp is None else 1.0 / own.tau_rp
    mixing = min(float(derived.of_attitude[2]) / attitude, 1.0) if attitude > 0.0 else 0.0
    least = LEAST_LIFT * derived.gravity if own.coll_min is None else own.coll_min
    return BrescianiniGains(
        mass=row([mass]),
        inertia=derived.vehicle.inertia,
        position=frequency.square(),
        velocity=2.0 * damping * frequency,
        attitude=row([attitude]),
        mixing=row([mixing if own.mixing_factor is None else own.mixing_factor]),
        rate=axes(_inverse_or_none(own.tau_rp_rate), _inverse_or_none(own.tau_yaw_rate), derived.of_rate),
        least_thrust=row([least]),
        most_thrust=row([derived.most_thrust / mass if own.coll_max is None else own.coll_max]),
        tilt_rate_limit=row([own.omega_rp_max]),
        yaw_rate_limit=row([own.omega_yaw_max]),
    )


def _inverse_or_none(time_constant: float | None) -> float | None:
    return None if time_constant is None else 1.0 / time_constant
