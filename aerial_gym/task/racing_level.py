"""Levels of the drone racing benchmark lsy_drone_racing, as tasks: ``--task level2.toml``.

A level is a TOML file of github learnsyslab/lsy_drone_racing (formerly utiasDSL/lsy_drone_racing), config/level*.toml: a track,
the start, what a reset draws of vehicle, gates and poles, and frequencies. Limits, reward and observations, which the
benchmark has in code, are those of ``racing_task``; ``docs/guides/racing.md`` lists the differences.
Frames: world, z up; Euler angles there are extrinsic xyz, which is ZYX here.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.checks import Vec3
from aerial_gym.config.environment import GATES, POLES, EnvironmentCfg, GatePlaceCfg, LayoutCfg, TrackCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import InitialStateCfg, RobotCfg
from aerial_gym.config.task import TaskCfg
from aerial_gym.env_manager.catalog import SIMS
from aerial_gym.errors import ConfigError

BORDER = 0.5  # Least distance of a drawn track to its safety limits [m]. Source: envs/randomize.py there
VEHICLE = "cf21B_500"  # The vehicle there that is `racing_task`'s

NO_SPREAD = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

Range = tuple[Vec3, Vec3]  # Lowest and highest offset


def load_level(path: str | Path, base: TaskCfg, robot: RobotCfg) -> TaskCfg:
    """Return the task of a level file; the rest is that of ``base``. Inertia offsets add to the inertia of its robot."""
    path = Path(path)
    try:
        level = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: no level can be read ({error})") from None
    try:
        return _make_task(level, base, robot, name=path.stem)
    except KeyError as error:
        raise ConfigError(f"{path}: field {error} is missing") from None
    except (ConfigError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None


def _make_task(level: Mapping[str, Any], base: TaskCfg, robot: RobotCfg, *, name: str) -> TaskCfg:
    env, sim = level["env"], level["sim"]
    if sim["drone_model"] != VEHICLE:
        raise ConfigError(f"sim.drone_model = {sim['drone_model']!r}: only {VEHICLE} is known")
    disturbances = env.get("disturbances", {})
    spread = _OffsetRanges(env.get("randomizations", {}))
    if env["track"].get("randomize", False) and len(env["track"]["obstacles"]) > len(env["track"]["gates"]):
        raise ConfigError("env.track: more obstacles than gates cannot be drawn")
    where = _make_environment(level, spread, name=name)
    return replace(
        base, summary=f"{name} of lsy_drone_racing", sim=_make_sim(sim["freq"]), env=where,
        start=_make_start(env["track"], spread, where),
        randomize=_make_randomize(spread, robot) | _force_ranges(disturbances, sim["freq"]),
        action=replace(base.action, noise_std=_command_noise(disturbances)),
        command=_make_command(base, env["sensor_range"]), source=f"{name}.toml; the rest: {base.source}",
    )  # fmt: skip


class _OffsetRanges:
    """Ranges of uniform offsets by quantity; zero where the file gives none."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        known = ("drone_pos", "drone_rpy", "drone_mass", "drone_inertia", "gate_pos", "gate_rpy", "obstacle_pos")
        for name, each in given.items():
            if name not in known:
                raise ConfigError(f"env.randomizations.{name}: unknown. Known: {', '.join(known)}")
            if each["fn"] != "uniform":
                raise ConfigError(f"env.randomizations.{name}.fn = {each['fn']!r}: must be 'uniform'")
        self._given = given

    def __contains__(self, name: str) -> bool:
        return name in self._given

    def __getitem__(self, name: str) -> Range:
        if name not in self._given:
            return NO_SPREAD
        given = self._given[name]["kwargs"]
        return _as_vec3(given["minval"]), _as_vec3(given["maxval"])

    def scalar_range(self, name: str) -> tuple[float, float]:
        """Return the range of a given quantity that is one number."""
        given = self._given[name]["kwargs"]
        return float(given["minval"]), float(given["maxval"])


def _as_vec3(numbers: Sequence[float]) -> Vec3:
    x, y, z = (float(number) for number in numbers)
    return x, y, z


def _make_sim(freq: float) -> str:
    for name in sorted(SIMS):
        if abs(SIMS.get(name).dt * freq - 1.0) < 1e-9:
            return name
    known = ", ".join(dict.fromkeys(f"{1.0 / SIMS.get(name).dt:.0f}" for name in sorted(SIMS)))
    raise ConfigError(f"sim.freq = {freq!r}: no sim has this frequency. Known: {known} Hz")


