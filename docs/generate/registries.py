"""Pages of what is registered: one section or row for each name, from its configuration."""

import inspect
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config import to_mapping
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg
from aerial_gym.config.task import TaskCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.control.laws import LAWS
from aerial_gym.env_manager import SIMS
from aerial_gym.physics import BACKENDS, EFFECTS
from aerial_gym.registry.registry import Registry
from aerial_gym.rl_training import TRAINERS
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import check_robot
from aerial_gym.robots.parameter_draws import quantity_table
from aerial_gym.sensors import IMUS, SENSORS
from aerial_gym.task import ACTIONS, BUFFERS, COMMANDS, OBSERVATIONS, REWARDS, TERMINATIONS, task_registry
from docs.generate.aerial_gym_names import table_of_names
from docs.generate.markdown import code_marks, page, table, value_text

GALLERY = "![images of the sensors in several environments](../images/gallery.png)"

EXAMPLES = Path(__file__).parents[2] / "examples"


def registry_pages() -> dict[str, str]:
    """Return the pages by their path below ``reference/``."""
    sensors = (*SENSORS.names(), *IMUS.names())
    return {
        "robots.md": page("Robots", _intro("robot", "--robot NAME"), map(_robot, ROBOTS.names())),
        "tasks.md": page("Tasks", _intro("task", "--task NAME"), map(_task, task_registry.names())),
        "environments.md": page("Environments", _intro("environment", "env_name"), map(_environment, ENVIRONMENTS.names())),
        "sensors.md": page("Sensors", _intro("sensor", "sensors: [NAME]"), [GALLERY, *map(_sensor, sensors)]),
        "effects.md": page("Effects", _intro("effect", "effects: {NAME: ...}"), map(_effect, EFFECTS.names())),
        "controllers.md": page("Controllers", _intro("controller", "controller_name"), [_controllers()]),
        "backends.md": page("Backends and sims", _intro("backend", "--backend NAME"), [_backends(), _sims()]),
        "trainers.md": page("Trainers", _intro("trainer", "--trainer NAME"), [_summaries(TRAINERS)]),
        "terms.md": page("Parts of tasks", _intro("term", "term: NAME"), _terms()),
        "quantities.md": page(
            "Quantities that resets can draw", _intro("quantity", "randomize: {NAME: ...}"), [quantity_table()]
        ),
        "aerial_gym_names.md": page(
            "Names of the Aerial Gym Simulator",
            "For users of the Aerial Gym Simulator: each of its names beside the one of this package.",
            [table_of_names()],
        ),
    }  # fmt: skip


def _intro(kind: str, use: str) -> str:
    return f"For users who choose the {kind} by name: `{use}`. This page is generated from the configuration."


def _section(name: str, *parts: str) -> str:
    return "\n\n".join([f"## `{name}`", *(part for part in parts if part)])


def _facts(facts: Mapping[str, Any]) -> str:
    return table(("fact", "value"), ((name, _fact(value)) for name, value in facts.items()))


def _fact(value: Any) -> str:
    return value if isinstance(value, str) else value_text(value)


def _robot(name: str) -> str:
    robot = ROBOTS.get(name)
    report = check_robot(robot, name=name, controllers=())
    facts = {
        "mass [kg]": f"{report.mass_kg:.4g}",
        "principal inertia [kg m²]": ", ".join(f"{report.inertia_kg_m2[i][i]:.4g}" for i in range(3)),
        "rotors": str(report.num_rotors),
        "thrust-to-weight ratio": f"{report.thrust_to_weight:.2f}",
        "hover, share of the rotor range": f"{report.hover_share:.0%}",
        "independent forces and torques": str(report.rank),
        "angular acceleration about x, y, z [rad/s²]": ", ".join(
            f"{x:.3g}" for x in report.angular_acceleration_rad_s2
        ),
        "joints": str(0 if robot.joints is None else len(robot.joints.layout)),
        "sensors": ", ".join(f"`{s if isinstance(s, str) else s.sensor}`" for s in robot.sensors) or "-",
        "effects": ", ".join(f"`{effect}`" for effect in robot.effects) or "-",
        "source": robot.body.source,
    }
    picture = f"![rotors of {name} from above](pictures/{name}.svg){{ width=320 }}"
    return _section(name, robot.summary, picture, _facts(facts))


def _task(name: str) -> str:
    cfg: TaskCfg = task_registry.get(name)
    facts = {
        "robot": f"`{cfg.robot}`",
        "vehicles in an environment": str(cfg.num_vehicles),
        "controller": f"`{cfg.controller}`",
        "environment": f"`{cfg.env}`" if isinstance(cfg.env, str) else "of its own",
        "sim": f"`{cfg.sim}`",
        "episode [steps]": str(cfg.episode_len_steps),
        "command": "-" if cfg.command is None else f"`{cfg.command.generator}`",
        "action": f"`{cfg.action.transform}`",
        **{f"observation `{group}`": _listed(term.term for term in terms) for group, terms in cfg.observations.items()},
        "images": _listed(cfg.images),
        "rewards": _listed(each.term for each in cfg.rewards.values()),
        "terminations": ", ".join(f"`{each.term}` ({each.kind})" for each in cfg.terminations.values()),
        "examples": _listed(_examples_of(name)),
        "source": cfg.source,
    }
    return _section(name, cfg.summary, _facts(facts))


