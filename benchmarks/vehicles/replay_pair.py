"""Wakes of the simulator against a measured pair: two Crazyflies that pass over each other (Neural-Swarm).

    python -m benchmarks.vehicles.replay_pair --data DATA [--json]

Every row of the logs is an environment with both vehicles at their measured places, under the lift of their rotors; the pass
of ``EnvManager.fly`` computes their wakes. The parameters of each law are fitted to the first half of one vehicle. Rows of the
table are its second half, the vehicle above, which feels nothing, and the first one with the clock of the other shifted. There
the wake acts at wrong times and should not help.
The error is that of the specific force along body z, below 8 Hz, where the other vehicle is above and within 0.3 m beside.
The thrust scale of each vehicle comes from rows without one there. DATA has a folder ``neural_swarm`` (docs/results/wakes.md).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder
from aerial_gym.config.console import json_line
from aerial_gym.math.quaternion import world_up
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real import find_mapping, read_flight_log

Array = NDArray[np.float64]
VEHICLES = ("cf50.csv#2", "cf51.csv")  # The first flight of cf50 ends before the passes
RATE = 100.0  # Rows per second
BANDWIDTH = 8.0  # [Hz]
LAG = 0.06  # Time constant of the rotors [s], as found for these flights
SHIFT = 0.25  # Change of a clock for the control [s]: longer than a pass through the wake
NEAR = 0.3  # Horizontal distance within which the other vehicle counts [m]
LAWS = {"downwash": [0.05, 0.1], "downwash_jet": [0.01, 0.2], "downwash_core": [0.05, 0.1, 2.0]}
"""Laws, and starts of their fits."""


@dataclass(frozen=True)
class Pair:
    """Both vehicles on one time axis, (T, 2, ...)."""

    position: Array  # [m]
    attitude: Array
    command: Array  # Rotor speeds after the lag [rad/s]
    force: Array  # Specific force along body z [m/s²], (T, 2)

    def shift(self, vehicle: int, seconds: float) -> "Pair":
        """Return the pair with one vehicle's rows moved in time, around the ends."""
        rows = round(seconds * RATE)
        moved = {name: values.copy() for name, values in vars(self).items()}
        for values in moved.values():
            values[:, vehicle] = np.roll(values[:, vehicle], rows, axis=0)
        return Pair(**moved)


def read_pair(folder: Path) -> Pair:
    """Return the logs of both vehicles on the clock that they share."""
    logs = [read_flight_log(folder / f"swap_ss_00_{name}", mapping=find_mapping("neural_swarm")) for name in VEHICLES]
    time = np.arange(max(log.time[0] for log in logs), min(log.time[-1] for log in logs), 1.0 / RATE)

    def rows(name: str) -> Array:
        parts = []
        for log in logs:
            values = getattr(log, name)
            assert values is not None
            parts.append(np.stack([np.interp(time, log.time, column) for column in values.T], axis=1))
        return np.stack(parts, axis=1)

    attitude = rows("attitude")
    command = rows("rotor_command")
    lagged = command.copy()
    for row in range(1, len(time)):
        lagged[row] = command[row] + (lagged[row - 1] - command[row]) * np.exp(-1.0 / (RATE * LAG))
    return Pair(
        position=rows("position"), attitude=attitude / np.linalg.norm(attitude, axis=-1, keepdims=True), command=lagged,
        force=rows("specific_force")[..., 2],
    )  # fmt: skip


def low_pass(values: Array) -> Array:
    """Return the part of rows below the bandwidth, without delay."""
    return sosfiltfilt(butter(2, BANDWIDTH, fs=RATE, output="sos"), values, axis=0)


