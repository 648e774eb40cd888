"""Buoyancy of links against closed forms, heights and the rigid engine; on other backends in ``tests/cross``.
Added mass of links against Lagrange's equations, conservation laws, closed forms and the rigid engine; float64.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.joint import JointCfg, LinkCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import TreeAccelerations, equations_of_motion, solve
from aerial_gym.physics.articulated.flight import articulated_step, link_wrenches
from aerial_gym.physics.articulated.link_loads import LinkFluid, add_fluid
from aerial_gym.physics.articulated.steppers import implicit_euler, rk4
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.capabilities import choose_backend, robot_needs
from aerial_gym.physics.effects.links import LinkAddedMass, LinkBuoyancy, LinkDrag
from aerial_gym.physics.integrators import semi_implicit_euler, to_body_state, to_mass_state
from aerial_gym.physics.model import Model, build_model, check_effects
from aerial_gym.physics.state import ArticulatedState, BodyState
from aerial_gym.physics.torch_backend import TorchBackend
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.lagrange import Energies, coordinates
from tests.physics.articulated.test_flight import at_rest, make_rod, throw
from tests.physics.articulated.test_link_drag import arm, fly, make_drag_robot, make_model
from tests.physics.articulated.trees import F64, random_links, random_motion, random_tree

G = 9.81


def under_water(
    joints: tuple[JointCfg, ...], effects: dict[str, dict[str, float]], *, floating: bool = True
) -> RobotCfg:
    robot = make_drag_robot(1.0, joints, {})
    return replace(robot, effects=effects, joints=replace(robot.joints, floating=floating))


def link(mass: float, *com: float, inertia: tuple[float, float, float] = (1e-3, 2e-3, 2.5e-3)) -> LinkCfg:
    rows = tuple(tuple(inertia[i] if i == j else 0.0 for j in range(3)) for i in range(3))
    return LinkCfg(mass=mass, com=(com[0], com[1], com[2]), inertia=rows)


def tree_state(state: ArticulatedState) -> TreeState:
    return TreeState(**{name: rows for name, rows in vars(state).items() if name != "rotor_speed"})


def make_joints() -> tuple[JointCfg, ...]:
    """Return an arm of a hinge and a slide, and one more hinge."""
    return (
        arm("left", (0.1, 0.4, 0.05), (0.0, 0.1, 0.0), axis=(0.6, 0.0, 0.8), link=link(0.3, 0.1, 0.4, 0.05)),
        arm("slide", (0.2, 0.6, 0.0), (0.1, 0.5, 0.0), parent="left", kind="prismatic", axis=(0.0, 0.8, 0.6)),
        arm("right", (0.1, -0.4, 0.0), (0.0, -0.1, 0.0), axis=(1.0, 0.0, 0.0), link=link(0.2, 0.1, -0.4, 0.0)),
    )


def draw_state(state: ArticulatedState, seed: int = 4) -> ArticulatedState:
    gen = torch.Generator().manual_seed(seed)

    def draw(like: Tensor, scale: float) -> Tensor:
        return scale * torch.randn(like.shape, generator=gen, dtype=F64)

    return replace(
        state, position=draw(state.position, 1.0),
        attitude=torch.nn.functional.normalize(draw(state.attitude, 1.0), dim=-1), lin_vel=draw(state.lin_vel, 1.0),
        ang_vel=draw(state.ang_vel, 2.0), joint_pos=draw(state.joint_pos, 0.7), joint_vel=draw(state.joint_vel, 2.0),
    )  # fmt: skip


FORCES = {"force": 2.0, "x": 0.01, "left.force": 3.5, "left.y": -0.03, "left.z": 0.05, "base.z": 0.1, "base.force": 8.0}


def test_forces_along_coordinates_are_what_heights_of_centres_of_buoyancy_say() -> None:
    """``-dU/dx`` with ``U = -sum F z``, by SciPy's rotations; numbers of a link stand in place of those of all."""
    model, state = make_model(under_water(make_joints(), {"link_buoyancy": FORCES}), num_envs=3)
    state, articulation = draw_state(state), model.articulation
    tree, links, there = articulation.tree, articulation.links(model.vehicle), tree_state(state)
    wrench = link_wrenches(model, articulation, there, state.rotor_speed, state.rotor_speed)
    result = [equations_of_motion(tree, links, there, gravity=0.0, wrench=rows).force for rows in (wrench, None)]
    push, lever = torch.tensor([8.0, 3.5, 2.0, 2.0], dtype=F64).numpy(), torch.zeros(4, 3, dtype=F64).numpy()
    lever[:, 0], lever[1, 1], lever[1, 2], lever[0, 2] = 0.01, -0.03, 0.05, 0.1
    for env in range(3):
        expected = Energies.from_env(tree, links, there, env, push=push, lever=lever).forces(coordinates(there, env)[0])
        own = result[0] - result[1]
        world = torch.from_numpy(expected)
        turned = Energies.from_env(tree, links, there, env).attitude.as_matrix()
        world[:3] = torch.from_numpy(turned).T @ world[:3]
        torch.testing.assert_close(own[env], world, rtol=0.0, atol=1e-8)


