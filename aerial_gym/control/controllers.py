"""Controllers: a law, gains per environment, and the allocation to the rotors. They fulfil ``physics.ControlLaw``.

Letters: E environments, R rotors.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.catalog import CONTROL_LAWS
from aerial_gym.control.gains import GAINS, bind_gains, gains_with_own_rows, make_gains
from aerial_gym.control.laws import LAWS
from aerial_gym.control.timing import has_memory
from aerial_gym.errors import ConfigError
from aerial_gym.lazy import ImportPath
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

WITH_MEMORY = {
    None: ImportPath("aerial_gym.control.cascade:CascadeController"),
    "px4": ImportPath("aerial_gym.control.px4.controller:Px4Controller"),
    "betaflight": ImportPath("aerial_gym.control.betaflight.controller:BetaflightController"),
    "mellinger": ImportPath("aerial_gym.control.crazyflie.controller:MellingerController"),
    "crazyflie_pid": ImportPath("aerial_gym.control.crazyflie.controller:PidController"),
    "crazyflie_lee": ImportPath("aerial_gym.control.crazyflie.controller:CrazyflieLeeController"),
    "brescianini": ImportPath("aerial_gym.control.crazyflie.controller:BrescianiniController"),
}
"""Controllers with rates or memory, by the field of ``ControllerCfg`` with their autopilot's parameters; imported at first
use."""

OF_PX4 = ("position", "velocity", "attitude", "rates")  # Laws of PX4's cascade
__path__: list[str] = []  # scripts of another simulator import modules below this name: aerial_gym.compat.modules


class Controller(Protocol):
    """Interface of a controller."""

    action_names: tuple[str, ...]  # Meaning and unit of each entry of the action

    @property
    def gains_by_name(self) -> Mapping[str, Tensor]:
        """Gains by their names in ``randomize:`` (``gains.NAME``), (E, 3); a controller with gains has ``own_gains`` too."""
        ...

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return commanded rotor speeds [rad/s], (E, R)."""
        ...


class ThrustController:
    """``no_control``: the action is the thrust of each rotor [N], clamped to its limits."""

    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})  # It has none

    def __init__(self, vehicle: Vehicle, gravity: float, control: ControlCfg) -> None:
        """Compute the allocation from the declared vehicle, gravity [m/s²] and robot settings."""
        self.action_names = tuple(f"thrust {i + 1} [N]" for i in range(vehicle.num_rotors))
        self.allocation = Allocation(vehicle, gravity, effectiveness=control.effectiveness)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the rotor speeds for the clamped thrusts."""
        return self.allocation.speed(action)


class RotorSpeedController:
    """``rotor_speed_control``: the action is the speed of each rotor [rad/s], in force mode its thrust [N], within limits."""

    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})  # It has none

    def __init__(self, vehicle: Vehicle) -> None:
        """Read the speed limits of the declared vehicle."""
        linear = (vehicle.thrust_map[0, :, 2] == 0.0).tolist()  # in force mode the state is the thrust
        force = [each and "force" in vehicle.traits for each in linear]
        self.action_names = tuple(f"thrust {i} [N]" if f else f"speed {i} [rad/s]" for i, f in enumerate(force, 1))
        self._vehicle = vehicle

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the clamped action."""
        return torch.clamp(action, self._vehicle.speed_low, self._vehicle.speed_high)


class LeeController:
    """A geometric law with its gains."""

    def __init__(
        self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float | None, control: ControlCfg
    ) -> None:
        """Derive the gains from configuration, declared vehicle, gravity [m/s²], time step [s] and robot settings."""
        law = LAWS[cfg.law]
        self.action_names, self._law = law.action, law
        declared = vehicle.to_device("cpu")  # a GPU loads a kernel for each of many small operations
        allocation = Allocation(declared, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        if law.lateral and not bool((allocation.controllable_share_of_axes > 0.999).all()):
            raise ConfigError(
                f"law {cfg.law!r}: pushes sideways without leaning, and the rotors of this vehicle do not. Take "
                "lee_position_control, or a robot with rotors that point in several directions (aerial-gym robot check: rank 6)"
            )
        gains = make_gains(cfg, control, declared, allocation, gravity=gravity, dt=dt)
        self.allocation, self.gains = allocation.bind_vehicle(vehicle), bind_gains(gains, vehicle)

    @property
    def gains_by_name(self) -> dict[str, Tensor]:
        """All gains of the law."""
        return {name: getattr(self.gains, name) for name in GAINS}

    def own_gains(self) -> None:
        """Give each environment its own writable rows (E, 3) in ``gains``; call it before a backend takes the controller."""
        self.gains = gains_with_own_rows(self.gains)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the speeds that give the wrench of the law, within the rotors' limits."""
        return self.allocation.speed_for_wrench(self._law.wrench(state, action, self.gains))


def make_controller(
    cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float | None = None, control: ControlCfg | None = None
) -> Controller:
    """Return a controller for a declared vehicle.

    Args:
        gravity: Downward acceleration of free fall [m/s²].
        dt: Time step of the law [s]; needed to derive gains of geometric laws.
        control: Control settings of the robot file (``RobotCfg.control``).

    Raises:
        ConfigError: If the law is unknown, needs a weight, or needs a time step to derive gains.
    """
    control = ControlCfg() if control is None else control
    if cfg.law == "thrust":
        return ThrustController(vehicle, gravity, control)
    if cfg.law == "rotor_speed":
        return RotorSpeedController(vehicle)
    if cfg.law in CONTROL_LAWS:
        return CONTROL_LAWS.get(cfg.law)(cfg, vehicle, gravity, dt=_require_time_step(cfg, dt), control=control)
    if cfg.law in LAWS and gravity == 0.0:
        raise ConfigError(
            f"gravity = {gravity!r}: the law {cfg.law!r} needs a weight. Without gravity use no_control or "
            "rotor_speed_control"
        )
    if cfg.px4 is not None and cfg.law not in OF_PX4:
        raise ConfigError(f"law {cfg.law!r}: not in PX4's cascade. Take one of {', '.join(OF_PX4)}")
    if cfg.law in LAWS and LAWS[cfg.law].lateral and has_memory(cfg):
        raise ConfigError(
            f"law {cfg.law!r}: runs at every physics step without a rate loop. Remove rates, delays and the loop"
        )
    if cfg.law in LAWS and not has_memory(cfg):
        return LeeController(cfg, vehicle, gravity, dt=dt, control=control)
    if cfg.law in LAWS:
        kind = WITH_MEMORY[cfg.autopilot].load()
        return kind(cfg, vehicle, gravity, dt=_require_time_step(cfg, dt), control=control)
    known = ", ".join(("thrust", "rotor_speed", *LAWS, *CONTROL_LAWS.names()))
    raise ConfigError(f"ControllerCfg.law = {cfg.law!r}: unknown. Known: {known}")


def _require_time_step(cfg: ControllerCfg, dt: float | None) -> float:
    """Return the time step [s]; refuse a missing one."""
    if dt is None:
        raise ConfigError(f"law {cfg.law!r}: a controller with rates or memory needs a time step. Give dt [s]")
    return dt
