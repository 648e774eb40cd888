"""Vehicles that bend on the fused backend, which eliminates link by link, against the torch reference, which factors
the whole mass matrix. Both follow the same equations in different ways. Float32 torch is itself off the float64 result,
so the bound is taken from it: the fused step may be ``FACTOR`` times as far from float64 as float32 torch is, plus a
few units in the last place."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from aerial_gym.config.joint import CreepCfg, DriveCfg, EndsCfg, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.vehicles import BATTERY, CEILING, random_state, strong_effects
from tests.repetitions import frequent_values

FACTOR, ROUND_OFF = 4.0, 4e-6

SLENDER = 20.0
"""In place of ``FACTOR`` where bare effort turns rods about themselves: 6e-5 kg m² beside 0.025 across, whose unit in the
last place is 2.5e-5 of the first. It shows as 90 rad/s at the last rod, on its way into its end."""

NUDGES = (0, 1, -1)
"""Float32 torch flies from starts that differ in the last place: one alone may be lucky where a light rod hits its end."""

NUM_ENVS, DT, SUBSTEPS, STEPS = 24, 0.002, 5, 10


def odd_tree() -> RobotCfg:
    lump = ((4e-5, 1e-6, 0.0), (1e-6, 5e-5, 2e-6), (0.0, 2e-6, 6e-5))
    robot = ROBOTS.get("base_quadrotor")
    ends = EndsCfg(low=-0.2, high=0.3, stiffness=3.0, damping=0.02)

    def joint(
        name: str, parent: str, axis: tuple[float, float, float], at: tuple[float, float, float], **remaining: object
    ):
        return JointCfg(name=name, parent=parent, axis=axis, position=at, initial=(-0.1, 0.1), **remaining)

    def lump_link(*com: float) -> LinkCfg:
        return LinkCfg(mass=0.02, com=(com[0], com[1], com[2]), inertia=lump)

    layout = (
        joint(
            "slide", "base", (0.6, 0.0, 0.8), (0.1, 0.0, 0.02), kind="prismatic", reference=0.01,
            link=lump_link(0.12, 0.01, 0.0), spring=SpringCfg(
                stiffness=8.0, damping=0.05, rest=0.02, friction=0.05, creep=(CreepCfg(stiffness=5.0, time=0.02),)
            ), ends=ends,
        ),
        joint(
            "arm", "slide", (0.0, 1.0, 0.0), (0.13, 0.0, 0.0), reference=0.2, link=lump_link(0.15, 0.0, 0.02),
            drive=DriveCfg(mode="position", stiffness=0.3, damping=0.01, limit=0.05, command_range=(-0.5, 0.5)),
        ),
        joint("hinge", "base", (0.0, 0.0, 1.0), (-0.1, 0.05, 0.0)),
        joint(
            "left", "hinge", (1.0, 0.0, 0.0), (-0.12, 0.05, 0.01), link=lump_link(-0.13, 0.1, 0.0),
            drive=DriveCfg(mode="velocity", damping=0.02, limit=0.03, command_range=(-2.0, 2.0)),
        ),
        joint(
            "right", "hinge", (0.0, 0.8, 0.6), (-0.12, 0.02, -0.01), link=lump_link(-0.15, -0.04, 0.0),
            drive=DriveCfg(mode="effort", limit=0.01, command_range=(-0.01, 0.01)),
            spring=SpringCfg(quadratic=0.3, damping=0.002, preload=0.003, creep=(
                CreepCfg(stiffness=0.05, time=0.01), CreepCfg(stiffness=0.02, time=0.3)
            )),
        ),
    )  # fmt: skip
    first, *further = robot.mounts.layout
    mounts = replace(robot.mounts, layout=(replace(first, link="arm"), *further))
    inertia = ((0.004, 0.0, 0.0), (0.0, 0.005, 0.0), (0.0, 0.0, 0.006))
    body = replace(robot.body, mass=0.33, com=(0.004, -0.003, 0.002), inertia=inertia)
    return replace(robot, body=body, mounts=mounts, joints=JointsCfg(layout=layout, source="test"))


def ground_effect_tree(radius: float = 0.4) -> RobotCfg:
    """That robot with propellers that feel ground and ceiling from afar, one on a link, two on another, one of them tilted."""
    robot = odd_tree()
    first, second, third, fourth = robot.mounts.layout
    third = replace(third, link="left", axis=(0.1, -0.2, 1.0))
    mounts = replace(robot.mounts, layout=(first, replace(second, link="left"), third, fourth))
    rotor = ROBOTS.get("tinyprop").rotor
    return replace(robot, mounts=mounts, rotor=replace(rotor, radius=radius), battery=BATTERY)


def heavier(vehicle: Vehicle) -> Vehicle:
    scale = 1.0 + 0.2 * torch.linspace(0.0, 1.0, NUM_ENVS, dtype=vehicle.mass.dtype)
    scale = scale.repeat(vehicle.num_envs // NUM_ENVS)
    com = vehicle.com + 0.002 * scale.unsqueeze(-1)
    return replace(vehicle, mass=scale * vehicle.mass, inertia=scale[:, None, None] * vehicle.inertia, com=com)


def fly(
    backend: TorchBackend | WarpBackend, robot: RobotCfg, controller: str, dtype: torch.dtype,
    effects: tuple[str, ...], adjust: Callable[[Vehicle], Vehicle], *, nudges: tuple[int, ...] = (0,),
) -> tuple[torch.Tensor, ...]:  # fmt: skip
    """Return the state at the end; the batch flies once for each of ``nudges``, one below the other."""
    copies = len(nudges)
    vehicle = vehicle_from_config(robot, num_envs=copies * NUM_ENVS, dtype=dtype)
    law = make_controller(CONTROLLERS.get(controller), vehicle, 9.81, dt=DT)
    articulation = build_articulation(robot, like=vehicle.mass)
    rows = strong_effects(effects, robot, copies * NUM_ENVS, dtype=dtype)
    model = build_model(adjust(vehicle), rows, ceiling_height=CEILING, articulation=articulation)
    hover = vehicle.speed_high[0, 0].item() * 0.5
    start = random_state(NUM_ENVS, seed=5, rotor_speed=hover)
    gen = torch.Generator().manual_seed(7)

    def draw(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=gen) - 0.5

    joints = articulation.reference.double() + 0.3 * draw(NUM_ENVS, articulation.num_joints)
    speeds = torch.full((NUM_ENVS, vehicle.num_rotors), hover, dtype=torch.float64)
    state = ArticulatedState(
        **{**vars(start), "rotor_speed": speeds}, joint_pos=joints, joint_vel=draw(NUM_ENVS, articulation.num_joints)
    )
    signs = torch.where(draw(NUM_ENVS, 1) > 0.0, 1.0, -1.0) * 2.0**-24
    signs = torch.cat([nudge * signs for nudge in nudges])
    state = replace(
        state, **{name: (tensor.repeat(copies, 1) * (1.0 + signs)).to(dtype) for name, tensor in vars(state).items()}
    )
    random = Randomness(copies * NUM_ENVS)
    random.environment.copy_(torch.arange(NUM_ENVS, dtype=torch.int32).repeat(copies))
    backend.allocate(model, law, integrator="euler", random=random)
    weight = 9.81 * robot.body.mass / vehicle.num_rotors
    for _ in range(STEPS):
        thrusts = 1.5 * weight * (0.5 + draw(NUM_ENVS, len(law.action_names))) if controller == "no_control" else draw(
            NUM_ENVS, len(law.action_names)
        )  # fmt: skip
        command = torch.cat((thrusts, 2.0 * draw(NUM_ENVS, articulation.num_driven)), dim=1).to(dtype)
        backend.step(state, command.repeat(copies, 1), DT, SUBSTEPS)
    return tuple(tensor.double() for tensor in state.tensors())


MADE_HERE = {"odd": odd_tree, "blown": ground_effect_tree, "blown by little": lambda: ground_effect_tree(0.0381)}

AT_HUBS = tuple(
    name for name in EFFECTS if EFFECTS.get(name).at_hubs and EFFECTS.get(name).on_joints and name != "blade_element"
)
"""Effects that act on the links that rotors sit on, but that whose forces grow with the fourth power of the radius."""

CASES = {
    "morphy": ("morphy", "no_control", (), None),
    "morphy on a stand": ("morphy_fixed_base", "no_control", (), None),
    "morphy under a geometric law, all different": ("morphy", "lee_position_control", (), heavier),
    "snake": ("snakey", "no_control", (), None),
    "snake of five, position": ("snakey5_position", "no_control", (), None),
    "snake of six, effort": ("snakey6_effort", "no_control", (), None),
    "everything": ("odd", "no_control", ("quadratic_drag", "constant_wind", "axial_inflow"), heavier),
    "everything, late": ("odd", "lee_velocity_control", ("actuation_delay", "gusts", "rotor_drag"), None),
    "effects at hubs": ("blown", "no_control", (*AT_HUBS, "wind_shear", "link_drag", "rotor_drag"), heavier),
    "blades": ("blown by little", "no_control", ("blade_element", "constant_wind"), None),
    "law with memory": ("odd", "pid_rates_control", ("weak_motor", "com_offset"), None),
}


AS_USERS_HAVE_IT = "everything, late"
"""The one whose kernel is optimised."""


OFTEN = ("everything, late",)
"""The parts of the other cases are its, but for some effects."""


@pytest.mark.parametrize("case", frequent_values(CASES, OFTEN))
def test_the_fused_step_is_that_of_the_reference(case: str, request: pytest.FixtureRequest) -> None:
    if case == AS_USERS_HAVE_IT:
        request.getfixturevalue("optimise_kernels")
    name, controller, effects, adjust = CASES[case]
    robot = MADE_HERE[name]() if name in MADE_HERE else ROBOTS.get(name)
    same = adjust or (lambda vehicle: vehicle)
    exact = fly(TorchBackend(), robot, controller, torch.float64, effects, same)
    singles = fly(TorchBackend(), robot, controller, torch.float32, effects, same, nudges=NUDGES)
    fused = fly(WarpBackend(), robot, controller, torch.float32, effects, same)
    for right, own, roughs in zip(exact, fused, singles, strict=True):
        size = right.abs().max().clamp_min(1.0)
        away = (roughs.view(-1, *right.shape) - right).abs().max()
        allowed = (SLENDER if case == "snake of six, effort" else FACTOR) * away + ROUND_OFF * size
        assert bool(right.isfinite().all())
        assert float((own - right).abs().max()) <= float(allowed)


def test_a_differentiable_fused_rollout_moves_no_joints() -> None:
    robot = ROBOTS.get("morphy")
    with pytest.raises(CapabilityError, match="a differentiable rollout moves no joints"):
        fly(WarpBackend(differentiable=True), robot, "no_control", torch.float32, (), lambda vehicle: vehicle)


def test_an_environment_of_bending_robots_among_obstacles_sees_the_ground_and_ends_there() -> None:
    env = simulation(
        replace(ROBOTS.get("morphy"), sensors=("coarse_depth_camera", "base_imu")), sim="base_sim_2ms",
        env="forest_env", num_envs=4, seed=1,
    )  # fmt: skip
    env.reset()
    touched = torch.zeros(4, dtype=torch.bool)
    for _ in range(400):
        env.step(torch.zeros(4, 4))
        touched |= env.gtd["crashes"]
    assert bool(touched.all())
    assert bool(env.gtd["dof_position"].isfinite().all())
