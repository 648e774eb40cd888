"""Settings of a training by the preflight result of a log: values, ranges, delays, noise and losses, each with its reason.

A contradicted value is drawn within its measured interval. A measured one is drawn in the same way, but up to the declared value:
both agree within the tolerance, so that either may be right. An assumed one is drawn within the tolerance around its declared
value, as is what a log lacks.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import ceil, floor, sqrt
from pathlib import Path
from typing import Any

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.task import POLICY
from aerial_gym.config.task_terms import fewest_and_most_steps
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.rl_training.robustness.effect_cells import effect_obstacle
from aerial_gym.rl_training.robustness.plan import rate_settings, real_sensor_noise
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.preflight.constants import TOLERANCES
from aerial_gym.sim2real.preflight.link import TrainingLink
from aerial_gym.sim2real.preflight.ranges import TrainingConditions
from aerial_gym.sim2real.preflight.rotors import effect_parameter
from aerial_gym.task.terms.observations import OBSERVATIONS

DRAWN = {
    "thrust_per_weight": ("thrust_coefficient", "scale", 1.0, "offset"),
    "thrust_exponent": ("thrust_curve", "k", 0.0, "offset"),
    "motor_latency": ("actuation_delay", "delay", 0.0, "offset"),
    "inertia_roll": ("inertia_error", "sx", 1.0, "factor"),
    "inertia_pitch": ("inertia_error", "sy", 1.0, "factor"),
    "torque_ratio": ("torque_ratio", "scale", 1.0, "factor"),
    "rotor_lag": ("motor_time_constant", "tau", 0.0, "value"),
}
"""Effect, parameter, neutral value, and how a constant changes it: by its offset from the declared value, by its ratio to that,
or as the new value."""

UNMEASURED = (("com_offset", "x"), ("com_offset", "y"))  # Parameters that no preflight log shows: one moderate change
WIRING = ("gyro_sign_contradicted", "rotor_order_contradicted", "spins_contradicted")  # Not to be trained around
STREAMS = {"robot_position": "position", "robot_linvel": "lin_vel", "robot_body_linvel": "lin_vel",
           "robot_body_angvel": "ang_vel", "robot_orientation": "attitude"}  # fmt: skip
"""Stream of a log by the tensors of an observation term; the first one in this order that a term reads."""
WIDTH_OF_JITTER = sqrt(12.0)  # Width of a uniform delay per standard deviation
MOST_LOST = 0.9  # Largest share of lost observations in training
HELD_STEPS = 100  # Steps for which a lost observation is held: longer than any burst of losses


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One quantity of the training."""

    name: str
    state: str  # measured, contradicted, assumed, default (no log shows it), close_loop, or left (as the task has it)
    low: float | None = None  # Range in the training
    high: float | None = None
    unit: str = ""
    setting: str = ""  # Setting of the training, or the reason why there is none