def of_one_link(robot: RobotCfg, effects: list[tuple[object, Tensor]]) -> tuple[Model, ArticulatedState]:
    """Return a rigid robot as a tree of one link with effects on it, and a state in which it moves."""
    bending = build_articulation(ROBOTS.get("morphy"), like=torch.zeros(1, dtype=F64))
    vehicle = vehicle_from_config(robot, num_envs=3, dtype=F64)
    model = build_model(vehicle, effects, articulation=make_rod(bending))
    state = throw(at_rest(model))
    return model, replace(state, rotor_speed=torch.rand(3, 4, dtype=F64, generator=torch.Generator().manual_seed(1)))


def water(tree: Tree, num_envs: int, seed: int, wind: Tensor | None = None) -> LinkFluid:
    """Return water of links that have 0.1 to 1 kg, about as much, and another along each axis."""
    gen = torch.Generator().manual_seed(seed)
    mass, inertia = (torch.rand(num_envs, tree.num_links, 3, dtype=F64, generator=gen) for _ in range(2))
    still = torch.zeros(num_envs, 3, dtype=F64) if wind is None else wind
    return LinkFluid(added=torch.cat((mass, 5e-3 * inertia), dim=-1), wind=still)


def accelerations(tree: Tree, links: Links, state: TreeState, fluid: LinkFluid, *, gravity: float) -> TreeAccelerations:
    result = add_fluid(tree, equations_of_motion(tree, links, state, gravity=gravity), state.attitude, fluid)
    return solve(tree, state, result.mass, result.force)


@pytest.mark.parametrize(("floating", "seed"), [(True, 1), (True, 7), (False, 2)])
def test_trees_in_still_water_accelerate_by_lagranges_equations(floating: bool, seed: int) -> None:
    """Under weight, which the water has none of: energies by SciPy's rotations, all else by differences."""
    tree = random_tree(3, seed, floating=floating)
    links, state, fluid = random_links(tree, 1, seed), random_motion(tree, 1, seed), water(tree, 1, seed)
    energies = Energies.from_env(tree, links, state, 0, added=fluid.added[0].numpy(), gravity=G)
    expected = energies.accelerations(*coordinates(state, 0))
    now = accelerations(tree, links, state, fluid, gravity=G)
    result = torch.cat((now.lin_acc, now.ang_acc, now.joint_acc), dim=-1)[0].numpy()
    assert np.abs(result - expected).max() < 1e-9 * np.abs(expected).max()
    dry = accelerations(tree, links, state, replace(fluid, added=0.0 * fluid.added), gravity=G)
    assert float((dry.joint_acc - now.joint_acc).abs().max()) > 0.1 * float(now.joint_acc.abs().max())


def momentum_energy(tree: Tree, links: Links, state: TreeState, fluid: LinkFluid, env: int = 0) -> np.ndarray:
    """Return energy, impulse and its moment about the world's origin, of links and water, by SciPy's rotations."""
    energies = Energies.from_env(tree, links, state, env, added=fluid.added[env].numpy())
    x, rate = coordinates(state, env)
    momentum = energies.mass_matrix(x) @ rate
    moment = energies.attitude.apply(momentum[3:6]) + np.cross(x[:3], momentum[:3])
    return np.concatenate(([0.5 * rate @ momentum], momentum[:3], moment))


