"""Betaflight's rate loop as a controller with memory.

    action -> body rates (at ``ControllerCfg.rate_hz``) -> filters, PID and mixer (at ``BetaflightCfg.rate_hz``) -> motors

The throttle of an action is a thrust, as for other controllers: 0 holds the weight. A motor signal from 0 to 1 is linear in
the speed, from the lowest to the highest.
Not modelled: notch and RPM filters, dynamic cut-offs, PT2 and PT3 filters, the low-pass of yaw P, D max, anti-gravity,
throttle boost, stick smoothing, TPA below ``tpa_low_breakpoint``, thrust linearisation, dynamic idle, yaw spin recovery, and
the battery. TPA follows the throttle of the same run; the firmware's acts one run later.
Frames: body x forward, y left, z up. Betaflight's differ in signs only.
Letters: E environments, R rotors, M remembered numbers.
"""

from dataclasses import replace
from math import radians

import torch
from torch import Tensor

from aerial_gym.config.autopilots import BetaflightCfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.betaflight.parameters import derive_parameters, make_filters, require_betaflight_vehicle
from aerial_gym.control.filters.biquad import apply_filter
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.stateful import StatefulController
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

RELAXED_FROM = radians(40.0)  # High-passed setpoint that stops the integral [rad/s]. Source: Betaflight 4.5, `pid.c`
RATE_LIMIT = radians(1998.0)  # Largest rate setpoint of the sticks [rad/s]. Source: Betaflight 4.5, `rc.c`, 1998 deg/s
THROTTLE_STEP = 0.001  # Resolution of the throttle [-]: below half of it is none. Source: Betaflight 4.5, `rc.c`


def rate_setpoint_of_stick(stick: Tensor, center: Tensor, largest: Tensor, expo: Tensor) -> Tensor:
    """Return the rate setpoint of a stick: ``c x + max(m - c, 0) |x| (e x⁵ + (1 - e) x)``, at most ``RATE_LIMIT``.

    Args:
        stick: x, -1 to 1, (E, 3).
        center: c, rate per stick about the centre [rad/s], (E, 3).
        largest: m, rate at full stick [rad/s], (E, 3).
        expo: e, 0 to 1, (E, 3).

    Source:
        Betaflight 4.5, Actual rates: ``rc.c``, ``applyActualRates``.
    """
    bent = stick.abs() * (expo * stick**5 + (1.0 - expo) * stick)
    return (center * stick + (largest - center).clamp_min(0.0) * bent).clamp(-RATE_LIMIT, RATE_LIMIT)


def anti_windup_factor(change: Tensor, used: Tensor, windup: float) -> Tensor:
    """Return the anti-windup factor on the growth of the integrals, (E, 3), 0 to 1.

    Args:
        change: Setpoint minus its low-pass [rad/s], (E, 3); 0 on axes without I-term relax.
        used: Range of the previous corrections, as a share of the motors' range, (E, 1).
        windup: Range from which the integral of yaw slows down; 1 for never.

    Source:
        Betaflight, ``pid.c``: I-term relax by the setpoint; ``iterm_windup`` of 4.2 to 4.5 acts on yaw (pull request 9597).
    """
    rest = (1.0 - change.abs() / RELAXED_FROM).clamp_min(0.0)
    if windup >= 1.0:
        return rest
    room = ((1.0 - used) / (1.0 - windup)).clamp(0.0, 1.0)
    return torch.cat((rest[:, :2], rest[:, 2:] * room), dim=-1)


def mix_signals(throttle: Tensor, mix: Tensor, *, airmode: bool) -> tuple[Tensor, Tensor]:
    """Return motor signals, 0 to 1, (E, R), and the range of the corrections, (E, 1).

    Corrections that need more than the motors' range are scaled down to it. Without airmode they are scaled further:
    by a half at zero throttle, linearly less up to half throttle. The throttle then moves until no motor exceeds a limit.

    Args:
        throttle: Signals without corrections, (E, R); their mean is the throttle.
        mix: Corrections, (E, R).
        airmode: Whether corrections keep their size at low throttle.

    Source:
        Betaflight 4.3 to 4.5, mixer type LEGACY: ``mixer.c``, ``applyMixerAdjustment``.
    """
    used = mix.amax(-1, keepdim=True).clamp_min(0.0) - mix.amin(-1, keepdim=True).clamp_max(0.0)
    scaled = mix / used.clamp_min(1.0)
    if not airmode:
        scaled = scaled * (0.5 + throttle.mean(-1, keepdim=True)).clamp(0.5, 1.0)
    signal = throttle + scaled
    signal = signal + (-signal.amin(-1, keepdim=True)).clamp_min(0.0)
    signal = signal - (signal.amax(-1, keepdim=True) - 1.0).clamp_min(0.0)
    return signal.clamp(0.0, 1.0), used