@dataclass(frozen=True, kw_only=True)
class TrainingPlan:
    """Settings of a training for a real vehicle."""

    robot: str  # Robot file
    settings: tuple[str, ...]  # Of the simulation, ``KEY=VALUE``
    choices: tuple[Choice, ...]
    corrections: tuple[str, ...]  # Contradictions to correct on the vehicle, which no training can contain

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan for JSON."""
        return json.loads(json.dumps(asdict(self)))


def robot_for_training(robot: str, log: Path | None) -> str:
    """Return the result of ``close-loop --ranges`` beside a log (``robot.yaml`` with drawn effects), or else the robot."""
    beside = None if log is None else (log if log.is_dir() else log.parent) / "robot.yaml"
    if beside is None or not beside.is_file():
        return robot
    return str(beside) if any(name.startswith("effects.") for name in robot_by_name(beside).randomize) else robot


def conditions_of_task(task: PolicyTask) -> TrainingConditions:
    """Return the rate and the mean latency of the commands of a task."""
    cfg, _, env, sim = task.configurations()
    dt = sim.dt * env.physics_steps_per_env_step
    latency = 0.5 * sum(fewest_and_most_steps(cfg.action.delay_steps)) * dt
    return TrainingConditions(link=TrainingLink(rate=1.0 / dt, latency=latency))


def plan_training(task: PolicyTask, result: Mapping[str, Any]) -> TrainingPlan:
    """Return the training of a task on its robot by a preflight result, as ``read_result`` returns it.

    Raises:
        ConfigError: If the log contradicts a sign, the order or the spins of the rotors.
    """
    findings = result["findings"]
    if wrong := [one["text"] for one in findings if one["code"] in WIRING]:
        raise ConfigError(*(f"{text} Correct it on the vehicle or in the robot file first" for text in wrong))
    known = {one["subject"]: one for one in findings if one["code"].startswith("constant_")}
    draws, drawn = _draws(task, known)
    link, choices = _link_settings(task, known, result.get("noise", {}))
    handled = (*DRAWN, *LINK, *(f"{name}_latency" for name in STREAMS.values()))
    contradicted = [one for name, one in known.items() if one["code"].endswith("contradicted") and name not in handled]
    settings = (*link, f"task.randomize={json.dumps(draws)}") if draws else tuple(link)
    corrections = tuple(one["text"] for one in contradicted)
    return TrainingPlan(robot=str(task.robot), settings=settings, choices=(*drawn, *choices), corrections=corrections)


def interval(finding: Mapping[str, Any] | None, kind: str, *, declared: float = 0.0) -> tuple[float, float, str]:
    """Return the range of a constant in training, and its state; without a finding, its tolerance around ``declared``."""
    if finding is None:
        return declared - TOLERANCES[kind], declared + TOLERANCES[kind], "default"
    state, values = finding["code"].rpartition("_")[2], finding["values"]
    if state == "assumed":
        return values["declared"] - values["tolerance"], values["declared"] + values["tolerance"], state
    if state == "measured":
        return min(values["low"], values["declared"]), max(values["high"], values["declared"]), state
    return values["low"], values["high"], state


def _draws(task: PolicyTask, known: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, Any], list[Choice]]:
    """Return the drawn parameters of effects by the names of ``randomize``, and the choices of all."""
    cfg, robot, env, sim = task.configurations()
    draws = {name: _plain_draw(each) for name, each in cfg.randomize.items()}
    rows = [(name, *DRAWN[name][:2], *_drawn_range(one, robot, name)) for name, one in known.items() if name in DRAWN]
    for effect, parameter in UNMEASURED:
        scale = next(each.scale for each in EFFECTS.get(effect).parameters if each.name == parameter)
        middle = effect_parameter(robot, effect, parameter, 0.0)
        rows.append((f"{effect}.{parameter}", effect, parameter, middle - scale, middle + scale, "default"))
    choices = []
    for name, effect, parameter, low, high, state in rows:
        key, bound = f"effects.{effect}.{parameter}", EFFECTS.get(effect).bind_robot(robot)
        if key in robot.randomize:
            choices.append(Choice(name=name, state="close_loop", setting=f"robot.randomize.{key}"))
        elif reason := effect_obstacle(bound, cfg, robot, env, sim):
            choices.append(Choice(name=name, state="left", setting=reason))
        else:
            number = next(each for each in bound.parameters if each.name == parameter)
            low, high = (min(max(each, number.low), number.high) for each in (low, high))
            draws[key] = {"how": "value", "low": low, "high": high}
            choices.append(
                Choice(name=name, state=state, low=low, high=high, unit=number.unit, setting=f"task.randomize.{key}")
            )
    return draws, choices


def _plain_draw(cfg: RandomizeCfg) -> dict[str, Any]:
    return {name: value for name, value in asdict(cfg).items() if value not in (None, {}, False)}


def _drawn_range(finding: Mapping[str, Any], robot: RobotCfg, name: str) -> tuple[float, float, str]:
    """Return the range of the parameter of an effect by the range of its constant, and the state."""
    effect, parameter, neutral, how = DRAWN[name]
    low, high, state = interval(finding, name)
    declared = finding["values"]["declared"]
    if how == "value":
        return low, high, state
    own = effect_parameter(robot, effect, parameter, neutral)
    if how == "offset":
        return own + low - declared, own + high - declared, state
    return own * low / declared, own * high / declared, state


LINK = ("link_rate", "link_jitter", "packet_loss", "command_latency")


def _link_settings(
    task: PolicyTask, known: Mapping[str, Mapping[str, Any]], noise: Mapping[str, float]
) -> tuple[list[str], list[Choice]]:
    """Return settings for rate, delays, losses and noise of the observations and commands, and their choices."""
    cfg, _, env, sim = task.configurations()
    dt, settings, choices = sim.dt * env.physics_steps_per_env_step, list[str](), list[Choice]()
    low, high, state = interval(known.get("link_rate"), "link_rate", declared=1.0 / dt)
    rate = 0.5 * (low + high) if state == "contradicted" else 1.0 / dt
    if state == "contradicted":
        settings += rate_settings(cfg, sim, dt, rate)
    choices.append(Choice(name="link_rate", state=state, low=rate, high=rate, unit="Hz", setting="sim.dt"))
    jitter = max(interval(known.get("link_jitter"), "link_jitter")[1], 0.0) * WIDTH_OF_JITTER
    low, high, state = interval(known.get("command_latency"), "command_latency")
    settings.append(f"task.action.delay_steps={_steps(low, high + jitter, rate)}")
    choices.append(_delay("command_latency", state, low, high + jitter, "task.action.delay_steps"))
    _, high, state = interval(known.get("packet_loss"), "packet_loss")
    loss = min(max(high, 0.0), MOST_LOST)
    choices.append(Choice(name="packet_loss", state=state, low=loss, high=loss, setting="dropout of the observations"))
    defaults = dict[str, float]()
    for term, std in real_sensor_noise().items():
        defaults[_stream(term)] = max(std, defaults.get(_stream(term), 0.0))
    for number, entry in enumerate(cfg.observations[POLICY]):
        stream = _stream(entry.term)
        if not stream:
            continue
        key = f"task.observations.{POLICY}.{number}"
        measured = noise.get(stream)
        std = defaults.get(stream, 0.0) if measured is None else measured * (0.5 if entry.term == "attitude" else 1.0)
        settings.append(f"{key}.noise_std={max(std, entry.noise_std)!r}")
        source = "default" if measured is None else "measured"
        choices.append(
            Choice(name=f"noise of {entry.term}", state=source, low=std, high=std, setting=f"{key}.noise_std")
        )
        if loss > 0.0:
            settings += [f"{key}.dropout={loss!r}", f"{key}.hold_steps={HELD_STEPS}"]
        if stream != "ang_vel":
            late = known.get(f"{stream}_latency")
            low, high, state = interval(late, "state_latency")
            settings.append(f"{key}.delay_steps={_steps(low, high, rate)}")
            choices.append(_delay(f"latency of {entry.term}", state, low, high, f"{key}.delay_steps"))
    return settings, choices


def _stream(term: str) -> str:
    """Return the stream that an observation term shows; empty if it shows no measurement."""
    reads = OBSERVATIONS.get(term).reads if term in OBSERVATIONS else (term,)
    return next((stream for tensor, stream in STREAMS.items() if tensor in reads), "")


def _steps(low: float, high: float, rate: float) -> list[int]:
    """Return the fewest and the most whole steps of a delay [s]."""
    return [max(floor(low * rate + 1e-6), 0), max(ceil(high * rate - 1e-6), 0)]


def _delay(name: str, state: str, low: float, high: float, setting: str) -> Choice:
    return Choice(name=name, state=state, low=max(low, 0.0), high=max(high, 0.0), unit="s", setting=setting)
