"""Exact flights for tests: the rotor speeds that a smooth path needs, from differential flatness. Independent of the
simulator: no equation of motion is integrated. Letters: T rows, R rotors."""

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, RotationSpline

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import BodyCfg, CollisionCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg
from aerial_gym.sim2real import LogMapping, read_flight_log
from aerial_gym.sim2real.logs.flights import Flight, complete_flight, load_flights
from aerial_gym.sim2real.logs.signals import log_at_equal_steps
from aerial_gym.sim2real.predict.channels import Channel, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, 9.81])
ROBOT = RobotCfg(
    summary="a made-up quadrotor",
    body=BodyCfg(mass=0.6, inertia=((2e-3, 0.0, 0.0), (0.0, 2.4e-3, 0.0), (0.0, 0.0, 4e-3)), source="invented"),
    rotor=RotorCfg(
        thrust_map=(0.0, 0.0, 1.2e-6), torque_ratio=0.015, time_constant_up=0.04, time_constant_down=0.04,
        thrust_range=(0.05, 5.0), source="invented",
    ),
    mounts=MountsCfg(
        layout=tuple(
            MountCfg(position=(x, y, 0.01), spin=spin)
            for x, y, spin in ((0.1, -0.1, 1), (-0.1, -0.1, -1), (-0.1, 0.1, 1), (0.1, 0.1, -1))
        ),
        source="invented",
    ),
    collision=CollisionCfg(source="none"),
)  # fmt: skip
COLUMNS = (
    *("t", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w", "v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z"),
    *("acc_x", "acc_y", "acc_z", "rotor_1", "rotor_2", "rotor_3", "rotor_4"),
)


def sines(time: Array, rng: np.random.Generator, sizes: tuple[float, ...], *, slow: float) -> tuple[Array, ...]:
    """Return sums of sines (T, columns) with rms about ``sizes`` and their first two derivatives."""
    frequency = 2.0 * np.pi * slow * rng.uniform(0.5, 2.5, (len(sizes), 5))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, frequency.shape), np.array(sizes)[:, None] / np.sqrt(2.5)
    angle = frequency * time[:, None, None] + phase
    waves = (np.sin(angle), frequency * np.cos(angle), -(frequency**2) * np.sin(angle))
    return tuple((size * wave).sum(axis=2) for wave in waves)


def flight(
    seed: int, *, drag: float = 0.0, wind: tuple[float, float, float] = (0.0, 0.0, 0.0), cubic: float = 0.0,
    spring: float = 0.0, thrust_scale: float = 1.0, fading: float = 0.0, outside: Array | float = 0.0,
    noise: float = 0.0, seconds: float = 12.0, rate: float = 200.0,
) -> pd.DataFrame:  # fmt: skip
    """Return the log of a flight with linear drag [N s/m] along all axes through a wind [m/s], world. In the columns of
    the contract, without commands. ``cubic`` is a drag ``-c |v|² v`` [N s³/m³], ``spring`` a pull ``-k x`` along the
    world's x [N/m], ``fading`` the share of their thrust that rotors lose evenly up to the end of the flight: no effect
    has them. ``outside`` is any other force, world, (T, 3) [N]. ``noise`` scales: accelerometer 0.05 m/s², gyro 0.003
    rad/s, rotors 0.3 %."""
    rng, body = np.random.default_rng(seed), ROBOT.body
    time = np.arange(round(seconds * rate)) / rate
    place, velocity, acceleration = sines(time, rng, (0.7, 0.7, 0.4), slow=0.2)
    heading = 1.5 * time * rng.choice((-0.3, 0.3)) + sines(time, rng, (0.5,), slow=0.1)[0][:, 0]
    # What the rotors give, world: drag is isotropic.
    force = body.mass * (acceleration + GRAVITY) + drag * (velocity - wind)
    force += cubic * (velocity**2).sum(axis=1, keepdims=True) * velocity
    force[:, 0] += spring * place[:, 0]
    force -= outside
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    ahead = np.stack((np.cos(heading), np.sin(heading), np.zeros_like(heading)), axis=1)
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    attitude = Rotation.from_matrix(np.stack((np.cross(left, up), left, up), axis=2))
    curve = RotationSpline(time, attitude)
    rate_body, turning = curve(time, 1), curve(time, 2)
    inertia = np.array(body.inertia)
    torque = turning @ inertia + np.cross(rate_body, rate_body @ inertia)
    lift = np.linalg.norm(force, axis=1)
    hubs = np.array([mount.position for mount in ROBOT.mounts.layout])
    spin = np.array([mount.spin for mount in ROBOT.mounts.layout])
    mix = np.stack((np.ones(4), hubs[:, 1], -hubs[:, 0], -spin * 0.015))
    thrust = np.linalg.solve(mix, np.column_stack((lift, torque)).T).T / thrust_scale
    thrust /= 1.0 - fading * time[:, None] / seconds
    speed = np.sqrt(thrust / 1.2e-6)
    specific = attitude.apply(acceleration + GRAVITY, inverse=True)
    specific += noise * 0.05 * rng.standard_normal(specific.shape)
    rate_body = rate_body + noise * 0.003 * rng.standard_normal(rate_body.shape)
    speed = speed * (1.0 + noise * 0.003 * rng.standard_normal(speed.shape))
    table = np.column_stack(
        (time, place + np.array([0.0, 0.0, 5.0]), attitude.as_quat(), velocity, rate_body, specific, speed)
    )
    return pd.DataFrame(table, columns=list(COLUMNS))