def _make_environment(level: Mapping[str, Any], spread: _OffsetRanges, *, name: str) -> EnvironmentCfg:
    base, env = ENVIRONMENTS.get("racing_env"), level["env"]
    steps = level["sim"]["freq"] / env["freq"]
    if steps != int(steps):
        raise ConfigError(f"env.freq = {env['freq']!r}: must divide sim.freq = {level['sim']['freq']!r}")
    given = env["track"]
    layout = None
    if given.get("randomize", False):
        limits = given["safety_limits"]
        (x0, y0, _), (x1, y1, _) = _as_vec3(limits["pos_limit_low"]), _as_vec3(limits["pos_limit_high"])
        layout = LayoutCfg(lower=(x0 + BORDER, y0 + BORDER), upper=(x1 - BORDER, y1 - BORDER))
    (gate_low, gate_high), (euler_low, euler_high) = spread["gate_pos"], spread["gate_rpy"]
    pole_low, pole_high = spread["obstacle_pos"]
    track = TrackCfg(
        gates=tuple(GatePlaceCfg(position=_as_vec3(g["pos"]), euler=_as_vec3(g["rpy"])) for g in given["gates"]),
        poles=tuple(_as_vec3(pole["pos"]) for pole in given["obstacles"]),
        gate_position_low=gate_low, gate_position_high=gate_high, gate_euler_low=euler_low, gate_euler_high=euler_high,
        pole_low=pole_low, pole_high=pole_high, layout=layout,
    )  # fmt: skip
    counts = track.counts
    assets = tuple(replace(asset, count=counts[asset.name]) for asset in base.assets if asset.name in counts)
    assert {GATES, POLES} == {asset.name for asset in base.assets}
    return replace(
        base, summary=f"track of {name} of lsy_drone_racing", physics_steps_per_env_step=int(steps), track=track,
        assets=assets, source=f"{name}.toml; the rest: {base.source}",
    )  # fmt: skip


def _make_start(track: Mapping[str, Any], spread: _OffsetRanges, env: EnvironmentCfg) -> InitialStateCfg:
    """Return the initial state of flights: around the drone's place, or for random tracks within the safety limits."""
    drone = track["drones"][0]
    if len(track["drones"]) != 1:
        raise ConfigError(f"env.track.drones: {len(track['drones'])}, needs one")
    low, high = (tuple(a + b for a, b in zip(_as_vec3(drone["pos"]), end, strict=True)) for end in spread["drone_pos"])
    if env.track is not None and env.track.layout is not None:
        ends = track["safety_limits"]
        low = (*_as_vec3(ends["pos_limit_low"])[:2], low[2])
        high = (*_as_vec3(ends["pos_limit_high"])[:2], high[2])
    turn = tuple(tuple(a + b for a, b in zip(_as_vec3(drone["rpy"]), end, strict=True)) for end in spread["drone_rpy"])
    return InitialStateCfg(
        position_ratio_low=_share_of_bounds(low, env), position_ratio_high=_share_of_bounds(high, env),
        euler_low=_as_vec3(turn[0]), euler_high=_as_vec3(turn[1]), lin_vel_low=_as_vec3(drone["vel"]),
        lin_vel_high=_as_vec3(drone["vel"]), ang_vel_low=_as_vec3(drone["ang_vel"]),
        ang_vel_high=_as_vec3(drone["ang_vel"]),
    )  # fmt: skip


def _share_of_bounds(point: Sequence[float], env: EnvironmentCfg) -> Vec3:
    """Return a position [m] as a share of the constant bounds."""
    lower, upper = env.bounds_lower_low, env.bounds_upper_low
    return _as_vec3([(p - a) / (b - a) for p, a, b in zip(point, lower, upper, strict=True)])


def _make_randomize(spread: _OffsetRanges, robot: RobotCfg) -> dict[str, RandomizeCfg]:
    draws = {}
    if "drone_mass" in spread:
        low, high = spread.scalar_range("drone_mass")
        draws["body.mass"] = RandomizeCfg(how="offset", low=low, high=high, keep_inertia=True)
    if "drone_inertia" in spread:
        ends = (tuple(1.0 + end[i] / robot.body.inertia[i][i] for i in range(3)) for end in spread["drone_inertia"])
        low, high = ends
        draws["body.inertia"] = RandomizeCfg(low=low, high=high)
    return draws


def _force_ranges(disturbances: Mapping[str, Any], freq: float) -> dict[str, RandomizeCfg]:
    """Return the force ranges of the effect ``random_force``, which the benchmark draws at every simulation step."""
    for name in disturbances:
        if name not in ("action", "dynamics"):
            raise ConfigError(f"env.disturbances.{name}: unknown. Known: action, dynamics")
    if "dynamics" not in disturbances:
        return {}
    given = disturbances["dynamics"]
    if given["fn"] != "uniform":
        raise ConfigError(f"env.disturbances.dynamics.fn = {given['fn']!r}: must be 'uniform'")
    low, high = _as_vec3(given["kwargs"]["minval"]), _as_vec3(given["kwargs"]["maxval"])
    if any(a != -b for a, b in zip(low, high, strict=True)):
        raise ConfigError(f"env.disturbances.dynamics: minval = {low!r}, maxval = {high!r}: must be opposite")
    values = {"x": high[0], "y": high[1], "z": high[2], "hold": 1.0 / freq}
    return {f"effects.random_force.{key}": RandomizeCfg(how="value", low=v, high=v) for key, v in values.items()}


def _command_noise(disturbances: Mapping[str, Any]) -> float:
    """Return the standard deviation of command noise, converted from rad and N to weights and rad/s."""
    if "action" not in disturbances:
        return 0.0
    given = disturbances["action"]
    if given["fn"] != "normal":
        raise ConfigError(f"env.disturbances.action.fn = {given['fn']!r}: must be 'normal'")
    return float(given["scale"])


def _make_command(base: TaskCfg, sensor_range: float) -> Any:
    assert base.command is not None
    return replace(base.command, params={**base.command.params, "sensor_range": float(sensor_range)})
