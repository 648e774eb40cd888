"""Settings of a training by the preflight result of a log: values, ranges, delays, noise and losses, each with its reason.

A contradicted value is drawn within its measured interval. A measured one is too, and up to the declared value: both agree
within the tolerance, so that either may be right. An assumed one is drawn within the tolerance around its declared value, as is
what a log lacks.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, sqrt
from pathlib import Path
from typing import Any

from aerial_gym.config.loader import to_mapping
from aerial_gym.config.task import POLICY
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.rl_training.robustness.effect_cells import effect_obstacle
from aerial_gym.rl_training.robustness.plan import rate_settings, real_sensor_noise
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.preflight.constants import TOLERANCES
from aerial_gym.sim2real.preflight.rotors import effect_parameter
from aerial_gym.task.terms.observations import OBSERVATIONS

Findings = Mapping[str, Mapping[str, Any]]  # Findings on constants, as a written result has them, by their subject

DRAWN: dict[str, tuple[str, str, float | None, bool]] = {
    "thrust_per_weight": ("thrust_coefficient", "scale", 1.0, False), "thrust_exponent": ("thrust_curve", "k", 0.0, False),
    "motor_latency": ("actuation_delay", "delay", 0.0, False), "rotor_lag": ("motor_time_constant", "tau", None, False),
    "inertia_roll": ("inertia_error", "sx", 1.0, True), "inertia_pitch": ("inertia_error", "sy", 1.0, True),
    "torque_ratio": ("torque_ratio", "scale", 1.0, True),
}  # fmt: skip
"""Effect and parameter of a constant, its value without the effect (None: that of the constant), and whether it is a share."""

UNMEASURED = (("com_offset", "x"), ("com_offset", "y"))  # Parameters that no preflight log shows: a moderate change
WIRING = ("gyro_sign_contradicted", "rotor_order_contradicted", "spins_contradicted")  # Not to be trained around
LINK = ("link_rate", "link_jitter", "packet_loss", "command_latency")
STREAMS = {"robot_position": "position", "robot_linvel": "lin_vel", "robot_body_linvel": "lin_vel",
           "robot_body_angvel": "ang_vel", "robot_orientation": "attitude"}  # fmt: skip
"""Stream of a log by the tensors of an observation term; the first one in this order that a term reads."""
HELD_STEPS = 100  # Steps for which a lost observation is held: longer than any burst of losses


@dataclass(frozen=True)
class Choice:
    """One quantity of the training."""

    name: str
    state: str  # measured, contradicted, assumed, default (not in the log), close_loop, or left (as the task has it)
    setting: str  # Setting of the training, or the reason why there is none
    low: float | None = None  # Range in the training, in SI units
    high: float | None = None


@dataclass(frozen=True, kw_only=True)
class TrainingPlan:
    """Settings of a training for a real vehicle."""

    robot: str
    settings: tuple[str, ...]  # Of the simulation, ``KEY=VALUE``
    choices: tuple[Choice, ...]
    corrections: tuple[str, ...]  # Contradictions to correct on the vehicle, which no training can contain


def robot_for_training(robot: str, log: Path | None) -> str:
    """Return the result of ``close-loop --ranges`` beside a log (``robot.yaml`` with drawn effects), or else the robot."""
    beside = None if log is None else (log if log.is_dir() else log.parent) / "robot.yaml"
    drawn = robot_by_name(beside).randomize if beside is not None and beside.is_file() else {}
    return str(beside) if any(name.startswith("effects.") for name in drawn) else robot


def plan_training(task: PolicyTask, result: Mapping[str, Any]) -> TrainingPlan:
    """Return the training of a task on its robot by a preflight result, as ``read_result`` returns it.

    Raises:
        ConfigError: If the log contradicts a sign, the order or the spins of the rotors.
    """
    if wrong := [one["text"] for one in result["findings"] if one["code"] in WIRING]:
        raise ConfigError(*(f"{text} Correct it on the vehicle or in the robot file first" for text in wrong))
    known = {one["subject"]: one for one in result["findings"] if one["code"].startswith("constant_")}
    drawing, drawn = _draws(task, known)
    settings, observed = _link_settings(task, known, result.get("noise", {}))
    trained = {*DRAWN, *LINK, *(f"{name}_latency" for name in STREAMS.values())}
    untrained = [one for name, one in known.items() if name not in trained and one["code"] == "constant_contradicted"]
    return TrainingPlan(
        robot=str(task.robot), settings=(drawing, *settings), choices=(*drawn, *observed),
        corrections=tuple(one["text"] for one in untrained),
    )  # fmt: skip


def constant_range(finding: Mapping[str, Any] | None, kind: str) -> tuple[float, float, str]:
    """Return the range of a constant in training, and its state; without a finding, its tolerance around zero."""
    if finding is None:
        return -TOLERANCES[kind], TOLERANCES[kind], "default"
    state, values = finding["code"].rpartition("_")[2], finding["values"]
    declared = values["declared"]
    if state == "assumed":
        return declared - values["tolerance"], declared + values["tolerance"], state
    ends = (values["low"], values["high"], *([declared] if state == "measured" else []))
    return min(ends), max(ends), state


def _draws(task: PolicyTask, known: Findings) -> tuple[str, list[Choice]]:
    """Return the setting of the draws of a task, with those of effects, and the choices."""
    cfg, robot, env, sim = task.configurations()
    draws, choices, rows = (
        dict(to_mapping(cfg)["randomize"]),
        list[Choice](),
        list[tuple[str, str, str, float, float, str]](),
    )
    for name in [name for name in DRAWN if name in known]:
        (effect, parameter, neutral, share), declared = DRAWN[name], known[name]["values"]["declared"]
        low, high, state = constant_range(known[name], name)
        own = effect_parameter(robot, effect, parameter, declared if neutral is None else neutral)
        low, high = (own + (end - declared) / (declared if share else 1.0) for end in (low, high))
        rows.append((name, effect, parameter, low, high, state))
    for effect, name in UNMEASURED:
        middle = effect_parameter(robot, effect, name, 0.0)
        scale = next(each.scale for each in EFFECTS.get(effect).parameters if each.name == name)
        rows.append((f"{effect}.{name}", effect, name, middle - scale, middle + scale, "default"))
    for name, effect, parameter, low, high, state in rows:
        key, bound = f"effects.{effect}.{parameter}", EFFECTS.get(effect).bind_robot(robot)
        if key in robot.randomize:
            choices.append(Choice(name, "close_loop", f"robot.randomize.{key}"))
        elif reason := effect_obstacle(bound, cfg, robot, env, sim):
            choices.append(Choice(name, "left", reason))
        else:
            limits = next(each for each in bound.parameters if each.name == parameter)
            low, high = (min(max(end, limits.low), limits.high) for end in (low, high))
            draws[key] = {"how": "value", "low": low, "high": high}
            choices.append(Choice(name, state, f"task.randomize.{key}", low, high))
    return f"task.randomize={json.dumps(draws)}", choices


def _link_settings(task: PolicyTask, known: Findings, noise: Mapping[str, float]) -> tuple[list[str], list[Choice]]:
    """Return settings for rate, delays, losses and noise of commands and observations, and the choices."""
    cfg, _, env, sim = task.configurations()
    dt, settings, choices = sim.dt * env.physics_steps_per_env_step, list[str](), list[Choice]()
    rate = 1.0 / dt

    def choose(name: str, state: str, low: float, high: float, key: str, value: object) -> None:
        settings.append(f"{key}={value!r}")
        choices.append(Choice(name, state, key, low, high))

    def delay(name: str, constant: str, kind: str, key: str, more: float = 0.0) -> None:
        low, high, state = constant_range(known.get(constant), kind)
        low, high = max(low, 0.0), max(high, 0.0) + more
        choose(name, state, low, high, f"{key}.delay_steps", [floor(low * rate + 1e-6), ceil(high * rate - 1e-6)])

    low, high, state = constant_range(known.get("link_rate"), "link_rate")
    if state == "contradicted":
        rate = 0.5 * (low + high)
        settings += rate_settings(cfg, sim, dt, rate)
        choices.append(Choice("link_rate", state, "sim.dt", rate, rate))
    jitter = max(constant_range(known.get("link_jitter"), "link_jitter")[1], 0.0)
    width = sqrt(12.0) * jitter  # Of a uniform delay with this standard deviation
    delay("command_latency, link_jitter", "command_latency", "command_latency", "task.action", width)
    _, lost, state = constant_range(known.get("packet_loss"), "packet_loss")
    default = dict[str, float]()
    for term, std in real_sensor_noise().items():
        default[_stream(term)] = max(std, default.get(_stream(term), 0.0))
    for number, entry in enumerate(cfg.observations[POLICY]):
        stream, key = _stream(entry.term), f"task.observations.{POLICY}.{number}"
        if not stream:
            continue
        std = noise.get(stream, default.get(stream, 0.0)) * (0.5 if entry.term == "attitude" else 1.0)
        std = max(std, entry.noise_std)
        choose(
            f"noise of {entry.term}", "measured" if stream in noise else "default", std, std, f"{key}.noise_std", std
        )
        if lost > 0.0:
            choose(f"packet_loss of {entry.term}", state, lost, lost, f"{key}.dropout", lost)
            settings.append(f"{key}.hold_steps={HELD_STEPS}")
        if stream != "ang_vel":
            delay(f"latency of {entry.term}", f"{stream}_latency", "state_latency", key)
    return settings, choices


def _stream(term: str) -> str:
    """Return the stream that an observation term shows; empty if it shows no measurement."""
    reads = OBSERVATIONS.get(term).reads if term in OBSERVATIONS else (term,)
    return next((stream for tensor, stream in STREAMS.items() if tensor in reads), "")