def test_a_free_tree_in_still_water_keeps_energy_impulse_and_moment() -> None:
    """To the order of the stepper: what is lost in a tenth of a second falls by more than 14 when the step is halved."""
    tree = random_tree(3, 5)
    links, start, fluid = random_links(tree, 1, 5), random_motion(tree, 1, 5), water(tree, 1, 5)
    first, lost = momentum_energy(tree, links, start, fluid), []
    for steps in (8, 16):
        state = start
        for _ in range(steps):
            state = rk4(tree, links, (), state, 0.1 / steps, gravity=0.0, fluid=fluid)
        lost.append(np.abs(momentum_energy(tree, links, state, fluid) - first))
    size = np.array([first[0], *[np.linalg.norm(first[1:4])] * 3, *[np.linalg.norm(first[4:])] * 3])
    assert (lost[1] < 1e-5 * size).all()
    assert np.linalg.norm(lost[0] / size) > 14.0 * np.linalg.norm(lost[1] / size)
    dry = momentum_energy(tree, links, state, replace(fluid, added=0.0 * fluid.added))[1:4]
    assert (
        np.linalg.norm(dry - momentum_energy(tree, links, start, replace(fluid, added=0.0 * fluid.added))[1:4]) > 0.05
    )


@pytest.mark.parametrize("name", ["torch", "warp"])
def test_a_free_tree_in_still_water_keeps_its_energy_in_long_steps(name: str) -> None:
    """Within 1 % at every half second of 5 s, in steps of 10 ms, by SciPy's rotations; with velocity terms of the start it
    gains up to 5 %."""
    backend, dtype = (WarpBackend(), torch.float32) if name == "warp" else (TorchBackend(), F64)
    left, _, right = make_joints()
    added = {"mx": 0.05, "my": 0.1, "mz": 0.2, "jx": 1e-3, "jz": 2e-3, "base.my": 0.6}
    robot = under_water((left, right), {"link_added_mass": added})
    exact, still = make_model(robot, num_envs=4)
    ((_, rows),) = exact.effects
    start = replace(draw_state(still), lin_vel=0.5 * draw_state(still, 5).lin_vel)
    slow = {part: 0.25 * getattr(start, part) for part in ("ang_vel", "joint_vel")}
    state = ArticulatedState(**{part: each.to(dtype) for part, each in vars(replace(start, **slow)).items()})
    vehicle = vehicle_from_config(robot, num_envs=4, dtype=dtype)
    bends = build_articulation(robot, like=vehicle.mass)
    effects = [(LinkAddedMass().bind_robot(robot), rows.to(dtype))]
    model = build_model(vehicle, effects, gravity=0.0, articulation=bends)
    backend.allocate(model, make_controller(CONTROLLERS.get("no_control"), vehicle, G), integrator="euler")

    def energies() -> np.ndarray:
        motion = tree_state(ArticulatedState(**{part: each.double() for part, each in vars(state).items()}))
        links, tree = exact.articulation.links(exact.vehicle), bends.tree
        water = LinkAddedMass().bind_robot(robot).added_mass(tree.num_links, rows)
        here = LinkFluid(added=water, wind=torch.zeros_like(motion.lin_vel))
        return np.array([momentum_energy(tree, links, motion, here, env)[0] for env in range(4)])

    first, changes = energies(), []
    for _ in range(10):
        for _ in range(50):
            backend.step(state, torch.zeros(4, 4, dtype=dtype), 0.01, 1)
        changes.append(np.abs(energies() / first - 1.0).max())
    assert max(changes) < 0.01


def test_a_current_carries_all_bodies() -> None:
    """In the frame of the water the same happens: Galileo; of both steppers."""
    tree, current = random_tree(3, 6), torch.tensor([[0.7, -0.4, 0.2]], dtype=F64)
    links, start, fluid = random_links(tree, 2, 6), random_motion(tree, 2, 6), water(tree, 2, 6)
    moving_water = replace(fluid, wind=current.expand(2, -1))
    step: Callable[..., TreeState]
    for step in (implicit_euler, rk4):
        still, carried = start, replace(start, lin_vel=start.lin_vel + current)
        for _ in range(3):
            still = step(tree, links, (), still, 5e-3, gravity=G, fluid=fluid)
            carried = step(tree, links, (), carried, 5e-3, gravity=G, fluid=moving_water)
        back = replace(carried, position=carried.position - 0.015 * current, lin_vel=carried.lin_vel - current)
        for name, rows in vars(still).items():
            torch.testing.assert_close(getattr(back, name), rows, rtol=0.0, atol=1e-11)