def throttle_attenuation(throttle: Tensor, rate: float, breakpoint: float) -> Tensor:
    """Return the factor of throttle PID attenuation, (E, 1), at signals without corrections, (E, R).

    Args:
        throttle: 0 to 1, (E, R); their mean counts.
        rate: Attenuation at full throttle, 0 to 1.
        breakpoint: Throttle at which attenuation begins, 0 to below 1.
    """
    return 1.0 - rate * ((throttle.mean(-1, keepdim=True) - breakpoint) / (1.0 - breakpoint)).clamp(0.0, 1.0)


PARTS = (3, 6, 6, 6, 6, 3, 3, 3, 1)
"""Sizes of its memory: integral; states of the two filters of body rates and of the two of the derivative; filtered rate of
the derivative, low-pass of the setpoint, and setpoint of the previous run; range of the corrections."""

STICKS = ("thrust (0 is hover) [-]", "roll stick, -1 to 1 [-]", "pitch stick [-]", "yaw stick [-]")


class BetaflightController(StatefulController):
    """``betaflight_rate_control``."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive gains and filters from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        own: BetaflightCfg = select_autopilot(cfg, control)
        self._own, timing = own, make_timing(replace(cfg, betaflight=own), dt)
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        require_betaflight_vehicle(cfg.law, vehicle, self.allocation)
        self.action_names = STICKS if own.rates_type == "ACTUAL" else LAWS[cfg.law].action
        self.gains = derive_parameters(cfg, own, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self.filters = make_filters(own, timing)
        self._low, self._span = vehicle.speed_low, vehicle.speed_high - vehicle.speed_low
        self.set_needs(timing, num_rotors=vehicle.num_rotors, inner=sum(PARTS), num_setpoint=4)

    @property
    def hover_setpoint(self) -> Tensor:
        """Thrust of one weight and no body rates."""
        setpoint = super().hover_setpoint
        setpoint[0] = 1.0
        return setpoint

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrust per weight and body-rate setpoint [rad/s], (E, 4), of an action."""
        wanted, gains = action[:, 1:], self.gains
        if self._own.rates_type == "ACTUAL":
            wanted = rate_setpoint_of_stick(wanted.clamp(-1.0, 1.0), gains.center, gains.largest, gains.expo)
        return torch.cat((action[:, :1] + 1.0, wanted), dim=-1), memory

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R), for thrust per weight and body rates, (E, 4)."""
        gains, own, span = self.gains, self._own, self.timing.inner_period
        integral, *filtered, slow, eased, before, used = memory.split(PARTS, dim=-1)
        rate, seen = state.ang_vel, state.ang_vel
        for number, low_pass in enumerate((*self.filters.gyro, *self.filters.derivative)):
            if low_pass is None:
                filtered[number] = torch.zeros_like(filtered[number])
            else:
                rate, filtered[number] = apply_filter(rate, filtered[number], begins, low_pass)
            if number == 1:
                seen = rate
        ang_acc = torch.where(begins, 0.0, (rate - slow) / span)
        wanted, error = setpoint[:, 1:], setpoint[:, 1:] - seen
        eased = torch.where(begins, wanted, eased + self.filters.relax * (wanted - eased))
        change = torch.where(begins, 0.0, (wanted - before) / span)
        relaxed = {"OFF": (0.0, 0.0, 0.0), "RP": (1.0, 1.0, 0.0), "RPY": (1.0, 1.0, 1.0)}[own.iterm_relax]
        windup = own.iterm_windup / 100.0 if own.version == "4.5" else 1.0
        share = anti_windup_factor((wanted - eased) * wanted.new_tensor(relaxed), used, windup)
        integral = integral + share * gains.integral * error * span
        integral = integral.clamp(-gains.integral_limit, gains.integral_limit)
        throttle = self.throttle(setpoint[:, :1])
        weaker = throttle_attenuation(throttle, own.tpa_rate / 100.0, own.tpa_breakpoint / 1000.0 - 1.0)
        of_error = weaker if own.tpa_mode == "PD" else 1.0
        correction = (
            of_error * gains.rate * error + integral - weaker * gains.derivative * ang_acc + gains.forward * change
        )
        correction = gains.mix * correction.clamp(-gains.limit, gains.limit)
        mix = (self.allocation.inverse[..., 3:] * correction.unsqueeze(1)).sum(-1)
        signal, used = mix_signals(throttle, mix, airmode=own.airmode)
        if not own.airmode:  # the firmware resets the integrals after each run at zero throttle
            integral = torch.where(throttle.mean(-1, keepdim=True) < 0.5 * THROTTLE_STEP, 0.0, integral)
        after = torch.cat((integral, *filtered, rate, eased, wanted, used), dim=-1)
        return self.speed_of_signal(signal), after

    def throttle(self, thrust: Tensor) -> Tensor:
        """Return motor signals without corrections, 0 to 1, (E, R), for thrust per weight, (E, 1)."""
        return self.signal_of_speed(self.allocation.speed(thrust * self.gains.weight * self.allocation.inverse[..., 2]))

    def signal_of_speed(self, speed: Tensor) -> Tensor:
        """Return motor signals, 0 to 1, (E, R), for rotor speeds [rad/s]."""
        return (speed - self._low) / self._span

    def speed_of_signal(self, signal: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), for motor signals, 0 to 1."""
        return self._low + self._span * signal
