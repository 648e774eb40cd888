"""PX4's cascade as a controller with memory.

    action -> position and attitude control (at ``ControllerCfg.rate_hz``) -> rate control (at ``Px4Cfg.rate_hz``) -> rotors

It has no landing detector and no hover-thrust estimator. Saturation is resolved by PX4's mixer if ``Px4Cfg.MC_AIRMODE`` is
given, else by ``ControllerCfg.allocation``. As in PX4, unallocated torque stops the integral in the next run.
Frames: world z up, body x forward, y left, z up. Letters: E environments, R rotors, M remembered numbers.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.autopilots import Px4Cfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.filters.biquad import apply_filter
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import from_vehicle_frame, thrust_wrench, unit_x
from aerial_gym.control.px4 import cascade
from aerial_gym.control.px4.parameters import derive_parameters, make_filters, signal_of_thrust_share
from aerial_gym.control.stateful import StatefulController
from aerial_gym.control.timing import make_timing
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, yaw_from_quat
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

OUTER_NUMBERS = 9  # Memory of the outer loops: integral of velocity (3), previous velocity (3), acceleration (3)


class Px4Controller(StatefulController):
    """``px4_rate_control``, ``px4_attitude_control``, ``px4_velocity_control`` and ``px4_position_control``."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive gains and filters from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        px4: Px4Cfg = select_autopilot(cfg, control)
        _require_speed_rotors(px4, vehicle)
        timing = make_timing(replace(cfg, px4=px4), dt)
        self.action_names, self._law = LAWS[cfg.law].action, cfg.law
        self._factor, self._airmode = px4.THR_MDL_FAC, px4.MC_AIRMODE
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        self.gains = derive_parameters(cfg, px4, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self.filters = make_filters(px4, timing)
        self._full, self._low, self._span = _thrust_and_speed_ranges(vehicle)
        inner = cascade.RATE_NUMBERS + 6 * len(self.filters.notches)
        self.set_needs(timing, num_rotors=vehicle.num_rotors, inner=inner, outer=OUTER_NUMBERS, num_setpoint=4)

    @property
    def hover_setpoint(self) -> Tensor:
        """Normalised hover thrust and no body rates."""
        setpoint = super().hover_setpoint
        setpoint[0] = self.gains.position.hover[0, 0]
        return setpoint

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return normalised thrust and body-rate setpoint [rad/s], (E, 4), of an action."""
        gains, still = self.gains, torch.zeros_like(action[:, 3])
        if self._law == "rates":
            return torch.cat(((action[:, :1] + 1.0) * gains.position.hover, action[:, 1:]), dim=-1), torch.zeros_like(
                memory
            )
        if self._law == "attitude":
            yaw = yaw_from_quat(state.attitude)
            wanted = quat_from_euler(torch.stack((action[:, 1], action[:, 2], yaw), dim=-1))
            thrust = (action[:, :1] + 1.0) * gains.position.hover
            rates = self._rate_setpoint(state, wanted, action[:, 3])
            return torch.cat((thrust, rates), dim=-1), torch.zeros_like(memory)
        if self._law == "velocity":
            heading, yaw_rate = from_vehicle_frame(state.attitude, unit_x(action)), action[:, 3]
            velocity = from_vehicle_frame(state.attitude, action[:, :3])
        else:
            yaw = action[:, 3]
            heading, yaw_rate = torch.stack((torch.cos(yaw), torch.sin(yaw), still), dim=-1), still
            velocity = gains.position.position * (action[:, :3] - state.position)
        thrust, memory = self._thrust(state, velocity, memory, begins)
        rates = self._rate_setpoint(state, cascade.attitude_from_thrust(thrust, heading), yaw_rate)
        return torch.cat((thrust.norm(dim=-1, keepdim=True), rates), dim=-1), memory

    def _thrust(self, state: BodyState, velocity: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return the thrust [-], world, (E, 3), for a velocity setpoint [m/s], world, and the new memory, (E, 9)."""
        integral, before, smooth = memory.split(3, dim=-1)
        span = self.timing.outer_period
        measured = torch.where(begins, 0.0, (state.lin_vel - before) / span)
        smooth = smooth + self.filters.acceleration * (measured - smooth)
        error = cascade.limit_velocity(velocity, self.gains.position) - state.lin_vel
        _, thrust, integral = cascade.velocity_control(error, integral, smooth, self.gains.position, span)
        return thrust, torch.cat((integral, state.lin_vel, smooth), dim=-1)

    def _rate_setpoint(self, state: BodyState, wanted: Tensor, yaw_rate: Tensor) -> Tensor:
        gains = self.gains
        return cascade.rate_setpoint(
            state.attitude, wanted, yaw_rate, gain=gains.attitude, yaw_weight=gains.yaw_weight, limit=gains.rate_limit
        )

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R), for normalised thrust and body rates, (E, 4)."""
        gains, filters, span = self.gains, self.filters, self.timing.inner_period
        sizes = (3, 3, 3, 6, 3, 1, *[6] * len(filters.notches))
        integral, ang_acc, before, low_pass, short, yaw, *notched = memory.split(sizes, dim=-1)
        rate = state.ang_vel
        for k, band in enumerate(filters.notches):
            rate, notched[k] = apply_filter(rate, notched[k], begins, band)
        if filters.gyro is None:
            low_pass = torch.zeros_like(low_pass)
        else:
            rate, low_pass = apply_filter(rate, low_pass, begins, filters.gyro)
        measured = torch.where(begins, 0.0, (rate - before) / span)
        ang_acc = ang_acc + filters.ang_acc * (measured - ang_acc)
        wanted, error = setpoint[:, 1:], setpoint[:, 1:] - rate
        torque = cascade.rate_torque(
            error, wanted, ang_acc, integral, (gains.rate, gains.rate_derivative, gains.rate_forward)
        )
        integral = cascade.update_integral(integral, error, short, gains.rate_integral, gains.integral_limit, span)
        yaw = yaw + filters.yaw_torque * (torque[:, 2:] - yaw)
        torque = torch.cat((torque[:, :2], yaw), dim=-1)
        thrust, short = self._mix(torque, setpoint[:, :1])
        after = torch.cat((integral, ang_acc, rate, low_pass, short, yaw, *notched), dim=-1)
        return self._speeds(thrust), after

    def _mix(self, torque: Tensor, collective: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrusts [N], (E, R), for normalised torque and thrust, and the sign of unallocated torque, (E, 3)."""
        unit_torque, unit_thrust = self.gains.unit_torque, self.gains.unit_thrust
        if self._airmode is not None:
            inverse, full = self.allocation.inverse, self.allocation.high
            turning = inverse[..., 3:] * unit_torque.unsqueeze(1)
            lifting = inverse[..., 2:3] * unit_thrust.unsqueeze(1)
            columns = torch.cat((turning, lifting), dim=-1) / full.unsqueeze(-1)
            wanted = torch.cat((torque, collective), dim=-1)
            mixed = cascade.mix(columns, wanted, self.allocation.low / full, airmode=self._airmode)
            return mixed.signal * full, mixed.short
        allotted = self.allocation.allot(thrust_wrench((collective * unit_thrust)[:, 0], torque * unit_torque))
        given = torch.cat((allotted.turn, allotted.turn, allotted.rest), dim=-1)
        return allotted.thrust, torch.where(given < 1.0, torch.sign(torque), 0.0)

    def _speeds(self, thrust: Tensor) -> Tensor:
        """Return the rotor speeds [rad/s] of thrusts [N] within their limits, (E, R), by PX4's thrust curve."""
        if self._factor is None:
            return self.allocation.speed_within_limits(thrust)
        return self._low + self._span * signal_of_thrust_share((thrust / self._full).clamp(0.0, 1.0), self._factor)


def _require_speed_rotors(px4: Px4Cfg, vehicle: Vehicle) -> None:
    """Raise ``ConfigError`` for a thrust curve with rotors that cannot have one."""
    if px4.THR_MDL_FAC is not None and vehicle.traits & {"reversible", "force"}:
        raise ConfigError(
            f"Px4Cfg.THR_MDL_FAC = {px4.THR_MDL_FAC:g}: the curve needs rotors that turn in one direction and take a speed. "
            "Leave it out"
        )


def _thrust_and_speed_ranges(vehicle: Vehicle) -> tuple[Tensor, Tensor, Tensor]:
    """Return the full thrust [N], the lowest speed and the span of speeds [rad/s] of each rotor, (E, R)."""
    low, high = vehicle.speed_low, vehicle.speed_high
    return rotor_thrust(vehicle, high), low, high - low
