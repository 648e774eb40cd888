"""Comparison of a firmware with the controller here that follows it, in flight: rotor commands for the same sensors.

The firmware flies, and the controller computes beside it. Letters: E environments, R rotors, U entries of an action.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.firmware.environment import FirmwareEnv
from aerial_gym.interop import usual_settings
from aerial_gym.physics.law_memory import fresh_law_memory

START_S = 0.1  # Left out [s]: differences of the firmware start from zero


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Differences of rotor speeds, as shares of the rotors' range."""

    setting: str
    rms: float
    largest: float
    runs: int  # Compared runs of the loop, of all environments


class TwinObserver:
    """Computes the rotor speeds of the controller here at each exchange of a simulation with its firmware."""

    def __init__(self, env: FirmwareEnv) -> None:
        """Take a simulation after its reset."""
        self._env, self.commands = env, list[Tensor]()  # Controller and firmware, (2, E, R) for each exchange
        self._memory = fresh_law_memory(env.twin.needs, env.num_envs, env.gtd["robot_position"])
        env.observer = self

    def __call__(self, action: Tensor, speeds: Tensor) -> None:
        """Take the action (E, U), and the firmware's rotor speeds [rad/s], (E, R)."""
        state = replace(self._env.robot_manager.tensors.state, ang_vel=self._env.firmware_rates())
        own, self._memory = self._env.twin.command(state, action, self._memory)
        self.commands.append(torch.stack((own, speeds)))


@usual_settings
@torch.no_grad()
def compare_flight(env: FirmwareEnv, setting: str, actions: Iterable[Tensor]) -> Difference:
    """Return the difference over a flight with these actions (E, U), one for each environment step; closes the simulation."""

    def stop_turning(
        mask: Tensor,
    ) -> None:  # the firmware's filters start from zero, those here from the first measurement
        for name in ("robot_angvel", "robot_body_angvel"):
            env.gtd[name][mask] = 0.0

    try:
        env.reset(place=stop_turning)
        observer, vehicle = TwinObserver(env), env.robot_manager.declared
        for action in actions:
            env.step(action)
    finally:
        env.close()
    own, speeds = torch.stack(observer.commands[round(START_S / env.sim_cfg.dt) :] or [torch.zeros(2, 0, 0)], dim=1)
    if not own.numel():
        raise ConfigError(f"the comparison must be longer than {START_S:g} s. Give a longer duration")
    difference = (own - speeds) / (vehicle.speed_high - vehicle.speed_low)
    return Difference(
        setting=setting, rms=float(difference.square().mean().sqrt()), largest=float(difference.abs().max()),
        runs=own.shape[0] * own.shape[1],
    )  # fmt: skip