def _listed(names_of_parts: Iterable[str]) -> str:
    return ", ".join(f"`{each}`" for each in dict.fromkeys(names_of_parts)) or "-"


def _examples_of(task: str) -> list[str]:
    """Return the examples that name a task, as paths of the repository."""
    files = sorted(EXAMPLES.rglob("*.py"))
    named = re.compile(rf"\b{task}\b")
    return [str(path.relative_to(EXAMPLES.parent)) for path in files if named.search(path.read_text(encoding="utf-8"))]


def _environment(name: str) -> str:
    cfg: EnvironmentCfg = ENVIRONMENTS.get(name)
    facts = {
        "substeps": str(cfg.physics_steps_per_env_step),
        "lower bounds [m]": f"{value_text(cfg.bounds_lower_low)} to {value_text(cfg.bounds_lower_high)}",
        "upper bounds [m]": f"{value_text(cfg.bounds_upper_low)} to {value_text(cfg.bounds_upper_high)}",
        "ground at [m]": cfg.ground_height,
        "contact force": "yes" if cfg.contact else "no",
        "source": cfg.source,
    }
    head = ("obstacle", "count", "shapes", "motion")
    rows = ((f"`{each.name}`", str(each.count), _shapes(each), each.motion.kind) for each in cfg.assets)
    return _section(name, cfg.summary, _facts(facts), table(head, rows) if cfg.assets else "")


def _shapes(asset: AssetCfg) -> str:
    return _listed(shape.kind for shape in asset.shapes) if asset.family is None else f"family `{asset.family.name}`"


def _sensor(name: str) -> str:
    cfg = (SENSORS if name in SENSORS.names() else IMUS).get(name)
    facts = {key: value for key, value in to_mapping(cfg).items() if key != "summary"}
    return _section(name, cfg.summary, _facts({key: _plain(value) for key, value in facts.items()}))


def _plain(value: Any) -> str:
    """Return a value of a file as one cell; long lists by their length."""
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return f"{len(value)} values"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_plain(each)}" for key, each in value.items())
    return ", ".join(map(_plain, value)) if isinstance(value, (list, tuple)) else value_text(value).strip("`")


def _effect(name: str) -> str:
    effect = EFFECTS.get(name)
    rows = (
        (f"`{p.name}`", p.unit, value_text(p.low), value_text(p.high), value_text(n), p.meaning)
        for p, n in zip(effect.parameters, effect.neutral(ROBOTS.get("base_quadrotor")), strict=True)
    )
    facts = {
        "acts on": effect.acts_on,
        "excitation that shows it": effect.excitation,
        "confounders": _listed(effect.confused_with),
        "rotors that it allows": ", ".join(trait for trait in effect.rotors) or "speed mode only",
        "code": f"`{type(effect).__module__}`",
    }
    text = code_marks(inspect.getdoc(type(effect)) or "")
    head = ("parameter", "unit", "lowest", "highest", "neutral (`base_quadrotor`)", "meaning")
    return _section(name, text, table(head, rows), _facts(facts))


def _controllers() -> str:
    rows = ((f"`{name}`", f"`{cfg.law}`", cfg.summary, _action(cfg.law)) for name, cfg in _entries(CONTROLLERS))
    return table(("controller", "law", "summary", "action"), rows)


def _action(law: str) -> str:
    return ", ".join(LAWS[law].action) if law in LAWS else "one entry for each rotor"


def _entries(registry: Registry[Any]) -> list[tuple[str, Any]]:
    return [(name, registry.get(name)) for name in registry.names()]


def _backends() -> str:
    head = ("backend", "devices", "float types", "integrators", "gradients", "contact", "joints")
    return "\n\n".join(["## Backends", table(head, (_backend(name, made()) for name, made in _entries(BACKENDS)))])


def _backend(name: str, backend: Any) -> tuple[str, ...]:
    able = backend.capabilities
    floats = ", ".join(str(dtype).removeprefix("torch.") for dtype in able.dtypes)
    flags = ("yes" if flag else "no" for flag in (able.differentiable, able.contact, able.joints))
    return (f"`{name}`", ", ".join(able.devices), floats, ", ".join(able.integrators), *flags)


def _sims() -> str:
    rows = (
        (f"`{name}`", value_text(cfg.dt), value_text(cfg.gravity), cfg.integrator, cfg.backend, cfg.summary)
        for name, cfg in _entries(SIMS)
    )
    head = ("sim", "substep [s]", "gravity [m/s²]", "integrator", "backend", "summary")
    return "\n\n".join(["## Sims", table(head, rows)])


def _terms() -> list[str]:
    kinds = {
        "Observation terms": OBSERVATIONS,
        "Reward terms": REWARDS,
        "Termination terms": TERMINATIONS,
        "Commands": COMMANDS,
        "Actions": ACTIONS,
        "Task buffers": BUFFERS,
    }
    return [f"## {title}\n\n{_summaries(registry)}" for title, registry in kinds.items()]


def _summaries(registry: Registry[Any]) -> str:
    return table(("name", "meaning"), ((f"`{name}`", line) for name, line in registry.summaries().items()))