def load_flight(path: str | Path, robot: RobotCfg, *, mapping: LogMapping | None, bandwidth: float) -> Flight:
    return load_flights([path], robot, mapping=mapping, bandwidth=bandwidth)[0]


def write(table: pd.DataFrame, path: Path) -> Path:
    """Write a log of numbers with all their digits, in less than half of the time of ``DataFrame.to_csv``."""
    rows = (",".join(map(repr, row)) for row in table.to_numpy(dtype=float).tolist())
    path.write_text("\n".join((",".join(table.columns), *rows, "")).replace("nan", ""), encoding="utf-8")
    return path


def uniform_flight(table: pd.DataFrame, folder: Path, name: str = "log") -> Flight:
    """Return a flight with all rows of its log, from a file that is written for it."""
    return complete_flight(log_at_equal_steps(read_flight_log(write(table, folder / f"{name}.csv"))))


def load_tables(folder: Path, tables: Iterable[pd.DataFrame], robot: RobotCfg = ROBOT) -> list[Flight]:
    """Return the flights f0, f1, ... of logs, from files that are written for them."""
    paths = [write(table, folder / f"f{n}.csv") for n, table in enumerate(tables)]
    return load_flights(paths, robot, mapping=None, bandwidth=10.0)


def verdict_of_command(folder: Path, robot: RobotCfg, tables: Iterable[pd.DataFrame], *options: str) -> dict[str, Any]:
    """Run the command ``close-loop`` on logs, of which the last one is the test flight; return its verdict."""
    (folder / "robot.yaml").write_text(dump_yaml(robot), encoding="utf-8")
    *train, test = [str(write(table, folder / f"f{n}.csv")) for n, table in enumerate(tables)]
    given = ["--robot", str(folder / "robot.yaml"), "--train", *train, "--test", test, "--out", str(folder / "out")]
    assert main(["close-loop", *given, *options]) == 0
    return json.loads((folder / "out" / "verdict.json").read_text())


def make_predictor(flights: Sequence[Flight], robot: RobotCfg = ROBOT, **options: Any) -> Predictor:
    """Return a predictor of flights, by default of all their channels up to 10 Hz with the usual tolerances."""
    defaults = {"bandwidth": 10.0, "channels": find_channels(flights), "tolerances": Tolerances()}
    return Predictor(robot, flights, **defaults | options)


class PredictorStub(Predictor):
    """Predictor of a model that a test writes down, at 30 Hz; by default it has neither flights nor rows."""

    def __init__(
        self, predict: Callable[[ModelParams], list[Array]] | None = None, measured: Sequence[Array] = (), *,
        robot: RobotCfg = ROBOT, flights: Sequence[Flight] = (), channels: Sequence[Channel] = (),
        bandwidth: float = 10.0,
    ) -> None:  # fmt: skip
        self.robot, self.flights, self.channels, self.bandwidth = robot, tuple(flights), tuple(channels), bandwidth
        self.measured, self.times = list(measured), [np.arange(len(rows)) / 30.0 for rows in measured]
        self.tolerances, self.model, self.calls, self._parts = Tolerances(), predict, 0, []

    def predict(self, params: ModelParams) -> list[Array]:
        self.calls += 1
        return self.model(params)