def test_a_tree_of_one_link_moves_water_as_a_rigid_hull() -> None:
    """With buoyancy, in a current: ``added_mass`` and ``added_inertia`` are other code, which changes forces. The rigid
    engine conserves momentum in a step and that of trees does not, so that accelerations are compared."""
    robot, numbers = ROBOTS.get("morphy_stiff"), [0.3, 0.8, 0.5, 2e-3, 1e-3, 3e-3]
    rows = torch.tensor([numbers], dtype=F64).expand(3, -1)
    lift = torch.tensor([[3.0, 0.02, -0.03, 0.1]], dtype=F64).expand(3, -1)
    current = torch.tensor([[0.7, -0.4, 0.2]], dtype=F64).expand(3, -1)
    wind = (EFFECTS.get("constant_wind"), current)
    tree, state = of_one_link(robot, [(LinkAddedMass(), rows), (LinkBuoyancy(), lift), wind])
    effects = [(EFFECTS.get("added_mass"), rows[:, :3]), (EFFECTS.get("added_inertia"), rows[:, 3:]), wind]
    vehicle = vehicle_from_config(robot, num_envs=3, dtype=F64)
    rigid, dt = build_model(vehicle, [*effects, (EFFECTS.get("buoyancy"), lift)]), 1e-7
    body = BodyState(**{name: rows for name, rows in vars(state).items() if not name.startswith("joint")})
    own = articulated_step(tree, state, state.rotor_speed, state.rotor_speed[:, :0], dt)
    reference = to_body_state(rigid, semi_implicit_euler(rigid, to_mass_state(rigid, body), state.rotor_speed, dt))
    for name in ("lin_vel", "ang_vel"):
        result, expected = ((getattr(end, name) - getattr(body, name)) / dt for end in (own, reference))
        assert float((result - expected).abs().max()) < 1e-5 * float(expected.abs().max())


def test_a_step_with_water_and_drag_is_of_order_one() -> None:
    """Errors beside extrapolated steps of a robot that sinks in a current."""
    effects = {
        "link_added_mass": {"mx": 0.1, "my": 0.3, "mz": 0.5, "jx": 1e-3, "left.my": 0.6},
        "link_drag": {"qx": 0.5, "qy": 0.5, "az": 0.01},
        "constant_wind": {"x": 1.0, "y": -0.5, "z": 0.3},
    }
    model, start = make_model(under_water(make_joints(), effects), gravity=G)
    start = draw_state(start)
    ends = []
    for steps in (4, 8, 16, 32):
        state = fly(model, start, 0.02 / steps, steps)
        ends.append(torch.cat((state.position, state.lin_vel, state.ang_vel, state.joint_pos, state.joint_vel), dim=-1))
    exact = ends[3] * 8 / 3 - 2 * ends[2] + ends[1] / 3
    errors = [float((each - exact).norm()) for each in ends[:3]]
    assert np.log2(errors[1] / errors[2]) == pytest.approx(1.0, abs=0.1)


WIND = {"x": 1.0, "y": 0.5, "z": -0.3}


@pytest.mark.parametrize(
    ("effects", "fields"),
    [
        (
            {"link_drag": {"lx": 0.1, "qx": 0.3, "right.qz": 0.4, "left.az": 0.01, "bz": 0.02}, "constant_wind": WIND},
            ("joint_pos", "joint_vel"),
        ),
        ({"link_buoyancy": {"force": 0.5, "x": 0.01, "slide.force": 2.0, "slide.z": 0.05}}, ("attitude", "joint_pos")),
        (
            {"link_added_mass": {"mx": 0.1, "my": 0.3, "left.jx": 1e-3}, "constant_wind": WIND},
            ("lin_vel", "joint_pos", "joint_vel"),
        ),
    ],
)
def test_gradients_of_effects_on_links_flow_through_steps(
    effects: dict[str, dict[str, float]], fields: tuple[str, ...]
) -> None:
    model, state = make_model(under_water(make_joints(), effects), gravity=G)
    state, laws = draw_state(state), list(model.effects)

    def end(*inputs: Tensor) -> Tensor:
        rows, values = inputs[: len(laws)], inputs[len(laws) :]
        changed = [(law, own) for (law, _), own in zip(laws, rows, strict=True)]
        there = replace(model, effects=type(model.effects)(changed))
        after = fly(there, replace(state, **dict(zip(fields, values, strict=True))), 0.01, 2)
        return torch.cat((after.lin_vel, after.ang_vel, after.joint_vel), dim=-1)

    inputs = [rows for _, rows in laws] + [getattr(state, name) for name in fields]
    assert torch.autograd.gradcheck(end, tuple(rows.clone().requires_grad_() for rows in inputs))


