"""Controllers: a law, gains per environment, and the allocation to the rotors. They fulfil ``physics.ControlLaw``.

Letters: E environments, R rotors.
"""

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg, LeeGainsCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import LeeGains
from aerial_gym.errors import ConfigError
from aerial_gym.math.random import uniform
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

_GAINS = ("position", "velocity", "attitude", "rate")


class Controller(Protocol):
    """What a robot needs of a controller."""

    action_names: tuple[str, ...]
    """Meaning and unit of each entry of the action."""

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return commanded rotor speeds [rad/s], (E, R)."""
        ...

    def reset(self, mask: Tensor, generator: torch.Generator) -> None:
        """Draw new gains for the environments in ``mask``, bool (E,), if they are randomised."""
        ...


class ThrustController:
    """``no_control``: the action is the thrust of each rotor [N], clamped to its limits."""

    def __init__(self, vehicle: Vehicle, gravity: float) -> None:
        """Take the declared vehicle."""
        self.action_names = tuple(f"thrust {i + 1} [N]" for i in range(vehicle.num_rotors))
        self._allocation = Allocation(vehicle, gravity)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the speeds of the thrusts."""
        del state
        return self._allocation.speed(action)

    def reset(self, mask: Tensor, generator: torch.Generator) -> None:
        """Nothing is random."""
        del mask, generator


class RotorSpeedController:
    """``rotor_speed_control``: the action is the speed of each rotor [rad/s], clamped to its limits; replays logs."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Take the declared vehicle."""
        self.action_names = tuple(f"speed {i + 1} [rad/s]" for i in range(vehicle.num_rotors))
        self._low, self._high = vehicle.speed_low, vehicle.speed_high

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the clamped action."""
        del state
        return torch.clamp(action, self._low, self._high)

    def reset(self, mask: Tensor, generator: torch.Generator) -> None:
        """Nothing is random."""
        del mask, generator


class LeeController:
    """A geometric law with its gains."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float) -> None:
        """Take the configuration, the declared vehicle and gravity [m/s²]."""
        if cfg.gains is None:
            raise ConfigError(f"ControllerCfg.gains: law {cfg.law!r} needs gains")
        law = LAWS[cfg.law]
        self.action_names, self._wrench = law.action, law.wrench
        self._cfg, self._allocation = cfg.gains, Allocation(vehicle, gravity)
        self.gains = _middle_gains(cfg.gains, vehicle, gravity)
        self._ranges = {name: _range(cfg.gains, name, vehicle.com) for name in _GAINS}

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the speeds that give the wrench of the law, within the rotors' limits."""
        return self._allocation.speed(self._allocation.thrust(self._wrench(state, action, self.gains)))

    def reset(self, mask: Tensor, generator: torch.Generator) -> None:
        """Draw gains for the environments in ``mask`` if the configuration randomises them."""
        if not self._cfg.randomize:
            return
        for name, (low, high) in self._ranges.items():
            gain = getattr(self.gains, name)
            draw = uniform(low, high, tuple(gain.shape), generator=generator)
            gain.copy_(torch.where(mask.unsqueeze(-1), draw, gain))


def _range(cfg: LeeGainsCfg, name: str, like: Tensor) -> tuple[Tensor, Tensor]:
    return like.new_tensor(getattr(cfg, f"{name}_gain_low")), like.new_tensor(getattr(cfg, f"{name}_gain_high"))


def _middle_gains(cfg: LeeGainsCfg, vehicle: Vehicle, gravity: float) -> LeeGains:
    empty = torch.zeros_like(vehicle.com)
    gains = LeeGains(
        position=empty,
        velocity=empty,
        attitude=empty,
        rate=empty,
        mass=vehicle.mass,
        inertia=vehicle.inertia,
        gravity=gravity,
        max_yaw_rate=cfg.max_yaw_rate,
        max_inclination=cfg.max_inclination,
    )
    ranges = {name: _range(cfg, name, empty) for name in _GAINS}
    middle = {name: (0.5 * (low + high)).expand_as(empty).clone() for name, (low, high) in ranges.items()}
    return replace(gains, **middle)


def make_controller(cfg: ControllerCfg, vehicle: Vehicle, gravity: float) -> Controller:
    """Return a controller for a declared vehicle.

    Raises:
        ConfigError: If the law is unknown.
    """
    if cfg.law == "thrust":
        return ThrustController(vehicle, gravity)
    if cfg.law == "rotor_speed":
        return RotorSpeedController(vehicle)
    if cfg.law in LAWS:
        return LeeController(cfg, vehicle, gravity)
    known = ", ".join(("thrust", "rotor_speed", *LAWS))
    raise ConfigError(f"ControllerCfg.law = {cfg.law!r}: unknown. Known: {known}")
