"""PX4's parameters as rows of tensors, with defaults derived from the vehicle, and the units of its normalised commands.

Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import radians

import torch
from torch import Tensor

from aerial_gym.config.autopilots import Px4Cfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.filters.biquad import Biquad, butterworth, notch
from aerial_gym.control.gains import frequency_ratio_of_loop, make_gains_with_timing
from aerial_gym.control.px4.cascade import PositionGains, smoothing_coefficient
from aerial_gym.control.timing import Timing
from aerial_gym.errors import ConfigError
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.vehicle import Vehicle

INTEGRAL_SHARE = 0.5  # Derived limit of the integral, as a share of the torque at hover, as in `control.cascade`
LEAST_SHARE = 0.5  # Upper bound of a derived least thrust, as a share of hover thrust
LEAST_THRUST = 0.12  # PX4's default of MPC_THR_MIN


NOTCHES = ("IMU_GYRO_NF0", "IMU_GYRO_NF1")  # Notch filters of body rates, by the beginning of their parameters' names


@dataclass(frozen=True, kw_only=True)
class Px4Gains:
    """All parameters of the cascade, (E, 3) or (E, 1) each."""

    rate: Tensor  # MC_*RATE_P times K [s/rad]
    rate_integral: Tensor  # MC_*RATE_I times K [1/rad]
    rate_derivative: Tensor  # MC_*RATE_D times K [s²/rad]
    rate_forward: Tensor  # MC_*RATE_FF [s/rad]
    integral_limit: Tensor  # MC_RR_INT_LIM and its like [-]
    attitude: Tensor  # MC_ROLL_P and its like [1/s]
    rate_limit: Tensor  # MC_*RATE_MAX [rad/s]
    yaw_weight: Tensor  # MC_YAW_WEIGHT [-]
    unit_torque: Tensor  # Torque of a normalised 1 [N m]
    unit_thrust: Tensor  # Thrust of a normalised 1 [N]
    position: PositionGains  # Of position and velocity


@dataclass(frozen=True, kw_only=True)
class Px4Filters:
    """Filters of the cascade at their own rates."""

    notches: tuple[Biquad, ...]  # IMU_GYRO_NF0_FRQ and IMU_GYRO_NF1_FRQ, before the low-pass
    gyro: Biquad | None  # IMU_GYRO_CUTOFF
    ang_acc: float  # Low-pass coefficient of IMU_DGYRO_CUTOFF
    yaw_torque: float  # MC_YAW_TQ_CUTOFF, likewise
    acceleration: float  # MPC_VELD_LP, likewise


def unit_wrench(allocation: Allocation) -> tuple[Tensor, float]:
    """Return the torque [N m], (3,), and the thrust [N] of a normalised 1.

    PX4 scales the columns of its mixing matrix, from commands to shares of each rotor's thrust: those of roll and pitch by the
    larger root mean square, twice over, those of yaw by the largest entry, that of thrust by the mean. An axis without torque
    has 0.

    Source: PX4, ``ControlAllocationPseudoInverse::updateControlAllocationMatrixScale``.
    """
    mix = allocation.inverse[0].detach() / allocation.high[0].detach().unsqueeze(-1)
    tilt = max(_tilt_scale(mix[:, 3]), _tilt_scale(mix[:, 4]))
    scales = (tilt, tilt, float(mix[:, 5].abs().max()))
    torque = mix.new_tensor([1.0 / scale if scale > 0.0 else 0.0 for scale in scales])
    lifting = mix[:, 2][mix[:, 2].abs() > 0.0]
    return torque, 1.0 / float(lifting.mean())


def _require_lift(law: str, allocation: Allocation) -> None:
    """Raise ``ConfigError`` if a rotor pushes down at hover, which PX4's normalised thrust does not allow."""
    if bool((allocation.inverse[0, :, 2] < 0.0).any()):
        raise ConfigError(
            f"law {law!r}: PX4's normalised thrust needs rotors that all push up; some push down at this vehicle's hover. "
            "Take fully_actuated_control or a controller of the lee_ family"
        )


def _tilt_scale(column: Tensor) -> float:
    turning = column[column.abs() > 0.0]
    return float((turning.square().sum() / (0.5 * max(len(turning), 1))).sqrt())


