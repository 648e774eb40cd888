"""Does a vehicle that is tuned to a bandwidth and a damping fly with them, in environments of which each has its own lag?

    python -m benchmarks.control.tuned [ROBOT ...] [--attitude-hz 0.8] [--position-hz 0.12] [--damping 0.7] [--json]

A robot file as ``close-loop`` writes it (or a registered robot) is tuned by ``control.tuner`` with its lag and dead time, in
environments of which the first have less of both and the last more. Each is flown in float64 by the sampled controller: told
sines about the bandwidth, from whose answers follows where the gain is ``sqrt 1/2``; and let go beside hover, from whose decay
follow the poles. That is all of a flight: sampling, holding, lag, dead time, and the vehicle.
Letters: E environments, N samples.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, pi

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, LeeController, make_controller
from aerial_gym.control.tuner import Tuning, tune_attitude, tune_position
from aerial_gym.errors import AerialGymError
from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler
from aerial_gym.physics import (
    EFFECTS,
    BodyState,
    TorchBackend,
    Vehicle,
    build_model,
    state_at_rest,
    vehicle_from_config,
)
from aerial_gym.physics.model import robot_effects
from aerial_gym.physics.rotors import hover_speed
from aerial_gym.robots.catalog import robot_by_name

F64 = torch.float64
CPU = torch.device("cpu")
GRAVITY = 9.81

SPREAD = 0.2
"""Share by which the environments at both ends have another lag and dead time than the robot file."""

ABOUT = (0.9, 1.0, 1.1)
"""Frequencies of the sines, as shares of the bandwidth."""

PERIODS, LAST = 4, 1
"""Of the slowest sine, and how many of them at the end are looked at."""

SMALL = 1e-4
"""Of what is wanted, and of the distance from hover [rad] or [m]: small enough for 1e-8 of everything that is not linear."""

SAMPLES, SPAN = 60, 6.0
"""Of a decay, and its length in units of one over the frequency of the placed pair."""

HEARD = 1e-2
"""Of the loudest mode: how loud a mode must be at the start of the decay to be one of what was placed."""


@dataclass(frozen=True)
class Asked:
    """What the tuner is asked for."""

    attitude: float
    """Bandwidth [rad/s]."""

    position: float
    """Bandwidth [rad/s]."""

    damping: float
    """Of both."""


@dataclass(frozen=True)
class Flown:
    """What one loop was asked for, and what it flew with, (E,)."""

    loop: str
    asked: float
    """Bandwidth [rad/s]."""

    bandwidth: NDArray[np.float64]
    """[rad/s]."""

    damping: NDArray[np.float64]
    """Of the slowest pair of poles that was heard [-]."""


@dataclass(frozen=True)
class Tuned:
    """Vehicles, their dead time [s], (E,), and gains that belong to them."""

    vehicle: Vehicle
    delay: Tensor
    attitude: Tuning
    position: Tuning
    dt: float

    def law(self, name: str) -> LeeController:
        """Return the controller of that name with these gains."""
        law = make_controller(CONTROLLERS.get(name), self.vehicle, GRAVITY, dt=self.dt)
        assert isinstance(law, LeeController)
        inertia = self.vehicle.inertia.diagonal(dim1=1, dim2=2)
        law.gains = replace(
            law.gains,
            attitude=inertia * self.attitude.proportional,
            rate=inertia * self.attitude.derivative,
            position=self.position.proportional,
            velocity=self.position.derivative,
        )
        return law


def tuned(robot: RobotCfg, asked: Asked, *, num_envs: int, dt: float, spread: float = SPREAD) -> Tuned:
    """Return vehicles with a lag and a dead time of their own and the gains that the tuner gives each.

    There are ``num_envs`` different ones, in this order once for each of ``ABOUT``.
    """
    rows = num_envs * len(ABOUT)
    declared = vehicle_from_config(robot, num_envs=rows, dtype=F64)
    vehicle = build_model(declared, robot_effects(robot, num_envs=rows, device=CPU, dtype=F64)).vehicle
    share = torch.linspace(1.0 - spread, 1.0 + spread, num_envs, dtype=F64).repeat(len(ABOUT))
    up, down = (share.unsqueeze(-1) * lag for lag in (vehicle.time_constant_up, vehicle.time_constant_down))
    vehicle = replace(vehicle, time_constant_up=up, time_constant_down=down)
    delay = share * float(robot.effects.get("actuation_delay", {}).get("delay", 0.0))
    turn = tune_attitude(vehicle, bandwidth=asked.attitude, damping=asked.damping, delay=delay, dt=dt)
    move = tune_position(turn, bandwidth=asked.position, damping=asked.damping)
    return Tuned(vehicle, delay, turn, move, dt)


def fly(
    made: Tuned,
    name: str,
    wanted: Callable[[float], Tensor],
    start: BodyState,
    steps: int,
    seen: Callable[[BodyState], Tensor],
) -> Tensor:
    """Return what is seen after each step, (steps, E), of flights to actions that depend on time [s]."""
    late = (EFFECTS.get("actuation_delay"), made.delay.unsqueeze(-1))
    backend = TorchBackend()
    backend.allocate(build_model(made.vehicle, [late]), made.law(name), integrator="rk4")
    found = []
    for step in range(steps):
        backend.step(start, wanted(step * made.dt), made.dt, 1)
        found.append(seen(start))
    return torch.stack(found)


def hover(made: Tuned) -> BodyState:
    """Return all vehicles at hover at the origin."""
    vehicle = made.vehicle
    state = state_at_rest(vehicle.num_envs, vehicle.num_rotors, device=CPU, dtype=F64)
    state.rotor_speed.copy_(hover_speed(vehicle, GRAVITY))
    return state


@dataclass(frozen=True)
class Loop:
    """How one loop is told something, let go beside hover, and seen."""

    name: str
    controller: str
    entry: int
    """Of the action."""

    seen: Callable[[BodyState], Tensor]
    """What answers, (E,)."""


def _roll(state: BodyState) -> Tensor:
    return euler_from_quat(state.attitude)[:, 0].clone()


def _x(state: BodyState) -> Tensor:
    return state.position[:, 0].clone()


LOOPS = (Loop("roll", "lee_attitude_control", 1, _roll), Loop("x", "lee_position_control", 0, _x))


def bandwidths(made: Tuned, loop: Loop, asked: float) -> NDArray[np.float64]:
    """Return where the gain of each environment falls to ``sqrt 1/2`` [rad/s], (E,), from sines about what was asked.

    ``made`` has its vehicles once for each of ``ABOUT``.
    """
    vehicles = made.vehicle.num_envs
    pace = asked * torch.tensor(ABOUT, dtype=F64).repeat_interleave(vehicles // len(ABOUT))
    steps, used = (ceil(periods * 2.0 * pi / float(pace.min()) / made.dt) for periods in (PERIODS, LAST))

    def wanted(time: float) -> Tensor:
        action = torch.zeros(vehicles, 4, dtype=F64)
        action[:, loop.entry] = SMALL * torch.sin(pace * time)
        return action

    answers = fly(made, loop.controller, wanted, hover(made), steps, loop.seen)[-used:].T.numpy()
    times, gains = made.dt * np.arange(steps - used + 1, steps + 1), []
    for each, answer in zip(pace.tolist(), answers, strict=True):
        basis = np.column_stack((np.sin(each * times), np.cos(each * times), np.ones_like(times)))
        gains.append(np.hypot(*np.linalg.lstsq(basis, answer, rcond=None)[0][:2]) / SMALL)
    levels = np.log(gains).reshape(len(ABOUT), -1)  # fall with the frequency
    return np.array([asked * np.exp(np.interp(np.log(2.0) / 2.0, -row, np.log(ABOUT))) for row in levels.T])


def dampings(made: Tuned, loop: Loop, frequency: Tensor) -> NDArray[np.float64]:
    """Return the damping ratio of the slowest pair of poles that is heard in a decay to hover, (E,).

    Args:
        made: Vehicles and gains.
        loop: Which one.
        frequency: Of the placed pairs [rad/s].
    """
    start = hover(made)
    if loop.name == "x":
        start.position[:, 0] = SMALL
    else:
        start.attitude.copy_(quat_from_euler(torch.tensor([[SMALL, 0.0, 0.0]], dtype=F64)).expand_as(start.attitude))
    every = max(1, round(SPAN / float(frequency.max()) / SAMPLES / made.dt))
    still = torch.zeros(len(made.delay), 4, dtype=F64)
    decay = fly(made, loop.controller, lambda _: still, start, every * SAMPLES, loop.seen)[every - 1 :: every].numpy()
    return np.array([_damping_of(row / SMALL, every * made.dt) for row in decay.T[: len(made.delay) // len(ABOUT)]])


def _damping_of(samples: NDArray[np.float64], span: float) -> float:
    """Return the damping ratio of the slowest oscillating mode that is heard in samples at a distance [s].

    Source: Hua, Sarkar (1990), Matrix pencil method for estimating parameters of exponentially damped sinusoids in noise.
    """
    length = len(samples) // 3
    hankel = np.lib.stride_tricks.sliding_window_view(samples, length + 1)
    _, size, right = np.linalg.svd(hankel, full_matrices=False)
    rank = int((size > 1e-7 * size[0]).sum())
    ahead = right[:rank].T
    modes = np.linalg.eigvals(np.linalg.pinv(ahead[:-1]) @ ahead[1:])
    loud = np.abs(
        np.linalg.lstsq(np.vander(modes, len(samples), increasing=True).T, samples.astype(complex), rcond=None)[0]
    )
    poles = np.log(modes.astype(complex)) / span
    heard = poles[(loud > HEARD * loud.max()) & (poles.imag > 1e-3 * np.abs(poles))]
    slowest = heard[np.argmax(heard.real)]
    return float(-slowest.real / abs(slowest))


def measure(made: Tuned, asked: Asked) -> list[Flown]:
    """Return what each loop flew with."""
    parts = zip(LOOPS, (asked.attitude, asked.position), (made.attitude, made.position), strict=True)
    return [
        Flown(loop.name, pace, bandwidths(made, loop, pace), dampings(made, loop, tuning.frequency[:, 0]))
        for loop, pace, tuning in parts
    ]


def main() -> None:
    """Print a row for each robot and loop."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="+")
    parser.add_argument("--num-envs", type=int, default=8)
    for name, default in (("attitude-hz", 0.5), ("position-hz", 0.08), ("damping", 0.7), ("dt-s", 0.01)):
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    asked = Asked(2.0 * pi * args.attitude_hz, 2.0 * pi * args.position_hz, args.damping)
    for name in args.robots:
        for flown in measure(tuned(robot_by_name(name), asked, num_envs=args.num_envs, dt=args.dt_s), asked):
            print(_told(name, flown, asked, args.num_envs, as_json=args.json))


def _told(robot: str, flown: Flown, asked: Asked, num_envs: int, *, as_json: bool) -> str:
    hertz, found = flown.bandwidth / (2.0 * pi), flown.damping
    row = {
        "robot": robot, "loop": flown.loop, "num_envs": num_envs, "asked_hz": flown.asked / (2.0 * pi),
        "asked_damping": asked.damping, "least_hz": float(hertz.min()), "most_hz": float(hertz.max()),
        "least_damping": float(found.min()), "most_damping": float(found.max()),
    }  # fmt: skip
    if as_json:
        return json.dumps(row)
    return (
        f"{robot}, {flown.loop}: asked {row['asked_hz']:.3g} Hz and damping {asked.damping:g}; flown {hertz.min():.4g} to "
        f"{hertz.max():.4g} Hz and {found.min():.3f} to {found.max():.3f}"
    )


if __name__ == "__main__":
    try:
        main()
    except AerialGymError as error:
        print(f"tuned: {error}", file=sys.stderr)
        sys.exit(2)
