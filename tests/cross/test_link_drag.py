"""Drag and water of links on the fused backend, which eliminates link by link, against torch, which factors a matrix.

The bound is that of ``test_joints``: so many times as far from float64 as float32 torch is.
Effects under water: the fused backend against the torch reference.
"""

from dataclasses import replace
from itertools import product

import pytest
import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BACKENDS, EFFECTS, PhysicsBackend, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.effects import EffectParams
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.cross.test_backends import as_type, assert_same_flight
from tests.cross.test_joints import FACTOR, ROUND_OFF, odd_tree
from tests.physics.articulated.test_link_buoyancy import make_joints, under_water
from tests.physics.test_water import tumble_state, without_drag
from tests.physics.vehicles import asymmetric_robot, make_effects, random_state, strong_effects
from tests.repetitions import frequent_values

NUM_ENVS, DT, SUBSTEPS, STEPS = 16, 0.002, 3, 3

OF_ALL = {"lx": 0.02, "ly": 0.03, "lz": 0.01, "qx": 0.02, "qy": 0.01, "qz": 0.03, "ax": 1e-4, "az": 2e-4, "bx": 1e-4}


def with_drag(name: str, drag: dict[str, float]) -> RobotCfg:
    robot = odd_tree() if name == "odd" else ROBOTS.get(name)
    return replace(robot, effects={"link_drag": drag}, effects_source="test")


DRAWN = RandomizeCfg(how="value", distribution="uniform", low=0.001, high=0.02)

BUOYANCY = {"force": 0.5, "x": 0.01, "slide.force": 2.0, "slide.z": 0.05, "base.y": -0.03}

ADDED = {"mx": 0.05, "my": 0.1, "mz": 0.2, "slide.mx": 0.3, "jx": 1e-3, "jz": 2e-3, "base.my": 0.6}

ALL = {"link_buoyancy": BUOYANCY, "link_added_mass": ADDED, "link_drag": OF_ALL}

ON_A_STAND = {"link_buoyancy": {"left.force": 2.0, "left.z": 0.1}}

ALL_LINK_EFFECTS, ONE_ARM = {**OF_ALL, "slide.qx": 0.3, "left.ay": 2e-3}, {"azimuth_1.qz": 0.5, "azimuth_1.by": 1e-3}

CASES = {
    "drag": (
        with_drag("morphy", {**OF_ALL, "azimuth_2.qx": 0.3, "azimuth_3.lz": 0.4, "base.qx": 0.0}),
        ("constant_wind",),
    ),
    "drag on a stand": (with_drag("morphy_fixed_base", OF_ALL), ("gusts",)),
    "drag of one arm": (with_drag("morphy", ONE_ARM), ("constant_wind", "quadratic_drag")),
    "drag of the base": (with_drag("morphy", {"base.lx": 0.2, "base.qy": 0.1, "base.az": 1e-3}), ("wind_shear",)),
    "drag of a snake": (with_drag("snakey", OF_ALL), ("constant_wind",)),
    "drag with drives": (with_drag("odd", ALL_LINK_EFFECTS), ("constant_wind", "gusts", "rotor_drag")),
    "buoyancy": (under_water(make_joints(), {"link_buoyancy": BUOYANCY}), ()),
    "added mass": (under_water(make_joints(), {"link_added_mass": ADDED}), ()),
    "all in a current": (under_water(make_joints(), ALL), ("constant_wind",)),
    "buoyancy on a stand": (under_water(make_joints(), ON_A_STAND, floating=False), ()),
    "all on a stand": (under_water(make_joints(), ALL, floating=False), ("constant_wind",)),
    "all with drives": (replace(odd_tree(), effects=ALL, effects_source="test"), ("gusts", "rotor_drag", "buoyancy")),
}
"""Robots, and effects on them beside those of links."""


def effect_rows(robot: RobotCfg, rest: tuple[str, ...], dtype: torch.dtype) -> list[EffectParams]:
    """Return effects of the robot and others, each environment with numbers of its own."""
    each, rows = torch.linspace(0.5, 1.5, NUM_ENVS, dtype=dtype).unsqueeze(1), []
    for name, values in robot.effects.items():
        law = EFFECTS.get(name).bind_robot(robot)
        rows.append((law, each * torch.tensor(law.parse_params(values), dtype=dtype)))
    rows += [(law, each.flip(0) * row) for law, row in strong_effects(rest, robot, NUM_ENVS, dtype=dtype)]
    return rows


