"""Plan of a robustness test: the cells of a task in groups that share a simulation."""

from collections.abc import Iterator, Mapping
from math import ceil
from pathlib import Path

from aerial_gym.config.sim import SimCfg
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import fewest_and_most_steps
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.rl_training.robustness.cell import CLEAN, Cell, CellGroup, Plan, Variant
from aerial_gym.rl_training.robustness.effect_cells import SIZES, effect_groups
from aerial_gym.rl_training.robustness.wording import cell_label
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.task import task_registry

RATES_HZ = (50, 100, 250, 500)  # Rates of the policy
DELAYS_MS = (50, 40, 30, 20, 10)  # Delays of the policy's commands, rounded to steps
LOSSES = (0.4, 0.2, 0.1, 0.05)  # Probabilities that an observation packet is lost
WEAK_ROTOR = (0.2, 0.15, 0.1, 0.05)  # Missing share of one rotor's thrust
CERTAIN = 1.96  # Half width of a 95 % interval [standard deviations]


def make_plan(flown: PolicyTask, *, quick: bool = False, ranges: Path | None = None) -> Plan:
    """Return the cells of a task; ``quick`` keeps large sizes and every second value.

    Args:
        ranges: Robot file with drawn effects, as ``close-loop --ranges`` writes it.
    """
    cfg, robot, env, sim = flown.configurations()
    dt = sim.dt * env.physics_steps_per_env_step
    sizes = {name: size for name, size in SIZES.items() if not quick or name == "large"}
    lists = (LOSSES, DELAYS_MS, WEAK_ROTOR, RATES_HZ)
    losses, delays, weak, rates = (values[:: 2 if quick else 1] for values in lists)
    groups = [CellGroup(cells=(CLEAN, *(_link_cell("packet_loss", loss, f"{loss:.0%}", loss=loss) for loss in losses)))]
    steps = {round(1e-3 * delay / dt) for delay in delays} - {0}
    if steps:
        late = (_link_cell("delay", n * dt, f"{1e3 * n * dt:g} ms", delay_steps=n) for n in sorted(steps))
        groups.append(CellGroup(cells=tuple(late), settings=(f"task.action.delay_steps=[0, {max(steps)}]",)))
    groups += _noise_groups(cfg, sizes)
    groups += [_rate_group(cfg, sim, dt, rate) for rate in rates if abs(rate * dt - 1.0) > 1e-6]
    of_effects, not_flown = effect_groups(cfg, robot, env, sim, sizes=sizes, weak=weak)
    of_ranges = () if ranges is None else _range_groups(ranges)
    return Plan(groups=(*groups, *of_effects, *of_ranges), not_flown=not_flown)


def _link_cell(subject: str, value: float, text: str, *, loss: float = 0.0, delay_steps: int | None = None) -> Cell:
    return Cell(
        name=f"{subject}/{text}", label=cell_label(subject, value), subject=subject, loss=loss,
        delay_steps=delay_steps,
    )  # fmt: skip


def _noise_groups(cfg: TaskCfg, sizes: Mapping[str, float]) -> Iterator[CellGroup]:
    """Yield one group for each size of noise of the observation terms; that of real sensors is moderate."""
    noise = real_sensor_noise()
    for name, size in sizes.items():
        settings = [
            f"task.observations.{group}.{i}.noise_std={(entry.noise_std**2 + (size * noise[entry.term]) ** 2) ** 0.5}"
            for group, entries in cfg.observations.items()
            for i, entry in enumerate(entries)
            if entry.term in noise
        ]
        if settings:
            yield CellGroup(cells=(_link_cell("noise", size, name),), settings=tuple(settings))


def real_sensor_noise() -> dict[str, float]:
    """Return the largest noise with which a registered task observes each term, in the unit of the term."""
    groups = (group for name in task_registry for group in task_registry.get(name).observations.values())
    noise: dict[str, float] = {}
    for entry in (entry for group in groups for entry in group if entry.noise_std > 0.0):
        noise[entry.term] = max(entry.noise_std, noise.get(entry.term, 0.0))
    return noise


def rate_settings(cfg: TaskCfg, sim: SimCfg, dt: float, rate: float) -> list[str]:
    """Return the settings for another rate of the policy. Times stay; the physics step stays or becomes shorter."""
    substeps, ratio = max(1, ceil(1.0 / (rate * sim.dt) - 1e-6)), rate * dt
    delays = {"task.action": cfg.action.delay_steps} | {
        f"task.observations.{group}.{i}": entry.delay_steps
        for group, entries in cfg.observations.items()
        for i, entry in enumerate(entries)
    }
    settings = [
        f"sim.dt={1.0 / (rate * substeps)!r}", f"env.physics_steps_per_env_step={substeps}",
        f"task.episode_len_steps={max(1, round(ratio * cfg.episode_len_steps))}",
    ]  # fmt: skip
    return settings + [
        f"{key}.delay_steps={[round(ratio * n) for n in fewest_and_most_steps(steps)]}"
        for key, steps in delays.items()
        if steps
    ]


def _rate_group(cfg: TaskCfg, sim: SimCfg, dt: float, rate: float) -> CellGroup:
    """Return the cell of another rate of the policy."""
    settings = rate_settings(cfg, sim, dt, rate)
    return CellGroup(cells=(_link_cell("rate", rate, f"{rate:g} Hz"),), settings=tuple(settings))


def _range_groups(file: Path) -> Iterator[CellGroup]:
    """Yield the cell of all intervals of a robot file together, and the cells of the ends of each interval."""
    robot = robot_by_name(file)
    ranges = {name: each for name, each in robot.randomize.items() if name.startswith("effects.")}
    if not ranges:
        raise ConfigError(f"{file}: draws no effects. Give the robot.yaml of aerial-gym close-loop --ranges")
    yield CellGroup(cells=(_link_cell("ranges", 0.0, "all"),), robot=str(file))
    cells = []
    for name, each in ranges.items():
        _, effect, parameter = name.split(".")
        if effect not in robot.effects:
            continue
        limits = each.value_limits(name, [robot.effects[effect][parameter]], spread=CERTAIN)[0]
        for end, value in zip(("low", "high"), limits, strict=True):
            label = f"{effect}.{parameter} = {value:.4g}, {end} end of its interval"
            variant = Variant(values={(effect, parameter): value})
            cells.append(
                Cell(name=f"ranges/{effect}.{parameter}/{end}", label=label, subject=effect, variants=(variant,))
            )
    if cells:
        settings = tuple(f"robot.randomize.{name}=null" for name in robot.randomize)
        means = Cell(name="ranges/means", label="means of the intervals", subject="ranges")
        yield CellGroup(cells=(means, *cells), settings=settings, robot=str(file), compared=True)
