"""Comparison of the hover check of a closed loop with flights of random robots, laws, effects and dead times.

    python -m benchmarks.control.hover_gate [--seed 0] [--num-groups 25]

A group is a registered robot with random mass and rotor lag, a registered law of position or velocity, a time step, and at most
one effect. Each of its ``EACH`` vehicles draws a dead time of 0 to 50 ms and the parameters of the effect. ``ClosedLoop.hover``
accepts or rejects each vehicle. A vehicle hovers if it stays within 0.1 m for 10 s from hover, and is within 0.1 m again 10 s
after a disturbance; a law of velocity must stay there in the last second. Flights are in float32, on the backend that a
simulation takes. Combinations that are refused by name are drawn again.
Letters: E environments.
"""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice

import torch
import tyro
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.hover import HOVER_RANGE, HOVER_SPAN
from aerial_gym.control.laws import LAWS
from aerial_gym.control.stability import FAR, HEIGHT, ClosedLoop, HoverResult
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics import BodyState, build_model, vehicle_from_config
from aerial_gym.physics.backend import PhysicsBackend
from aerial_gym.physics.capabilities import choose_backend, robot_needs
from aerial_gym.physics.effects import EFFECTS, EffectParams
from aerial_gym.physics.model import check_effects, robot_effects
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import robots_by_dynamics

GRAVITY = 9.81
EACH = 8  # Vehicles of a group
DTS = (0.01, 0.01, 0.01, 0.004)  # Time steps [s] that are drawn from; registered sims have these
LONGEST = 0.05  # Dead time [s]
FACTORS = (0.7, 1.4)  # Range of the factors on mass and rotor lag of a registered robot

SIZES = (0.0, 0.01, 0.1, 0.2)
"""Disturbances of the flights of each vehicle [m, rad, m/s, rad/s], each component drawn up to them."""

LAST = 50  # Looks at the end of a flight: a second
LOOK = 0.02  # Time between two looks at a flight [s]

DRAWN_EFFECTS = (
    *(None, None, None, "motor_time_constant", "motor_asymmetry", "payload_mass", "thrust_coefficient", "com_offset"),
    *("weak_motor", "torque_ratio", "inertia_error", "motor_tilt", "rotor_inertia", "rotor_drag", "h_force_flapping"),
    *("axial_inflow", "buoyancy", "slung_payload", "battery_sag"),
)
"""Effects that act at hover, with parameters about the neutral ones by a normal draw of their scale; None for none."""

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, kw_only=True)
class Group:
    """Vehicles that differ in the parameters of their effects alone."""

    robot: str
    controller: str
    dt: float
    cfg: RobotCfg
    effects: tuple[Effects, ...]


@dataclass(frozen=True, kw_only=True)
class Case:
    """Verdicts of the check and of the flights on one vehicle."""

    robot: str
    controller: str
    dt: float
    effects: Effects
    accepted: bool  # Whether it is to hover
    refused: bool  # Whether a simulation of it is refused; else it is warned of unless it is accepted
    hover: HoverResult  # What is said of it
    flown: float  # Largest distance of the flights [m]

    @property
    def hovers(self) -> bool:
        """Whether the vehicle hovers in all its flights."""
        return self.flown <= HOVER_RANGE


def random_groups(seed: int) -> Iterator[Group]:
    """Yield random groups without end; some do not fit together."""
    draw = random.Random(seed)
    robots = [name for name, robot in robots_by_dynamics().items() if robot.control.buoyancy == 0.0]
    laws = [name for name in CONTROLLERS if "vx" in _trim_axes(name)]
    while True:
        robot, controller = draw.choice(robots), draw.choice(laws)
        dt, effect = draw.choice(DTS), draw.choice(DRAWN_EFFECTS)
        mass, lag = draw.uniform(*FACTORS), draw.uniform(*FACTORS)
        cfg = _scale_robot(ROBOTS.get(robot), mass=mass, lag=lag)
        drawn = tuple(_draw_effects(draw, cfg, effect) for _ in range(EACH))
        yield Group(robot=robot, controller=controller, dt=dt, cfg=cfg, effects=drawn)


def _trim_axes(controller: str) -> list[str]:
    law = CONTROLLERS.get(controller).law
    return LAWS[law].trim.split() if law in LAWS else []


def _scale_robot(robot: RobotCfg, *, mass: float, lag: float) -> RobotCfg:
    """Return a robot with factors on mass and inertia, and on the rotor lag of robots with one rotor type."""
    inertia = tuple(tuple(mass * moment for moment in row) for row in robot.body.inertia)
    robot = replace(robot, body=replace(robot.body, mass=mass * robot.body.mass, inertia=inertia))  # type: ignore[arg-type]
    if robot.rotor is None:
        return robot
    up, down = lag * robot.rotor.time_constant_up, lag * robot.rotor.time_constant_down
    return replace(robot, rotor=replace(robot.rotor, time_constant_up=up, time_constant_down=down))


def _draw_effects(draw: random.Random, robot: RobotCfg, name: str | None) -> Effects:
    delay = {"actuation_delay": {"delay": draw.uniform(0.0, LONGEST)}}
    if name is None:
        return delay
    effect, values = EFFECTS.get(name), {}
    numbers = zip(effect.parameters, effect.neutral(robot), effect.bounds(robot), strict=True)
    for parameter, neutral, (low, high) in numbers:
        value = neutral + draw.gauss(0.0, 1.0) * parameter.scale
        values[parameter.name] = min(max(value, low), high)
        if parameter.kind == "rotor":
            values[parameter.name] = float(draw.randint(1, robot.num_rotors))
    return delay | {name: values}


