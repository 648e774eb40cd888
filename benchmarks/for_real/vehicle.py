"""The hidden vehicle: its link, its sensors, and the log that its owner flies, all by Betaflight in the loop.

Letters: E environments, F flights, T rows of a log.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.changes import Changes
from aerial_gym.firmware.betaflight.environment import PositionPilot
from aerial_gym.firmware.environment import FirmwareEnv
from aerial_gym.interop import action_tensor, usual_settings
from aerial_gym.task import Task, task_registry
from benchmarks.undeclared.trajectories import Reference, plan_flight

FOLDER = Path(__file__).parent
TASK, VEHICLE = str(FOLDER / "task.yaml"), str(FOLDER / "hidden_vehicle.yaml")
LATENCY_S, JITTER_S = 0.035, 0.003  # From the stamp of a command to its use; standard deviation of its arrival
NOISE = {"position": 0.01, "lin_vel": 0.05, "attitude": 0.01, "ang_vel": 0.02}  # Of one sample [m, m/s, rad, rad/s]
PARTS = (
    "delay",
    "vehicle",
    "noise",
)  # What distinguishes the hidden vehicle from the robot file; delay with its jitter
FORCE_NOISE = 0.2  # Of the accelerometer [m/s²]
ENTRIES = dict(zip(range(4), NOISE.values(), strict=True))  # Noise by the number of the observation in task.yaml
FAMILIES = ("hover", "vertical", "yaw_turn", "rate_steps")  # Parts of the log
FLIGHT_S, SETTLE_S, PAUSE_S = 24.0, 10.0, 4.0  # Length of each part; hover before it; time between two parts [s]
ROWS_EVERY = 2  # Physics steps of 1 ms between two rows of the log


class LinkFirmwareEnv(FirmwareEnv):
    """Environments whose commands come over a link: each late by the latency and a uniform delay, in order."""

    def __init__(self, *, latency: float, jitter: float, **options: Any) -> None:
        super().__init__(**options)
        self._latency, self._width = latency, 12.0**0.5 * jitter
        self._random_link = torch.Generator().manual_seed(options["seed"])
        self._held, self._now = torch.zeros(self.num_envs, 4), 0
        self._sent: list[tuple[Tensor, Tensor]] = []  # Physics step of the use, (E,), and command (E, 4)
        self.on_physics_step: Callable[[int], None] | None = None

    def step(self, actions: Any, env_actions: Any = None) -> None:
        """Send thrust (0 is hover) and body rates [rad/s], (E, 4), and fly for one environment step."""
        del env_actions  # no obstacles
        manager, dt = self.robot_manager, self.sim_cfg.dt
        manager.act(action_tensor(actions, self.device))
        stored = manager.tensors.actions
        command = stored.clone()
        late = self._latency + self._width * torch.rand(self.num_envs, generator=self._random_link)
        due = self._now + (late / dt).round().long()
        if self._sent:
            due = torch.maximum(due, self._sent[-1][0] + 1)
        self._sent.append((due, command))
        for _ in range(self.cfg.physics_steps_per_env_step):
            for due, sent in self._sent:
                self._held = torch.where((due == self._now).unsqueeze(-1), sent, self._held)
            self.vehicle.channels(self._held.nan_to_num(), self.group.requests["channels"])
            stored.copy_(self.vehicle.speeds(self._fly_firmware()))
            self.fly(1)
            self._imu.measure()
            self._now += 1
            if self.on_physics_step is not None:
                self.on_physics_step(self._now)
        self._sent = [each for each in self._sent if (each[0] >= self._now).any()]
        stored.copy_(command)
        self.collide()
        if self.group.ended:
            self.gtd["crashes"][list(self.group.ended)] = True
        manager.refresh(self.dt)
        self.imus.measure()

    def reset(self, mask: Tensor | None = None, **options: Any) -> None:
        """Reset environments, whose link is then empty and holds hover."""
        super().reset(mask, **options)
        fresh = self.random.mask
        self._held[fresh] = 0.0
        for due, _ in self._sent:
            due[fresh] = -1

    @property
    def last_use(self) -> Tensor:
        """Physics step in which the last command sent takes effect, (E,)."""
        return self._sent[-1][0]


@usual_settings
def make_hidden_task(num_envs: int, *, seed: int, parts: Collection[str] = PARTS) -> Task:
    """Return the task on the hidden vehicle, or on one that has only some of its parts."""
    noise = ENTRIES if "noise" in parts else {}
    changes = Changes([f"task.observations.policy.{i}.noise_std={std}" for i, std in noise.items()])
    vehicle = VEHICLE if "vehicle" in parts else None
    cfg, robot, env, sim, law = task_registry.configurations(TASK, changes, num_envs=num_envs, robot=vehicle)
    changes.finish()
    latency, jitter = (LATENCY_S, JITTER_S) if "delay" in parts else (0.0, 0.0)
    flown = LinkFirmwareEnv(
        latency=latency, jitter=jitter, controller=law, sim=sim, robot=robot, env=env, num_envs=num_envs,
        device=torch.device("cpu"), seed=seed, randomize=cfg.randomize,
    )  # fmt: skip
    return Task(cfg, flown, capture=False)


@dataclass
class _Recorder:
    """Rows of the log, every ``ROWS_EVERY`` physics steps."""

    env: LinkFirmwareEnv
    names = ("robot_position", "robot_orientation", "robot_linvel")

    def __post_init__(self) -> None:
        self.rows: list[list[Tensor]] = []

    def __call__(self, step: int) -> None:
        if step % ROWS_EVERY == 0:
            env = self.env
            states = [env.gtd[name].clone() for name in self.names]
            speeds = [
                env.gtd["rotor_speed"].reshape(env.num_envs, -1).clone(),
                env.robot_manager.tensors.actions.clone(),
            ]
            self.rows.append([*states, env._measured.clone(), *speeds])


@usual_settings
@torch.no_grad()
def fly_log(path: Path, *, seed: int, duration: float = FLIGHT_S) -> None:
    """Fly hover, climbs, a yaw turn and rate steps on the hidden vehicle under a position controller; write one CSV file."""
    with make_hidden_task(len(FAMILIES), seed=seed) as task:
        env = task.env
        assert isinstance(env, LinkFirmwareEnv)
        env.reset()
        env.on_physics_step = recorder = _Recorder(env)
        physics = round(1.0 / env.sim_cfg.dt)
        references = [_reference(name, physics, seed + k, duration) for k, name in enumerate(FAMILIES)]
        pilot = PositionPilot(env)
        steps, ratio = round((SETTLE_S + duration) / env.dt), env.cfg.physics_steps_per_env_step
        late, sent = round(LATENCY_S * physics), []
        for step in range(steps):
            row = [min(step * ratio, len(one.yaw) - 1) for one in references]
            goal = [(*one.position[k], one.yaw[k]) for one, k in zip(references, row, strict=True)]
            excite = torch.tensor(np.array([one.excite[k] for one, k in zip(references, row, strict=True)])).float()
            command = pilot.action(torch.tensor(np.array(goal)).float())
            command += torch.cat((excite[:, 3:] / 9.81, excite[:, :3]), dim=-1)
            env.step(command)
            sent.append((env.last_use - late, command.clone()))
        _write_log(path, recorder.rows, sent, physics, np.random.default_rng(seed))


def _reference(family: str, rate: int, seed: int, duration: float) -> Reference:
    rng = np.random.default_rng(seed)
    return plan_flight(family, duration=duration, rate=rate, settle=SETTLE_S, rng=rng, lowest=0.0)


HEADER = ("t", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w", "v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z",
          "acc_x", "acc_y", "acc_z", *(f"{name}_{i}" for name in ("rotor", "cmd") for i in (1, 2, 3, 4)),
          "sp_omega_x", "sp_omega_y", "sp_omega_z", "sp_specific_thrust")  # fmt: skip


def _write_log(
    path: Path, rows: list[list[Tensor]], sent: list[tuple[Tensor, Tensor]], physics: int, rng: np.random.Generator
) -> None:
    """Write all flights after their settling, with noise, and the commands in the rows in which they arrive."""
    position, attitude, lin_vel, imu, rotor, asked = (torch.stack(each).numpy() for each in zip(*rows, strict=True))
    first, tables = round(SETTLE_S * physics / ROWS_EVERY), []
    for flight in range(position.shape[1]):
        count = len(position)
        time = np.arange(count)[:, None] * (ROWS_EVERY / physics) - SETTLE_S + flight * (FLIGHT_S + PAUSE_S)
        arrived = np.full((count, 4), np.nan)
        for stamp, command in sent:
            row = -(-int(stamp[flight]) // ROWS_EVERY)
            if row < count:
                thrust, *rate = command[flight].tolist()
                arrived[row] = (*rate, 9.81 * (1.0 + thrust))
        values = [time, _noisy(position[:, flight], NOISE["position"], rng)]
        values += [
            _with_turns(attitude[:, flight], NOISE["attitude"], rng),
            _noisy(lin_vel[:, flight], NOISE["lin_vel"], rng),
        ]
        values += [_noisy(imu[:, flight, 3:], NOISE["ang_vel"], rng), _noisy(imu[:, flight, :3], FORCE_NOISE, rng)]
        tables.append(np.hstack((*values, rotor[:, flight], asked[:, flight], arrived))[first:])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.concatenate(tables), fmt="%.8g", delimiter=",", header=",".join(HEADER), comments="")


def _noisy(values: np.ndarray, std: float, rng: np.random.Generator) -> np.ndarray:
    return values + std * rng.standard_normal(values.shape)


def _with_turns(quat: np.ndarray, std: float, rng: np.random.Generator) -> np.ndarray:
    """Return xyzw turned by small random angles."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(quat) * Rotation.from_rotvec(std * rng.standard_normal((len(quat), 3)))
    return turn.as_quat()