class WakeReplay:
    """The simulator at every row of a pair, under one law."""

    def __init__(self, law: str, pair: Pair) -> None:
        """Build an environment for each row."""
        effect = EFFECTS.get(law)
        start = dict(zip((each.name for each in effect.parameters), LAWS[law], strict=True))
        robot = replace(ROBOTS.get("crazyflie_21"), effects={law: start})
        self.env: EnvManager = SimBuilder().build_env(
            sim_name="base_sim", env_name=ENVIRONMENTS.get("empty_env"), controller_name="lee_velocity_control",
            robots=[{"name": robot, "count": 2, "kind": "crazyflie"}], num_envs=len(pair.force), device="cpu", seed=0,
        )  # fmt: skip
        self._params = self.env.gtd[f"effect_{law}"]
        self._vehicle = self.env.robot_manager.declared
        away = pair.position[:, ::-1] - pair.position
        beside = np.linalg.norm(away[..., :2], axis=-1)
        self.below = (away[..., 2] > 0.0) & (beside < NEAR)  # (T, 2)
        speed = torch.from_numpy(pair.command).float()
        thrust = rotor_thrust(self._vehicle, speed.flatten(0, 1)).sum(-1).view(-1, 2).double().numpy()
        weight = float(self._vehicle.mass[0])
        predicted, measured = low_pass(thrust / weight), low_pass(pair.force)
        alone = beside > NEAR
        scale = np.array([
            (predicted[rows, v] @ measured[rows, v]) / (predicted[rows, v] @ predicted[rows, v])
            for v, rows in enumerate(alone.T)
        ])  # fmt: skip
        self._error, self._weight = measured - scale * predicted, weight
        for key, values in (
            ("robot_position", pair.position),
            ("robot_orientation", pair.attitude),
            ("rotor_speed", pair.command * np.sqrt(scale)[:, None]),
        ):
            self.env.gtd[key].copy_(torch.from_numpy(values))
        self._up = world_up(torch.from_numpy(pair.attitude).flatten(0, 1))[:, 2].view(-1, 2).numpy()

    def errors(self, params: list[float] | Array | None) -> Array:
        """Return measured less predicted specific force along body z [m/s²], (T, 2); without parameters there is no wake."""
        if params is None:
            return self._error
        self._params[..., :-1] = torch.tensor(np.asarray(params), dtype=torch.float32)
        vehicles = self.env.vehicles
        assert vehicles is not None
        vehicles.measure_wakes()
        force = self._params[..., -1].double().numpy()
        return self._error + low_pass(force * self._up / self._weight)

    def fit(self, law: str, rows: slice) -> Array:
        """Return the parameters that fit the first vehicle in some rows best."""
        below = self.below[rows, 0]
        bounds = np.array([(each.low, each.high) for each in EFFECTS.get(law).parameters]).T
        widths = (0.03, 0.1, 0.3)
        starts = [[LAWS[law][0], width, *LAWS[law][2:]] for width in widths]
        fits = [
            least_squares(
                lambda p: self.errors(p)[rows, 0][below], start, bounds=(bounds[0], bounds[1]), x_scale=start, diff_step=1e-2
            )
            for start in starts
        ]  # fmt: skip
        return min(fits, key=lambda each: each.cost).x


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, kw_only=True)
class PairReplay:
    """Compare the wakes of the simulator with a measured pair."""

    data: Path  # Folder of all measured flights
    json: bool = False  # Print one JSON object for each row

    def run(self) -> int:
        """Fit, compare and print; return the exit status."""
        pair = read_pair(self.data / "neural_swarm")
        middle = len(pair.force) // 2
        halves = {"first half": slice(0, middle), "second half": slice(middle, None)}
        for law in LAWS:
            replay = WakeReplay(law, pair)
            params = replay.fit(law, halves["first half"])
            names = [each.name for each in EFFECTS.get(law).parameters]
            fitted = {name: round(float(value), 4) for name, value in zip(names, params, strict=True)}
            below = replay.below[:, 0]
            cases = {
                "cf50 below, first half, fitted": (replay, 0, halves["first half"]),
                "cf50 below, second half": (replay, 0, halves["second half"]),
                "cf51 above": (replay, 1, slice(None)),
            }
            for seconds in (-SHIFT, SHIFT):
                shifted = WakeReplay(law, pair.shift(1, seconds))
                cases[f"cf50, clock of cf51 {seconds:+g} s"] = (shifted, 0, slice(None))
            for case, (replayed, vehicle, rows) in cases.items():
                before, after = (rms(replayed.errors(p)[rows, vehicle][below[rows]]) for p in (None, params))
                row = {"law": law, "case": case, "rows": int(below[rows].sum()), "fit": fitted}
                row |= {"before_m_s2": before, "after_m_s2": after}
                if self.json:
                    print(json_line(row))
                else:
                    print(f"{law:14} {case:31} {row['rows']:4} rows  {before:.3f} to {after:.3f} m/s²  {fitted}")
        return 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(PairReplay).run())
