"""A batch of environments whose vehicles are flown by PX4, one instance for each environment.

The pilot is on PX4's own links: a ground station, or MAVSDK. Not tested with PX4 itself.
Letters: E environments, R rotors.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS
from aerial_gym.control.gains import select_autopilot
from aerial_gym.errors import CapabilityError
from aerial_gym.firmware.environment import FirmwareEnv
from aerial_gym.firmware.px4.links import PORT, Px4Links
from aerial_gym.firmware.px4.parameters import px4_parameters
from aerial_gym.firmware.px4.readings import Home, Motion, Readings

PERIOD_S = 0.004  # Time between two exchanges [s]: PX4's IMU_INTEG_RATE of 250 Hz in simulation
GPS_PERIOD_S = 0.1
START_US = 1_000_000  # Time of the first message [us]; PX4 takes 0 for no time


class Px4Env(FirmwareEnv):
    """Environments flown by PX4, which gets no actions from here."""

    firmware = "PX4"

    def __init__(self, *, port: int = PORT, home: Home | None = None, period: float = PERIOD_S, **options: Any) -> None:
        """Build the simulation, and listen for the instances. Arguments not named here are those of ``FirmwareEnv``.

        Raises:
            ConfigError: If PX4 cannot fly the vehicle.
            CapabilityError: If a port is taken, or the device is not the CPU.
        """
        super().__init__(period=period, **options)
        declared = self.robot_manager.declared
        own = select_autopilot(CONTROLLERS.get("px4_position_control"), options["robot"].control)
        self.parameters = px4_parameters(declared, own, options["sim"].gravity)
        self._low, self._span = declared.speed_low[0], (declared.speed_high - declared.speed_low)[0]
        self._readings, self._time_us, self._flown = Readings(home or Home()), START_US, 0
        self.links = Px4Links(self.num_envs, port=port)
        self.ended, self.motors = self.links.ended, self.links.controls

    def connect(self, seconds: float) -> None:
        """Wait for all instances; see ``Px4Links.accept``."""
        self.links.accept(seconds)

    def step(self, actions: object = None, env_actions: object = None) -> None:
        """Fly one environment step; actions are refused."""
        if actions is not None or env_actions is not None:
            raise CapabilityError("sitl px4: PX4 takes no actions from here. Command it by a ground station or MAVSDK")
        super().step(None)

    def rotor_speeds(self) -> Tensor:
        """Send the sensors of this instant, and return the commanded rotor speeds [rad/s], (E, R)."""
        self._time_us += round(1e6 * self.sim_cfg.dt)
        keys = ("robot_position", "robot_orientation", "robot_linvel")
        position, attitude, lin_vel = (self.gtd[key].double().numpy() for key in keys)
        measured = self.imu_reading.double().numpy()
        motion = Motion(
            position=position, attitude=attitude, lin_vel=lin_vel, force=measured[:, :3], ang_vel=measured[:, 3:]
        )
        messages, now, readings = [], self._time_us, self._readings
        if self._flown % round(GPS_PERIOD_S / self.sim_cfg.dt) == 0:
            messages.append(readings.positions(now, motion))
        if any(link.wants_states for link in self.links.links.values()):
            messages.append(readings.states(now, motion))
        self._flown += 1
        controls = self.links.exchange(now, *messages, readings.sensors(now, motion))[:, : self._low.numel()]
        return self._low + self._span * torch.from_numpy(controls).clamp(0.0, 1.0)

    def reset(
        self, mask: Tensor | None = None, *, counted: bool = False, place: Callable[[Tensor], None] | None = None
    ) -> None:
        """Place the vehicles level on the ground, if there is one, before the first step only: PX4 cannot be reset.

        Raises:
            CapabilityError: After the first step.
        """
        if self._flown:
            raise CapabilityError("sitl px4: PX4 cannot be reset in flight. Start it and the simulation again")
        super().reset(mask, counted=counted, place=place or self._place_level)
        if self.cfg.ground_height is not None and place is None:
            self.gtd["robot_position"][:, 2] -= self.gtd["robot_clearance"]
            self._collision.measure()
        self._imu.measure()

    def _place_level(self, mask: Tensor) -> None:
        """Put vehicles in ``mask``, bool (E,), level and at rest above the origin."""
        self.gtd["robot_position"][mask, :2] = 0.0
        self.gtd["robot_orientation"][mask] = torch.tensor([0.0, 0.0, 0.0, 1.0])
        for name in ("robot_linvel", "robot_angvel", "robot_body_linvel", "robot_body_angvel"):
            self.gtd[name][mask] = 0.0

    def close_firmware(self) -> None:
        """Close the connections."""
        if "links" in vars(self):
            self.links.close()