def fly(
    backend: PhysicsBackend, robot: RobotCfg, rest: tuple[str, ...], dtype: torch.dtype, *, nudge: float = 0.0,
    dt: float = DT,
) -> tuple[Tensor, ...]:  # fmt: skip
    """Return the state at the end of a flight under random thrusts and drives, in float64; ``nudge`` moves its start."""
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
    law, articulation = (
        make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=dt),
        build_articulation(robot, like=vehicle.mass),
    )
    model = build_model(vehicle, effect_rows(robot, rest, dtype), articulation=articulation)
    gen = torch.Generator().manual_seed(7)

    def draw(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=gen) - 0.5

    hover = vehicle.speed_high[0, 0].item() * 0.5
    start = vars(random_state(NUM_ENVS, seed=5, rotor_speed=hover))
    start["rotor_speed"] = torch.full((NUM_ENVS, vehicle.num_rotors), hover, dtype=torch.float64)
    joints = articulation.reference.double() + 0.3 * draw(NUM_ENVS, articulation.num_joints)
    state = ArticulatedState(**start, joint_pos=joints, joint_vel=2.0 * draw(NUM_ENVS, articulation.num_joints))
    signs = torch.where(draw(NUM_ENVS, 1) > 0.0, 1.0, -1.0) * nudge
    state = replace(state, **{name: (rows * (1.0 + signs)).to(dtype) for name, rows in vars(state).items()})
    backend.allocate(model, law, integrator="euler", random=Randomness(NUM_ENVS))
    weight = 9.81 * robot.body.mass / vehicle.num_rotors
    for _ in range(STEPS):
        thrusts = 1.5 * weight * (0.5 + draw(NUM_ENVS, len(law.action_names)))
        command = torch.cat((thrusts, 2.0 * draw(NUM_ENVS, articulation.num_driven)), dim=1).to(dtype)
        backend.step(state, command, dt, SUBSTEPS)
    return tuple(tensor.double() for tensor in state.tensors())


@pytest.mark.parametrize("case", frequent_values(CASES, ("drag on a stand", "all in a current")))
def test_the_fused_step_is_that_of_the_reference(case: str) -> None:
    """A star of universal joints, a chain, a stand, and a tree that has everything; the effects are seen in all that moves. A
    tree flies with drag always among the effects at hubs of ``test_joints``."""
    robot, remaining = CASES[case]
    exact = fly(TorchBackend(), robot, remaining, torch.float64)
    singles = [fly(TorchBackend(), robot, remaining, torch.float32, nudge=nudge * 2.0**-24) for nudge in (0, 1)]
    fused = fly(WarpBackend(), robot, remaining, torch.float32)
    without = fly(TorchBackend(), replace(robot, effects={}), remaining, torch.float64)
    for place, (right, own, *roughs) in enumerate(zip(exact, fused, *singles, strict=True)):
        away = max(float((rough - right).abs().max()) for rough in roughs)
        allowed = FACTOR * away + ROUND_OFF * float(right.abs().max().clamp_min(1.0))
        assert bool(right.isfinite().all())
        assert float((own - right).abs().max()) <= allowed
        if place in (3, 6) and (place == 6 or "stand" not in case):  # angular velocity, rates of joints
            assert float((without[place] - right).abs().max()) > 100.0 * allowed