@pytest.mark.parametrize(
    ("robot", "effect", "values", "words"),
    [
        ("tinyprop", "link_drag", {"qx": 0.1}, "link_drag: is of the links .* this one is rigid. Give it rotor_drag"),
        (
            "morphy_stiff",
            "link_drag",
            {"qx": 0.1},
            "link_drag: is of the links .* this one is rigid. Give it rotor_drag",
        ),
        ("tinyprop", "link_buoyancy", {"force": 1.0}, "is of the links .* is rigid. Give it buoyancy, or joints"),
        ("tinyprop", "link_added_mass", {"mx": 0.1}, "is rigid. Give it added_mass or added_inertia, or joints"),
        (
            "morphy",
            "added_mass",
            dict.fromkeys("xyz", 1.0),
            "is for rigid vehicles.*Give it link_added_mass, or leave out",
        ),
        (
            "morphy",
            "link_drag",
            {"azimut_1.qx": 0.1},
            r"'azimut_1.qx'. .* \(azimuth_4.lx\). Links: base, elevation_1, ",
        ),
        ("morphy", "link_drag", {"qw": 0.1}, "no parameter 'qw'"),
        ("morphy", "link_drag", {"elevation_1.qx": 0.1}, "link_drag.elevation_1.qx: elevation_1 has no mass"),
        ("morphy", "link_drag", {"azimuth_1.qx": -1.0}, r"azimuth_1.qx = -1.0: must lie in \[0, 10000\] N s²/m²"),
        ("morphy", "link_buoyancy", {"azimuth_1.forces": 1.0}, "'azimuth_1.forces'. Give one of force, x, y, z for"),
        (
            "morphy",
            "link_buoyancy",
            {"elevation_1.force": 1.0},
            "at whose centre buoyancy acts.*or the buoyancy to a link",
        ),
        ("morphy", "link_buoyancy", {"force": -1.0}, r"link_buoyancy.force = -1.0: must lie in \[0, 100000\] N"),
        (
            "morphy",
            "link_added_mass",
            {"elevation_1.mx": 0.1},
            "elevation_1 has no mass, at whose centre added mass acts",
        ),
    ],
)
def test_effects_that_do_not_fit_the_links_are_refused(
    robot: str, effect: str, values: dict[str, float], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        check_effects(replace(ROBOTS.get(robot), effects={effect: values}, effects_source="test"))


def test_a_vehicle_has_one_damping_and_one_fluid_of_links() -> None:
    morphy = ROBOTS.get("morphy")
    vehicle = vehicle_from_config(morphy, num_envs=1, dtype=F64)
    for effect, width, label in ((LinkDrag(), 12, "damping"), (LinkAddedMass(), 6, "fluid")):
        twice = [(effect, torch.zeros(1, width, dtype=F64))] * 2
        with pytest.raises(ConfigError, match=f"a vehicle has one {label} of links at most"):
            build_model(vehicle, twice, articulation=build_articulation(morphy, like=vehicle.mass))
    with pytest.raises(ConfigError, match="this one is rigid"):
        build_model(vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1, dtype=F64), twice[:1])


def test_mujoco_refuses_added_mass_of_links() -> None:
    robot = replace(ROBOTS.get("morphy"), effects={"link_added_mass": {"mx": 0.1}}, effects_source="test")
    needs = robot_needs(robot, torch.device("cpu"))
    for name in ("mujoco", "mujoco_warp"):
        with pytest.raises(CapabilityError, match=f"{name}: cannot run effect 'link_added_mass'. Use backend 'warp'"):
            choose_backend(name, needs=needs)
    assert choose_backend("auto", needs=needs).capabilities.joints
