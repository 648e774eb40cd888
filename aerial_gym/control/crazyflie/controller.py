"""The Crazyflie's controllers as controllers with memory.

    crazyflie_mellinger_control:  action -> Mellinger (at ``ControllerCfg.rate_hz``) -> counts -> rotors
    crazyflie_pid_control:        action -> position, velocity (at ``ControllerCfg.rate_hz``)
                                         -> attitude, rates (at ``CrazyfliePidCfg.rate_hz``) -> counts -> rotors
    crazyflie_lee_control:        action -> Lee with integrals (at ``ControllerCfg.rate_hz``) -> allocation -> rotors
    crazyflie_brescianini_control: action -> thrust, wanted rates (at ``ControllerCfg.rate_hz``)
                                         -> torque (at ``BrescianiniCfg.rate_hz``) -> allocation -> rotors

Differences to the firmware: integrals and differences start from the first measurement, so that a reset gives no kick, and
the thrust of Mellinger and Brescianini respects ``ControlCfg.max_inclination``.
Not modelled: the estimator, compensation of the battery, and the cut of the thrust near the ground.
Frames: world z up, body x forward, y left, z up. Letters: E environments, R rotors, M remembered numbers.
"""

from collections.abc import Callable
from dataclasses import replace
from math import degrees
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie import brescianini, geometric, mellinger, parameters, pid
from aerial_gym.control.crazyflie.distribution import MOST_COUNTS, require_position, rotor_counts
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.control.stateful import StatefulController
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle


class _Crazyflie(StatefulController):
    """Common part of the controllers: parameters and timing."""

    _widths: tuple[int, int]  # Numbers of memory of the inner and the outer level
    _derived_type: type[parameters.GainsOfVehicle] = parameters.GainsOfVehicle  # Type of the derived gains
    _make_gains: Callable[[Any, Any], Any]  # From the autopilot's parameters and derived gains to the gains

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive timing and gains from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        assert cfg.autopilot is not None
        require_position(cfg.law)
        own = select_autopilot(cfg, control)
        self.action_names = LAWS[cfg.law].action
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        timing = make_timing(replace(cfg, **{cfg.autopilot: own}), dt)
        self._derived = self._derived_type(cfg, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self.gains = type(self)._make_gains(own, self._derived)
        inner, outer = self._widths
        self.set_needs(timing, num_rotors=vehicle.num_rotors, inner=inner, outer=outer, num_setpoint=4)


class _CrazyflieInCounts(_Crazyflie):
    """Common part of controllers with output in counts: the power distribution."""

    _derived_type = parameters.GainsOfVehicleInCounts
    _derived: parameters.GainsOfVehicleInCounts

    def _speeds(self, thrust: Tensor, moment: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), for a thrust (E, 1) and moments (E, 3) [counts]."""
        counts = rotor_counts(thrust, moment, self._derived.signs)
        return self.allocation.speed(self.allocation.high * counts / MOST_COUNTS)


def target_at_rest(action: Tensor) -> mellinger.FlatTarget:
    """Return the target of an action (E, 4), position and yaw, without motion."""
    still = torch.zeros_like(action[:, :3])
    return mellinger.FlatTarget(
        position=action[:, :3], velocity=still, acceleration=still, yaw=action[:, 3], rates=still
    )


class MellingerController(_CrazyflieInCounts):
    """``crazyflie_mellinger_control``."""

    _widths, _make_gains = (mellinger.WIDTH, 0), parameters.mellinger_gains

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) for position [m] and yaw [rad], (E, 4)."""
        memory = torch.cat((memory[:, :6], torch.where(begins, state.ang_vel[:, :2], memory[:, 6:])), dim=-1)
        thrust, moment, memory = mellinger.mellinger_control(
            state,
            target_at_rest(setpoint),
            memory,
            self.gains,
            gravity=self._derived.gravity,
            dt=self.timing.inner_period,
            max_inclination=self._derived.tilt,
        )
        return self._speeds(thrust, moment), memory


class PidController(_CrazyflieInCounts):
    """``crazyflie_pid_control``."""

    _widths, _make_gains = (pid.INNER_NUMBERS, pid.OUTER_NUMBERS), parameters.pid_gains

    @property
    def hover_setpoint(self) -> Tensor:
        """Hover thrust [counts], level."""
        setpoint = super().hover_setpoint
        setpoint[0] = self.gains.thrust_base[0, 0]
        return setpoint

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrust [counts], roll, pitch and yaw [deg], (E, 4), for position [m] and yaw [rad]."""
        wanted, memory = pid.outer_loop(state, action[:, :3], memory, self.gains, dt=self.timing.outer_period)
        return torch.cat((wanted, degrees(1.0) * action[:, 3:]), dim=-1), memory

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) for thrust and angles."""
        memory = torch.where(begins, pid.initial_memory_of_attitude_loops(state), memory)
        moment, memory = pid.inner_loop(state, setpoint[:, 1:], memory, self.gains, dt=self.timing.inner_period)
        return self._speeds(setpoint[:, :1], moment), memory


class CrazyflieLeeController(_Crazyflie):
    """``crazyflie_lee_control``; its thrust and torque go through the allocation, so that any multirotor flies."""

    _widths, _make_gains = (geometric.WIDTH, 0), parameters.integral_gains

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) for position [m] and yaw [rad], (E, 4)."""
        target, span = target_at_rest(setpoint), self.timing.inner_period
        thrust, torque, memory = geometric.geometric_control(state, target, memory, self.gains, dt=span)
        return self.allocation.speed_for_wrench(thrust_wrench(thrust, torque)), memory


class BrescianiniController(_Crazyflie):
    """``crazyflie_brescianini_control``; its thrust and torque go through the allocation, so that any multirotor flies."""

    _widths, _make_gains = (0, 0), parameters.brescianini_gains

    @property
    def hover_setpoint(self) -> Tensor:
        """Weight [N] and no body rates."""
        setpoint = super().hover_setpoint
        setpoint[0] = self.gains.mass[0, 0] * self._derived.gravity
        return setpoint

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrust [N] and body-rate setpoint [rad/s], (E, 4), for position [m] and yaw [rad]."""
        gravity, tilt = self._derived.gravity, self._derived.tilt
        target = target_at_rest(action)
        return brescianini.outer_loop(state, target, self.gains, gravity=gravity, max_inclination=tilt), memory

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) for thrust and body rates."""
        torque = brescianini.rate_torque(state.ang_vel, setpoint[:, 1:], self.gains)
        return self.allocation.speed_for_wrench(thrust_wrench(setpoint[:, 0], torque)), memory