def test_mujoco_carries_links_as_torch_does() -> None:
    """On a free base and on a stand; both hold the force through a step, and round."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")
    for case in ("buoyancy", "buoyancy on a stand"):
        robot, rest = CASES[case]
        ends = [fly(backend, robot, rest, torch.float64) for backend in (TorchBackend(), BACKENDS.get("mujoco")())]
        for one, other in zip(*ends, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)
    with pytest.raises(CapabilityError, match="backend mujoco: bodies of MuJoCo have one mass along all axes"):
        fly(BACKENDS.get("mujoco")(), CASES["added mass"][0], (), torch.float64)


def make_env(robot: RobotCfg, randomize: dict[str, RandomizeCfg]) -> EnvManager:
    return simulation(replace(robot, randomize=randomize), sim="base_sim_2ms", num_envs=32, seed=1)


@pytest.mark.parametrize(
    ("effects", "drawn", "most", "joint", "steps"),
    [
        (
            {"link_drag": {"azimuth_1.lx": 0.01}, "constant_wind": {"x": -8.0, "y": 0.0, "z": 0.0}},
            "link_drag.azimuth_1.lx", 0.02, "azimuth_1", 20,
        ),
        (
            {"link_buoyancy": {"azimuth_1.force": 0.1, "azimuth_1.z": 0.0}},
            "link_buoyancy.azimuth_1.force", 0.3, "elevation_1", 1,
        ),
    ],
)  # fmt: skip
def test_a_reset_draws_a_number_of_a_link_and_its_arm_feels_it(
    effects: dict[str, dict[str, float]], drawn: str, most: float, joint: str, steps: int
) -> None:
    """Morphy on a stand, its arms let go at rest: the more drag in wind from the front, the further back one is blown, and the
    more water it displaces, the higher it is."""
    robot = replace(ROBOTS.get("morphy_fixed_base"), effects=effects, effects_source="test", sensors=())
    env = make_env(robot, {f"effects.{drawn}": replace(DRAWN, high=most)})
    env.reset()
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    env.gtd["dof_position"].zero_()
    env.gtd["dof_velocity"].zero_()
    for _ in range(steps):
        env.step(torch.zeros(32, 4))
    draws = env.robot_manager.draws()[f"effects.{drawn}"]
    torch.testing.assert_close(env.gtd[f"effect_{drawn.split('.')[0]}"][:, 0], draws)
    assert len(set(draws.tolist())) == 32
    moved = env.gtd["dof_position"][:, robot.joints.names.index(joint)]
    assert bool((moved[draws.argsort()].diff() < 0.0).all())


def test_draws_of_links_that_are_not_there_are_refused() -> None:
    robot = with_drag("morphy", OF_ALL)
    with pytest.raises(ConfigError, match="no quantity 'effects.link_drag.azimuth_9.lx'. Did you mean"):
        make_env(robot, {"effects.link_drag.azimuth_9.lx": DRAWN})
    with pytest.raises(ConfigError, match="effect link_drag: is of the links"):
        make_env(ROBOTS.get("tinyprop"), {"effects.link_drag.lx": DRAWN})


WATER = ("buoyancy", "hull_drag", "added_mass", "added_inertia", "constant_wind")
LOADED = ("added_mass", "slung_payload")


@pytest.mark.parametrize(
    ("integrator", "effects"),
    frequent_values(
        product(("euler", "rk4"), (("added_mass",), WATER, LOADED)),
        [("euler", ("added_mass",)), ("rk4", WATER), ("euler", LOADED)],
    ),
)
def test_a_hull_moves_like_torch(integrator: str, effects: tuple[str, ...]) -> None:
    assert_same_flight(asymmetric_robot(), CONTROLLERS.get("no_control"), integrator, effects=effects)


def test_a_vehicle_in_water_moves_like_torch() -> None:
    assert_same_flight(ROBOTS.get("base_octarotor"), CONTROLLERS.get("no_control"), "euler", effects=WATER)


def engine(name: str) -> tuple[PhysicsBackend, torch.dtype]:
    if name == "mujoco":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")
        return BACKENDS.get("mujoco")(), torch.float64
    return (WarpBackend(), torch.float32) if name == "warp" else (TorchBackend(), torch.float64)


@pytest.mark.parametrize("name", ["torch", "warp", "mujoco"])
def test_a_hull_rests_on_the_ground(name: str) -> None:
    """Let down from 1 mm above it, a hull that sinks comes to rest and stays: the pose moves with half of each impulse."""
    backend, dtype = engine(name)
    robot = without_drag("bluerov2_heavy")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=dtype)
    effects = {**robot.effects, "buoyancy": {"force": 100.0, "x": 0.0, "y": 0.0, "z": 0.01}}
    model = build_model(vehicle, [(effect, rows.to(dtype)) for effect, rows in make_effects(effects, 1)])
    corners = [[x, y, -0.19, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    ground = Ground(
        height=0.0, spheres=torch.tensor(corners), contact=torch.zeros(1, dtype=torch.bool),
        cfg=ContactCfg(friction=0.5), impulse=torch.zeros(1, 3),
    )  # fmt: skip
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
    backend.allocate(model, law, integrator="euler", ground=ground)
    state = as_type(tumble_state(8, seed=0, speed=0.0, rate=0.0, envs=1), dtype)
    state.position.copy_(torch.tensor([[0.0, 0.0, 0.191]]))
    state.attitude.copy_(torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    heights = []
    for _ in range(200):
        backend.step(state, torch.zeros(1, 8, dtype=dtype), 0.01, 1)
        heights.append(float(state.position[0, 2]))
    assert abs(heights[-1] - heights[-50]) < 1e-6
    assert abs(float(state.lin_vel[0, 2])) < 1e-5
    assert -2e-3 < heights[-1] - 0.19 < 0.0
