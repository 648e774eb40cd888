"""The kernels that only a GPU runs are at least compiled for one, on any machine: Warp brings the compiler along."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import warp as wp

from aerial_gym.assets import clearance, obstacle_motion, placement, track, vehicle_collision
from aerial_gym.assets.collision import make_collision_kernel
from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.images import IMAGES
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import RowFunction
from aerial_gym.physics import EFFECTS, Ground, WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.effects.wakes import WakeSum
from aerial_gym.physics.model import robot_effects
from aerial_gym.robots import ROBOTS, initial_state, secondary_states, start_separation
from aerial_gym.robots.groups import payload
from aerial_gym.robots.groups.wakes import make_wake_kernel
from aerial_gym.sensors import flow, imu, scan, sensor_poses, sensor_view, vehicle_network
from aerial_gym.sensors.images import LANES, ROWS, make_pooling_kernel
from aerial_gym.sensors.pixels import PixelOutputs
from aerial_gym.sensors.ray_kernels import make_warp_kernel
from aerial_gym.task.commands import gates
from aerial_gym.task.kernels import draws
from tests.builders import simulation
from tests.physics.contact_rig import ObstacleRig, obstacle, start
from tests.physics.rotor_types import three_type_robot
from tests.physics.vehicles import ON_RIGID, random_network

ARCHITECTURE = 90  # Compute capability: Hopper


def compile_for_gpu(module, *, assemble: bool = False) -> None:
    """Compile into the cache of all kernels: the same source is not compiled twice on a machine. To PTX, where all
    errors of a source show but those within inline assembly; assembling takes as long again, or longer.

    The options of the module are restored, or later tests would compile it for the CPU once more."""
    start_warp()
    options = dict(module.options) if isinstance(module, wp.Module) else {}
    if options:  # without optimisation it takes far longer, and with all of it twice as long
        module.options["optimization_level"] = 2
        module.mark_modified()
    (binary,) = wp.compile_aot_module(module, arch=ARCHITECTURE, use_ptx=not assemble)
    if options:
        module.options.update(options)
        module.mark_modified()
    assert Path(binary).is_file()


@pytest.mark.parametrize("rich", [pytest.param(False, marks=pytest.mark.slow), True])
def test_ray_kernels_compile(rich: bool) -> None:
    kind = dict.fromkeys(("noise", "shadows", "lamps", "scan", "shared"), rich)
    images, in_world = (tuple(IMAGES), ("points", "normals")) if rich else (("distance",), ())
    outputs = PixelOutputs(images=images, in_world=in_world, **kind)
    compile_for_gpu(make_warp_kernel(outputs).module)


ONE_OF_EACH_KIND = ("rotor_drag", "gusts", "ground_effect", "battery_sag", "actuation_delay", "slung_payload")
"""They push, blow, change thrust and commands, delay and hang: the stepper meets each kind, with memory and without."""


@pytest.mark.parametrize(("controller", "integrator", "names"), [
    pytest.param("rotor_speed_control", "euler", ON_RIGID, id="euler-all_effects"),
    pytest.param("lee_velocity_control", "rk4", ONE_OF_EACH_KIND, id="rk4-each_kind", marks=pytest.mark.slow),
])  # fmt: skip
def test_physics_kernels_compile(controller: str, integrator: str, names: Sequence[str]) -> None:
    robot = ROBOTS.get("base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=2)
    effects = []
    for name in names:
        effect = EFFECTS.get(name)
        effects.append((effect, torch.tensor(effect.neutral(robot)).expand(2, -1).clone()))
    effects.append((LearnedResidual(random_network(16), dtype=torch.float32), torch.ones(2, 1)))
    backend = WarpBackend()
    law = make_controller(CONTROLLERS.get(controller), vehicle, 9.81, dt=0.01)
    backend.allocate(build_model(vehicle, effects, ceiling_height=3.0), law, integrator=integrator)
    compile_for_gpu(backend.kernel.module)


@pytest.mark.slow
def test_the_physics_kernel_of_links_with_effects_compiles() -> None:
    values = {"link_drag": {"qx": 0.1}, "link_buoyancy": {"force": 0.1, "x": 0.01}}
    values |= {"link_added_mass": {"mx": 0.1, "jx": 0.01}}
    robot = replace(ROBOTS.get("morphy_fixed_base"), effects=values, effects_source="test")
    vehicle = vehicle_from_config(robot, num_envs=2)
    effects = robot_effects(robot, num_envs=2, device=torch.device("cpu"), dtype=torch.float32)
    model = build_model(vehicle, effects, articulation=build_articulation(robot, like=vehicle.mass))
    backend = WarpBackend()
    backend.allocate(model, make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81), integrator="euler")
    compile_for_gpu(backend.kernel.module)


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
def test_the_physics_kernel_of_mixed_rotors_compiles(integrator: str) -> None:
    """With ``euler`` it is assembled too: the smallest kernel in which both instructions of inline assembly stand."""
    vehicle = vehicle_from_config(three_type_robot(), num_envs=2)
    backend = WarpBackend()
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
    backend.allocate(build_model(vehicle), law, integrator=integrator)
    compile_for_gpu(backend.kernel.module, assemble=integrator == "euler")


def test_the_physics_kernel_with_contact_compiles() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=2)
    memory = {"contact": torch.zeros(2, dtype=torch.bool), "impulse": torch.zeros(2, 3)}
    ground = Ground(height=0.0, spheres=torch.rand(4, 4), cfg=ContactCfg(friction=0.5), **memory)
    backend = WarpBackend()
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81)
    backend.allocate(build_model(vehicle), law, integrator="euler", ground=ground)
    compile_for_gpu(backend.kernel.module)


def test_the_kernel_of_a_randomised_robot_compiles() -> None:
    small = RandomizeCfg(how="value", low=0.0, high=0.01)
    randomize = {"body.mass": RandomizeCfg(low=0.8, high=1.2), "effects.com_offset.x": small}
    randomize |= {"effects.imu_misalignment.yaw": small}
    env = simulation("base_quadrotor", "lee_velocity_control", randomize=randomize)
    compile_for_gpu(env.robot_manager._update._rows.kernel.module)


@pytest.mark.parametrize(
    "robot",
    ["base_quadrotor", pytest.param("omnidirectional_octarotor", marks=pytest.mark.slow)],  # the same of another size
)
def test_the_kernels_of_an_allocation_in_each_environment_compile(robot: str) -> None:
    randomize = {"rotor.thrust_map": RandomizeCfg(each_rotor=True, low=0.9, high=1.1)}
    randomize["mounts.*.axis"] = RandomizeCfg(each_rotor=True, how="offset", low=-0.1, high=0.1)
    own = replace(ROBOTS.get(robot), control=ControlCfg(effectiveness="actual"))
    manager = simulation(own, "lee_attitude_control", randomize=randomize).robot_manager
    compile_for_gpu(manager._update._rows.kernel.module)
    compile_for_gpu(manager.backend.kernel.module)


def test_the_kernel_of_wakes_compiles() -> None:
    sources = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=2)
    compile_for_gpu(make_wake_kernel(WakeSum(EFFECTS.get("downwash_core")), sources, 2).module)


def test_row_kernels_compile() -> None:
    rows = RowFunction(lambda a: (torch.asin(a).norm(dim=-1), a > 0.0, torch.remainder(a, 2.0)), (torch.rand(2, 3),))
    compile_for_gpu(rows.kernel.module)


@pytest.mark.slow
def test_the_physics_kernel_with_obstacles_that_push_compiles() -> None:
    state = start(2, height=1.0, dtype=torch.float32)
    rig = ObstacleRig([ShapeCfg(kind="plane")], obstacle(2), ContactCfg(friction=0.5), state)
    compile_for_gpu(rig.backend.kernel.module)


@pytest.mark.parametrize(
    ("moves", "cores", "meshes"),
    [pytest.param(True, True, True, marks=pytest.mark.slow), (False, False, False)],
    ids=["largest", "smallest"],
)
def test_the_collision_kernel_compiles(moves: bool, cores: bool, meshes: bool) -> None:
    compile_for_gpu(make_collision_kernel(moves=moves, shared=True, cores=cores, meshes=meshes).module)


@pytest.mark.parametrize(("lanes", "rows"), [(LANES, ROWS), (1, 3)])
def test_the_kernel_of_image_cells_compiles(lanes: int, rows: int) -> None:
    compile_for_gpu(make_pooling_kernel(lanes=lanes, rows=rows).module)


MODULES = (secondary_states, initial_state, imu, draws, sensor_poses, placement, gates, track, obstacle_motion)
MODULES += (clearance, sensor_view, flow, scan, vehicle_collision, start_separation, vehicle_network, payload)


@pytest.mark.parametrize("module", MODULES)
def test_kernels_of_modules_compile(module) -> None:
    compile_for_gpu(wp.get_module(module.__name__))