def judge_group(group: Group) -> list[Case] | None:
    """Return the verdicts of check and flights on the vehicles of a group; None for parts that do not fit together."""
    hovers = []
    try:
        for effects in group.effects:
            robot, names = _add_effects(group.cfg, effects), (group.robot, group.controller)
            controller = CONTROLLERS.get(group.controller)
            loop = ClosedLoop(robot, controller, gravity=GRAVITY, integrator="euler", names=names)
            hovers.append(loop.hover(group.dt))
    except ConfigError:
        return None
    flown = largest_distances(group)
    return [
        Case(
            robot=group.robot, controller=group.controller, dt=group.dt, effects=effects,
            accepted=hover.is_supported, refused=hover.is_lost, hover=hover, flown=distance,
        )
        for effects, hover, distance in zip(group.effects, hovers, flown, strict=True)
    ]  # fmt: skip


def _add_effects(robot: RobotCfg, effects: Effects) -> RobotCfg:
    robot = replace(robot, effects={**robot.effects, **effects}, effects_source="benchmarks.control.hover_gate")
    check_effects(robot)
    return robot


def largest_distances(group: Group) -> list[float]:
    """Return the largest distance from the setpoint of each vehicle of a group [m], over its flights."""
    robot, controller = _add_effects(group.cfg, group.effects[0]), CONTROLLERS.get(group.controller)
    rows = EACH * len(SIZES)
    vehicle = vehicle_from_config(robot, num_envs=rows)
    law = make_controller(controller, vehicle, GRAVITY, dt=group.dt, control=robot.control)
    backend = choose_backend("auto", needs=robot_needs(robot, torch.device("cpu"), integrator="euler"))
    model = build_model(vehicle, _effect_params(robot, group), gravity=GRAVITY, ground_height=-FAR, ceiling_height=FAR)
    backend.allocate(model, law, integrator="euler")
    backend.prepare(group.dt)
    state = _hover_with_disturbances(Allocation(vehicle, GRAVITY), robot)
    action = torch.zeros(rows, len(law.action_names))
    if "z" in _trim_axes(group.controller):
        action[:, 2] = HEIGHT
    return _largest_distance(backend, state, action, group.dt, returns="x" in _trim_axes(group.controller))


def _largest_distance(
    backend: PhysicsBackend, state: BodyState, action: Tensor, dt: float, *, returns: bool
) -> list[float]:
    """Return the largest distance from hover [m] of each vehicle in its flights, in the whole of the first one of each."""
    rows, steps, places = len(action), max(1, round(LOOK / dt)), []
    for _ in range(round(HOVER_SPAN / (steps * dt))):
        backend.step(state, action, dt, steps)
        places.append(state.position.clone())
    flown = torch.stack(places).nan_to_num(nan=1e9)
    setpoint = torch.tensor([0.0, 0.0, HEIGHT]).expand(rows, 3)
    undisturbed = (flown - setpoint).norm(dim=-1).amax(0)
    later = (flown[-LAST:] - (setpoint if returns else flown[-LAST])).norm(dim=-1).amax(0)
    first = torch.arange(rows) % len(SIZES) == 0
    return torch.where(first, undisturbed, later).view(EACH, -1).amax(-1).tolist()


def _effect_params(robot: RobotCfg, group: Group) -> list[EffectParams]:
    """Return the effects with the parameters of each vehicle in as many rows as it has flights."""
    rows = EACH * len(SIZES)
    result = []
    for effect, params in robot_effects(
        robot, num_envs=rows, device=torch.device("cpu"), dtype=torch.float32, rigid=True
    ):
        if effect.name in group.effects[0]:
            values = [effect.parse_params(effects[effect.name]) for effects in group.effects]
            params = torch.tensor(values).repeat_interleave(len(SIZES), 0)
        result.append((effect, params))
    return result


def _hover_with_disturbances(allocation: Allocation, robot: RobotCfg) -> BodyState:
    """Return hover of the declared robot, disturbed by ``SIZES``, for each vehicle alike but for the draw."""
    rows, generator = EACH * len(SIZES), torch.Generator().manual_seed(0)
    size = torch.tensor(SIZES).repeat(EACH).unsqueeze(-1)
    weight = torch.zeros(rows, 6)
    weight[:, 2] = robot.body.mass * GRAVITY

    def random_vectors() -> Tensor:
        return size * (2.0 * torch.rand(rows, 3, generator=generator) - 1.0)

    return BodyState(
        position=random_vectors() + torch.tensor([0.0, 0.0, HEIGHT]), attitude=quat_exp(random_vectors()),
        lin_vel=random_vectors(), ang_vel=random_vectors(), rotor_speed=allocation.speed_for_wrench(weight),
    )  # fmt: skip


def cases(seed: int, count: int) -> Iterator[Case]:
    """Yield the cases of so many groups that fit together."""
    judged = (judge_group(group) for group in random_groups(seed))
    yield from chain.from_iterable(islice(filter(None, judged), count))


@dataclass(frozen=True, kw_only=True)
class GateCmd:
    """Compare the check with flights."""

    seed: int = 0  # Of everything that is drawn
    num_groups: int = 25  # Of eight vehicles

    def run(self) -> None:
        """Print the agreement in both directions, and the cases that disagree."""
        result = list(cases(self.seed, self.num_groups))
        for accepted in (True, False):
            subset = [case for case in result if case.accepted is accepted]
            agree = sum(case.hovers is accepted for case in subset)
            words = ("accepted", "hover") if accepted else ("not accepted", "do not hover")
            print(f"{len(subset)} {words[0]}, of these {agree} {words[1]}: {100.0 * agree / max(len(subset), 1):.1f} %")
        for case in result:
            if case.accepted is not case.hovers:
                print(case)


if __name__ == "__main__":
    tyro.cli(GateCmd).run()