def signal_of_thrust_share(share: Tensor, factor: float) -> Tensor:
    """Return the motor signal s, 0 to 1, of a share of the full thrust in PX4's model: ``f s² + (1 - f) s = share``.

    Source: PX4, THR_MDL_FAC, ``FunctionMotors::updateValues``.
    """
    if factor == 0.0:
        return share
    middle = (1.0 - factor) / (2.0 * factor)
    return (middle**2 + share.clamp_min(0.0) / factor).sqrt() - middle


def derive_parameters(
    cfg: ControllerCfg, px4: Px4Cfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float,
    timing: Timing,
) -> Px4Gains:  # fmt: skip
    """Derive the parameters for a declared vehicle, equal in all environments.

    Missing ones follow from ``control.gains``: torque per rate and attitude error, acceleration per velocity and position
    error. Integrals are slower by a², with the a of that module: of rates against the rate loop, of velocity against the
    position loop.

    Raises:
        ConfigError: If the limits exclude hover thrust.
    """
    base = make_gains_with_timing(cfg, control, vehicle, allocation, gravity=gravity, timing=timing)
    _require_lift(cfg.law, allocation)
    torque, thrust = unit_wrench(allocation)
    inertia, slow = vehicle.inertia[0].diagonal(), frequency_ratio_of_loop(control.phase_margin) ** 2
    rate = base.rate[0]
    turns = (rate > 0.0) & (torque > 0.0)
    some, unit = torch.where(turns, rate, 1.0), torch.where(turns, torque, 1.0)
    authority = allocation.torque_authority(float(vehicle.mass[0]) * base.gravity)
    known = {
        "P": torch.where(turns, rate / unit, 0.0),
        "I": torch.where(turns, rate.square() / inertia / slow / unit, 0.0),
        "LIM": torch.where(turns, INTEGRAL_SHARE * authority / unit, 0.0),
        "ANGLE": torch.where(turns, base.attitude[0] / some, 0.0),
    }
    row = vehicle.rows_for_all_envs
    scale = [getattr(px4, f"MC_{axis}RATE_K") for axis in _AXES]

    def rate_parameter(name: str, derived: Tensor | None = None) -> Tensor:
        named = [getattr(px4, f"MC_{axis}RATE_{name}") for axis in _AXES]
        return row(_explicit_or_derived(named, derived)) * row(scale) if name != "FF" else row(named)

    velocity, position = base.velocity[0], base.position[0] / base.velocity[0]
    return Px4Gains(
        rate=rate_parameter("P", known["P"]),
        rate_integral=rate_parameter("I", known["I"]),
        rate_derivative=rate_parameter("D"),
        rate_forward=rate_parameter("FF"),
        integral_limit=row(_explicit_or_derived([px4.MC_RR_INT_LIM, px4.MC_PR_INT_LIM, px4.MC_YR_INT_LIM], known["LIM"])),
        attitude=row(_explicit_or_derived([px4.MC_ROLL_P, px4.MC_PITCH_P, px4.MC_YAW_P], known["ANGLE"])),
        rate_limit=row([radians(getattr(px4, f"MC_{axis}RATE_MAX")) for axis in _AXES]),
        yaw_weight=row([px4.MC_YAW_WEIGHT]),
        unit_torque=row(torque),
        unit_thrust=row([thrust]),
        position=_position_gains(
            px4, row, position, velocity, slow, hover=_hover_thrust(px4, vehicle, allocation, base.gravity, thrust),
            tilt=base.max_inclination, gravity=base.gravity,
        ),
    )  # fmt: skip


_AXES = ("ROLL", "PITCH", "YAW")
Row = Callable[[Tensor | Sequence[float]], Tensor]  # Function from numbers to rows of all environments


