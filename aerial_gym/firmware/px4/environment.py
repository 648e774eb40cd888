"""A batch of environments whose vehicles are flown by PX4, one instance for each environment.

``[IMU and other sensors -> PX4 -> rotors -> effects -> integrate] x K -> collide``. The pilot is on PX4's own links: a ground
station, or MAVSDK. Not tested with PX4 itself.
Letters: E environments, R rotors, K physics steps.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NoReturn

import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS
from aerial_gym.control.gains import select_autopilot
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError
from aerial_gym.firmware.imu import make_flight_imu
from aerial_gym.firmware.px4.links import PORT, Px4Links
from aerial_gym.firmware.px4.parameters import px4_parameters
from aerial_gym.firmware.px4.readings import Home, Motion, Readings

PERIOD_S = 0.004  # Time between two exchanges [s]: PX4's IMU_INTEG_RATE of 250 Hz in simulation
GPS_PERIOD_S = 0.1
START_US = 1_000_000  # Time of the first message [us]; PX4 takes 0 for no time


class Px4Env(EnvManager):
    """Environments flown by PX4, which gets no actions from here."""

    def __init__(self, *, port: int = PORT, home: Home | None = None, period: float = PERIOD_S, **options: Any) -> None:
        """Build the simulation, and listen for the instances. Arguments not named here are those of ``EnvManager``.

        Raises:
            ConfigError: If PX4 cannot fly the vehicle.
            CapabilityError: If a port is taken, or the device is not the CPU.
        """
        sim, env = options["sim"], options["env"]
        steps = max(1, round(sim.dt * env.physics_steps_per_env_step / period))
        options["sim"] = replace(sim, dt=period)
        options["env"] = replace(env, physics_steps_per_env_step=steps)
        super().__init__(controller=CONTROLLERS.get("rotor_speed_control"), **options)
        if self.device.type != "cpu":
            raise CapabilityError(f"sitl: PX4 exchanges messages on the CPU, not on {self.device}. Take device cpu")
        declared = self.robot_manager.declared
        own = select_autopilot(CONTROLLERS.get("px4_position_control"), options["robot"].control)
        self.parameters = px4_parameters(declared, own, sim.gravity)
        self._low, self._span = declared.speed_low[0], (declared.speed_high - declared.speed_low)[0]
        self._imu, self._measured = make_flight_imu(self, dt=period)
        self._readings, self._time_us, self._flown = Readings(home or Home()), START_US, 0
        self.links = Px4Links(self.num_envs, port=port)

    def connect(self, seconds: float) -> None:
        """Wait for all instances; see ``Px4Links.accept``."""
        self.links.accept(seconds)

    def step(self, actions: object = None, env_actions: object = None) -> None:
        """Fly one environment step; actions are refused."""
        if actions is not None or env_actions is not None:
            raise CapabilityError("sitl px4: PX4 takes no actions from here. Command it by a ground station or MAVSDK")
        manager, motors = self.robot_manager, self._low.numel()
        stored = manager.tensors.actions
        for _ in range(self.cfg.physics_steps_per_env_step):
            controls = torch.from_numpy(self._exchange()[:, :motors])
            stored.copy_(self._low + self._span * controls.clamp(0.0, 1.0))
            self.fly(1)
            self._imu.measure()
        self.collide()
        if self.links.ended:
            self.gtd["crashes"][list(self.links.ended)] = True
        manager.refresh(self.dt)
        self.imus.measure()

    def _exchange(self) -> Any:
        """Send the sensors of this instant, and return the motor commands, (E, 16)."""
        self._time_us += round(1e6 * self.sim_cfg.dt)
        keys = ("robot_position", "robot_orientation", "robot_linvel")
        position, attitude, lin_vel = (self.gtd[key].double().numpy() for key in keys)
        measured = self._measured.double().numpy()
        motion = Motion(
            position=position, attitude=attitude, lin_vel=lin_vel, force=measured[:, :3], ang_vel=measured[:, 3:]
        )
        messages, now, readings = [], self._time_us, self._readings
        if self._flown % round(GPS_PERIOD_S / self.sim_cfg.dt) == 0:
            messages.append(readings.positions(now, motion))
        if any(link.wants_states for link in self.links.links.values()):
            messages.append(readings.states(now, motion))
        self._flown += 1
        return self.links.exchange(now, *messages, readings.sensors(now, motion))

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
        self._imu.reset(self.random.mask)
        self._imu.measure()

    def _place_level(self, mask: Tensor) -> None:
        """Put vehicles in ``mask``, bool (E,), level and at rest above the origin."""
        self.gtd["robot_position"][mask, :2] = 0.0
        self.gtd["robot_orientation"][mask] = torch.tensor([0.0, 0.0, 0.0, 1.0])
        for name in ("robot_linvel", "robot_angvel", "robot_body_linvel", "robot_body_angvel"):
            self.gtd[name][mask] = 0.0

    def state_tensors(self) -> NoReturn:
        """Refuse: the memory of PX4 cannot be saved."""
        raise CapabilityError("save_state: PX4's memory cannot be saved. Fly without firmware")

    def close(self) -> None:
        """Close the connections, and release device memory."""
        if "links" in vars(self):
            self.links.close()
        super().close()