def _position_gains(
    px4: Px4Cfg, row: Row, position: Tensor, velocity: Tensor, slow: float, *, hover: float, tilt: float,
    gravity: float,
) -> PositionGains:  # fmt: skip
    def axis_values(name: str, derived: Tensor | None = None) -> Tensor:
        flat, up = (getattr(px4, f"MPC_{axis}_{name}") for axis in ("XY", "Z"))
        return _explicit_or_derived([flat, flat, up], derived)

    speed, reach = axis_values("VEL_P_ACC", velocity), axis_values("P", position)
    least = min(LEAST_THRUST, LEAST_SHARE * hover) if px4.MPC_THR_MIN is None else px4.MPC_THR_MIN
    if not least < hover < px4.MPC_THR_MAX:
        raise ConfigError(
            f"Px4Cfg: the hover thrust {hover:.3g} must be between MPC_THR_MIN = {least:.3g} and MPC_THR_MAX = "
            f"{px4.MPC_THR_MAX:g}. Change them, or take a robot with more thrust (see aerial-gym robot check)"
        )
    return PositionGains(
        position=row(reach),
        velocity=row(speed),
        integral=row(axis_values("VEL_I_ACC", speed.to(reach) * reach / slow)),
        derivative=row(axis_values("VEL_D_ACC")),
        speed=row([px4.MPC_XY_VEL_MAX]),
        up=row([px4.MPC_Z_VEL_MAX_UP]),
        down=row([px4.MPC_Z_VEL_MAX_DN]),
        least_thrust=row([max(least, 1e-3)]),
        most_thrust=row([px4.MPC_THR_MAX]),
        margin=row([min(px4.MPC_THR_XY_MARG, px4.MPC_THR_MAX)]),
        tilt=row([tilt if px4.MPC_TILTMAX_AIR is None else radians(px4.MPC_TILTMAX_AIR)]),
        hover=row([hover]),
        gravity=row([gravity]),
    )


def _hover_thrust(px4: Px4Cfg, vehicle: Vehicle, allocation: Allocation, gravity: float, unit: float) -> float:
    """Return the normalised hover thrust, by PX4's thrust curve if it is given."""
    if px4.MPC_THR_HOVER is not None:
        return px4.MPC_THR_HOVER
    weight = float(vehicle.mass[0]) * gravity
    if px4.THR_MDL_FAC is None:
        return weight / unit
    carrying = (allocation.inverse[0, :, 2] * weight).expand_as(allocation.high)
    low, high = vehicle.speed_low[0], vehicle.speed_high[0]
    signal = ((allocation.speed(carrying)[0] - low) / (high - low)).clamp_min(0.0)
    share = px4.THR_MDL_FAC * signal.square() + (1.0 - px4.THR_MDL_FAC) * signal
    return float((share * rotor_thrust(vehicle, vehicle.speed_high)[0]).sum()) / unit


def make_filters(px4: Px4Cfg, timing: Timing) -> Px4Filters:
    """Make the filters for their rates.

    Raises:
        ConfigError: If the frequency of a second-order filter is not below half of its rate.
    """
    span = timing.loop * timing.dt
    bands = [(getattr(px4, f"{name}_FRQ"), getattr(px4, f"{name}_BW")) for name in NOTCHES]
    used = {f"{name}_BW": width for name, (frequency, width) in zip(NOTCHES, bands, strict=True) if frequency > 0.0}
    used |= {f"{name}_FRQ": frequency for name, (frequency, _) in zip(NOTCHES, bands, strict=True)}
    for name, frequency in (used | {"IMU_GYRO_CUTOFF": px4.IMU_GYRO_CUTOFF}).items():
        if frequency * span >= 0.5:
            raise ConfigError(
                f"Px4Cfg.{name} = {frequency:g}: must be below half of the {1.0 / span:g} Hz of the rate controller "
                "runs. Leave the filter out (0), or take a smaller physics step (SimCfg.dt)"
            )
    return Px4Filters(
        notches=tuple(band for ends in bands if (band := notch(*ends, 1.0 / span)) is not None),
        gyro=butterworth(px4.IMU_GYRO_CUTOFF, 1.0 / span),
        ang_acc=smoothing_coefficient(px4.IMU_DGYRO_CUTOFF, span),
        yaw_torque=smoothing_coefficient(px4.MC_YAW_TQ_CUTOFF, span),
        acceleration=smoothing_coefficient(px4.MPC_VELD_LP, timing.law * timing.dt),
    )


def _explicit_or_derived(named: list[float | None], derived: Tensor | None = None) -> Tensor:
    """Return the given numbers, with derived ones in place of None, (3,)."""
    if derived is None:
        return torch.tensor(named, dtype=torch.float64)
    return torch.stack([d if n is None else d.new_tensor(n) for n, d in zip(named, derived, strict=True)])
