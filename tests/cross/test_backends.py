"""The fused Warp backend against the torch reference. Both follow the same equations; what may differ is round-off.
Float32 torch is itself off the float64 result by some amount that grows with the flight (a clamped rotor amplifies it),
so the bound is taken from it: the fused step may be at most ``FACTOR`` times as far from float64 as float32 torch is,
plus a few units in the last place."""

from collections.abc import Sequence
from dataclasses import replace
from math import exp
from typing import Literal

import pytest
import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.catalog import AERIAL_GYM_GAINS
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, Model, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.effects import EffectsByKind, WrenchEffect
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import CEILING, ON_RIGID, asymmetric_robot, random_state, strong_effects
from tests.repetitions import rare_values, thin_values

FACTOR = 4.0
ROUND_OFF = 2e-6
"""About 16 units in the last place of float32, for values of order one."""

NUDGES = 3
"""Float32 torch flies so often, from starts that differ in the last place: one flight alone may be lucky with its rounding."""

DT, SUBSTEPS, STEPS = 0.004, 5, 10
"""0.2 s of flight: three to twenty time constants of the rotors. A parameter of an effect that is 1 % off, alone, is ten times
the bound at least."""

LONG = 25
"""For joint creep, which is slow: there 0.7 % are the bound."""


def build(robot, controller: ControllerCfg, num_envs: int, dtype: torch.dtype, effects=(), adjust=None, copies=1):
    """Return model and controller of a robot with effects at a moderate size, for a batch and its copies below it."""
    vehicle: Vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=dtype)
    declared = vehicle_from_config(robot, num_envs=copies * num_envs, dtype=dtype)
    if adjust is not None:
        rows = adjust(vehicle).tensors_by_name().items()
        vehicle = replace(declared, **{name: tensor.repeat(copies, *[1] * (tensor.dim() - 1)) for name, tensor in rows})
    else:
        vehicle = declared
    rows = strong_effects(effects, robot, copies * num_envs, dtype=dtype)
    ceiling = (
        {"ceiling_height": CEILING} if any("ceiling_effect" in name for name in effects) else {}
    )  # a number in the kernel's source
    return build_model(vehicle, rows, **ceiling), make_controller(controller, declared, 9.81, dt=DT)


def random_actions(controller, model: Model, num_envs: int) -> Tensor:
    g = torch.Generator().manual_seed(3)
    draw = torch.rand(num_envs, len(controller.action_names), dtype=torch.float64, generator=g)
    first = controller.action_names[0]
    vehicle = model.vehicle
    if first.startswith("thrust 1"):
        return draw * 2.0 * 9.81 * vehicle.mass[:1].double() / vehicle.num_rotors
    if first.startswith("speed"):
        return vehicle.speed_high[:1].double() * (0.3 + 0.4 * draw)
    return draw - 0.5


def start_state(model: Model, num_envs: int) -> BodyState:
    hover = model.vehicle.speed_high[0, 0].item() * 0.5
    state = random_state(num_envs, seed=5, rotor_speed=hover)
    if model.vehicle.num_rotors != 4:
        speeds = torch.full((num_envs, model.vehicle.num_rotors), hover, dtype=torch.float64)
        state = replace(state, rotor_speed=speeds)
    return state


def fly(
    backend, robot, controller, integrator, dtype, *, effects=(), adjust=None, num_envs=16, follow=None, size=1.0,
    steps=STEPS, nudges=(0,),
) -> list[BodyState]:  # fmt: skip
    """Return the state after every step; with ``follow`` each step starts from the state before it there. The batch flies
    once for each of ``nudges``, one below the other: a nudge above 0 moves the start, and what is followed, by a unit in the
    last place at most, each number another way."""
    copies = len(nudges)
    model, law = build(robot, controller, num_envs, dtype, effects, adjust, copies)
    random = Randomness(copies * num_envs)
    random.environment.copy_(torch.arange(num_envs, dtype=torch.int32).repeat(copies))
    backend.allocate(model, law, integrator=integrator, random=random)
    actions = (size * random_actions(law, model, num_envs).to(dtype)).repeat(copies, 1)
    state, result = perturb(as_type(start_state(model, num_envs), dtype), nudges), []
    for step in range(steps):
        if follow is not None and step > 0:
            state.copy_(perturb(as_type(follow[step - 1], dtype), nudges))
        backend.step(state, actions, DT, SUBSTEPS)
        result.append(as_type(state, dtype))
    return result


def perturb(state: BodyState, nudges: Sequence[int]) -> BodyState:
    parts: dict[str, list[Tensor]] = {name: [] for name in vars(state)}
    for nudge in nudges:
        g = torch.Generator().manual_seed(nudge)
        unit = torch.finfo(torch.float32).eps if nudge else 0.0
        for name, tensor in vars(state).items():
            away = torch.randint(-1, 2, tensor.shape, generator=g).to(tensor.dtype)
            parts[name].append(tensor * (1.0 + unit * away))
    return BodyState(**{name: torch.cat(copies) for name, copies in parts.items()})


def as_type(state: BodyState, dtype: torch.dtype) -> BodyState:
    return BodyState(**{name: tensor.to(dtype, copy=True) for name, tensor in vars(state).items()})


def assert_agreement(exact: BodyState, singles: BodyState, fused: BodyState) -> None:
    """Compare with flights in float32, which stand one below the other."""
    for name, truth in vars(exact).items():
        size = 1.0 + truth.abs().max()
        away = (getattr(singles, name).view(-1, *truth.shape) - truth).abs().max()
        allowed = FACTOR * away / size + ROUND_OFF
        error = (getattr(fused, name) - truth).abs().max() / size
        assert error <= allowed, f"{name}: {error:.2e} from float64, allowed {allowed:.2e}"
        assert allowed < 1e-2, f"{name}: float32 says nothing about this flight"


def assert_same_flight(robot, controller, integrator, *, steps_alone: bool = False, **options) -> None:
    """Compare at the end of a flight, or, where a flight is chaotic, each step of it from the same state."""
    exact = fly(TorchBackend(), robot, controller, integrator, torch.float64, **options)
    follow = exact if steps_alone else None
    options = {"follow": follow, **options}
    singles = fly(TorchBackend(), robot, controller, integrator, torch.float32, nudges=range(NUDGES), **options)
    fused = fly(WarpBackend(), robot, controller, integrator, torch.float32, **options)
    for step in range(STEPS) if steps_alone else (-1,):
        assert_agreement(exact[step], singles[step], fused[step])


SEEN_ELSEWHERE = (
    *(f"lee_{law}_control" for law in ("velocity", "acceleration", "attitude")),
    *(f"pid_{law}_control" for law in ("acceleration", "attitude")),
)
"""Laws that are compared below, beyond their limits, and laws that are parts of those that are compared always."""

ONE_OF_EACH_KIND = ("no_control", "lee_position_control", "pid_velocity_control")
"""Thrusts, a law, and a law with memory. The kernel asks the law once in a substep, before the stepper."""


@pytest.mark.parametrize(
    ("controller", "integrator"),
    rare_values(
        [(name, "euler") for name in CONTROLLERS.names() if CONTROLLERS.get(name).gains is None],
        [(name, "euler") for name in CONTROLLERS.names() if CONTROLLERS.get(name).autopilot or name in SEEN_ELSEWHERE],
    )
    + [
        pytest.param(name, integrator, marks=pytest.mark.slow)
        for name in ONE_OF_EACH_KIND
        for integrator in INTEGRATORS
        if integrator != "euler"
    ],
)
def test_every_controller_and_stepper_flies_like_torch(
    controller: str, integrator: str, request: pytest.FixtureRequest
) -> None:
    """Those of autopilots fly so with all that they have in ``unit/control/test_cascade.py``."""
    if controller in ONE_OF_EACH_KIND:
        request.getfixturevalue("optimise_kernels")
    robot = "base_octarotor" if CONTROLLERS.get(controller).law == "pose" else "tinyprop"
    assert_same_flight(ROBOTS.get(robot), CONTROLLERS.get(controller), integrator)


@pytest.mark.parametrize("robot", thin_values(ROBOTS.names(), 6))
def test_every_robot_flies_like_torch(robot: str) -> None:
    assert_same_flight(ROBOTS.get(robot), CONTROLLERS.get("no_control"), "euler")


@pytest.mark.parametrize("law", ["position", "velocity", "acceleration", "attitude"])
def test_commands_beyond_the_limits_are_limited_like_torch(law: str) -> None:
    controller = CONTROLLERS.get(f"lee_{law}_control")
    assert_same_flight(ROBOTS.get("tinyprop"), controller, "euler", steps_alone=True, size=20.0)


@pytest.mark.parametrize("rate", [10.0, 240.0, 260.0, 1500.0])
def test_turns_of_any_size_in_one_step_are_like_torch(rate: float) -> None:
    """Spins of up to 6 rad in a step of 4 ms: on both sides of 1 rad, where the series gives way to sine and cosine."""
    robot, controller = ROBOTS.get("base_quadrotor"), CONTROLLERS.get("rotor_speed_control")
    ends = []
    for backend, dtype in ((TorchBackend(), torch.float64), (WarpBackend(), torch.float32)):
        model, law = build(robot, controller, 16, dtype)
        backend.allocate(model, law, integrator="euler")
        state = start_state(model, 16)
        state = as_type(replace(state, ang_vel=rate * torch.nn.functional.normalize(state.ang_vel, dim=-1)), dtype)
        backend.step(state, torch.zeros(16, 4, dtype=dtype), DT, 1)
        ends.append(state.attitude.double())
    torch.testing.assert_close(ends[1], ends[0], rtol=0.0, atol=1e-6 * max(1.0, rate * DT))


def test_a_load_hangs_the_same_where_the_stages_of_a_step_are_no_unit_quaternions() -> None:
    """At 60 rad/s the middle of a step of 20 ms has ``|q|² = 1.09``: formulas that agree for unit quaternions do not there."""
    robot, controller, dt = asymmetric_robot(), CONTROLLERS.get("rotor_speed_control"), 0.02
    ends = []
    for backend, dtype in ((TorchBackend(), torch.float64), (WarpBackend(), torch.float32)):
        model, law = build(robot, controller, 16, dtype, ("slung_payload",))
        backend.allocate(model, law, integrator="rk4")
        state = start_state(model, 16)
        state = as_type(replace(state, ang_vel=60.0 * torch.nn.functional.normalize(state.ang_vel, dim=-1)), dtype)
        backend.step(state, torch.full((16, 4), 800.0, dtype=dtype), dt, 1)
        ends.append(state)
    for name, expected in vars(ends[0]).items():
        atol = ROUND_OFF * (1.0 + expected.abs().max().item())
        torch.testing.assert_close(getattr(ends[1], name).double(), expected, rtol=0.0, atol=atol)


@pytest.mark.parametrize("integrator", list(INTEGRATORS))
def test_rotors_stand_still_as_near_to_their_command_as_a_step_of_float32_allows(integrator: str) -> None:
    """Where ``(1 - exp(-dt / tau)) d`` is below half a unit in the last place of the speed, d cannot shrink."""
    tau = 0.05
    robot = asymmetric_robot()
    robot = replace(robot, rotor=replace(robot.rotor, time_constant_up=tau, time_constant_down=tau))
    model, law = build(robot, CONTROLLERS.get("rotor_speed_control"), 16, torch.float32)
    backend = WarpBackend()
    backend.allocate(model, law, integrator=integrator)
    state, command = as_type(start_state(model, 16), torch.float32), torch.full((16, 4), 900.0)
    backend.step(state, command, DT, 500)  # 2 s
    unit = 512.0 * torch.finfo(torch.float32).eps
    stall = 0.5 * unit / (1.0 - exp(-DT / tau))
    assert (state.rotor_speed - command).abs().max() <= stall + unit


def test_a_thrust_map_with_an_offset_is_inverted_like_torch() -> None:
    """Thrust at rest differs from zero: the vertex of the map is not at the origin."""
    robot = asymmetric_robot()
    offset = replace(robot, rotor=replace(robot.rotor, thrust_map=(0.05, 1e-4, 3e-6), thrust_range=(0.1, 8.0)))
    assert_same_flight(offset, CONTROLLERS.get("no_control"), "euler")


@pytest.mark.parametrize("allocation", ["clamp", "prioritised"])
def test_a_flight_that_amplifies_round_off_is_the_same_step_by_step(
    allocation: Literal["clamp", "prioritised"],
) -> None:
    """The gains of a heavier vehicle make the Crazyflie switch between its limits: a chaotic flight, clamped or prioritised."""
    robot, controller = ROBOTS.get("crazyflie_21_brushless"), CONTROLLERS.get("lee_velocity_control")
    controller = replace(controller, gains=AERIAL_GYM_GAINS, allocation=allocation)
    assert_same_flight(robot, controller, "euler", steps_alone=True)


GROUPS = 6
"""Of effects that fly at once in every run; each flies alone with ``make test-slow``.

Among others 1 % off is ten times the bound as well, but for the damping of a load (2.4 times), the correlation time of gusts
(6), the exponent of a shear (5), the time of soft arms (8) and both numbers of creeping ones, of which 1 % is just seen. What
sensors or logs have (``imu_*``, ``rotor_speed_scale``) moves no state."""


@pytest.mark.parametrize(
    "effects",
    [
        *(ON_RIGID[first::GROUPS] for first in range(GROUPS)),
        *(pytest.param((effect,), marks=pytest.mark.slow) for effect in ON_RIGID),
    ],
    ids="+".join,
)
def test_every_effect_flies_like_torch(effects: tuple[str, ...]) -> None:
    robot, steps = asymmetric_robot(), LONG if "joint_creep" in effects else STEPS
    together = tuple(dict.fromkeys((*effects, "rotor_drag")))
    assert_same_flight(robot, CONTROLLERS.get("rotor_speed_control"), "rk4", effects=together, steps=steps)


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
def test_all_effects_at_once_fly_like_torch() -> None:
    robot = asymmetric_robot()
    assert_same_flight(robot, CONTROLLERS.get("rotor_speed_control"), "euler", effects=ON_RIGID)


@pytest.mark.usefixtures("optimise_kernels")
def test_rotors_that_all_thrust_along_body_z_fly_like_torch() -> None:
    """The kernel leaves out what is zero then; levers differ in all directions, and rotors in spin."""
    robot = asymmetric_robot()
    upright = tuple(replace(mount, axis=(0.0, 0.0, 1.0)) for mount in robot.mounts.layout)
    robot = replace(robot, mounts=replace(robot.mounts, layout=upright))
    effects = (
        "h_force_flapping", "rotor_inertia", "axial_inflow", "translational_lift", "ground_effect", "ceiling_effect",
    )  # fmt: skip
    assert vehicle_from_config(robot, num_envs=2).upright
    assert not vehicle_from_config(asymmetric_robot(), num_envs=2).upright
    assert_same_flight(robot, CONTROLLERS.get("rotor_speed_control"), "euler", effects=effects)


def scale_by_env(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle of which every parameter differs between environments."""

    def scale_rows(rows: Tensor, by: float) -> Tensor:
        steps = torch.linspace(0.9, 1.1, rows.shape[0], dtype=rows.dtype)
        return rows * (1.0 + by * (steps - 1.0)).view(-1, *([1] * (rows.dim() - 1)))

    changes = {
        k: scale_rows(v, 1.0) for k, v in vehicle.tensors_by_name().items() if k not in ("rotor_axis", "rotor_spin")
    }
    changes["com"] = changes["com"] + 0.01
    return replace(vehicle, **changes, rotor_axis=vehicle.rotor_axis.clone(), rotor_spin=vehicle.rotor_spin.clone())


@pytest.mark.parametrize("controller", ["rotor_speed_control", "lee_velocity_control"])
def test_parameters_of_each_environment_are_read(controller: str) -> None:
    assert_same_flight(asymmetric_robot(), CONTROLLERS.get(controller), "euler", adjust=scale_by_env)


def test_gains_of_each_environment_are_read() -> None:
    cfg = CONTROLLERS.get("lee_position_control")
    cfg = replace(cfg, gains=AERIAL_GYM_GAINS, allocation="clamp")
    robot, ends = ROBOTS.get("base_quadrotor"), []
    for backend, dtype in ((TorchBackend(), torch.float32), (WarpBackend(), torch.float32)):
        model, law = build(robot, cfg, 8, dtype)
        law.own_gains()
        backend.allocate(model, law, integrator="euler")
        state = BodyState(**{k: v.to(dtype) for k, v in vars(start_state(model, 8)).items()})
        actions = torch.zeros(8, 4)
        backend.step(state, actions, DT, 1)  # with the middle gains
        mask = torch.ones(8, dtype=torch.bool)
        for k, rows in enumerate(law.gains_by_name.values()):
            rows *= torch.linspace(0.8, 1.2, 24).roll(5 * k).view(8, 3)
        backend.reset_memory(mask)
        backend.step(state, actions, DT, SUBSTEPS)
        ends.append(state)
    torch.testing.assert_close(ends[1].ang_vel, ends[0].ang_vel, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("change", ["shared mass", "mass per environment", "centre of mass", "effect in place"])
def test_changed_parameters_are_taken(change: str) -> None:
    robot, controller = ROBOTS.get("tinyprop"), CONTROLLERS.get("rotor_speed_control")
    results = []
    for backend in (TorchBackend(), WarpBackend()):
        model, law = build(robot, controller, 4, torch.float32, effects=("rotor_drag",))
        vehicle, (effect, params) = model.vehicle, model.effects[WrenchEffect][0]
        changed = {
            "shared mass": {"mass": vehicle_with_mass(model, 2.0)},
            "mass per environment": {"mass": vehicle.mass * torch.tensor([1.0, 1.5, 2.0, 0.5])},
            "centre of mass": {"com": torch.tensor([0.02, -0.01, 0.03]).as_strided((4, 3), (0, 1))},
            "effect in place": {},
        }[change]
        backend.allocate(model, law, integrator="euler")
        state = as_type(start_state(model, 4), torch.float32)
        actions = random_actions(law, model, 4).float()
        backend.step(state, actions, DT, 1)
        if change == "effect in place":
            params.mul_(3.0)
        vehicle = replace(vehicle, **changed)
        other = build_model(vehicle, [(effect, params)])
        backend.set_model(other)
        backend.step(state, actions, DT, 10)
        results.append(torch.cat(state.tensors(), dim=-1))
    torch.testing.assert_close(results[1], results[0], rtol=2e-5, atol=2e-5)


def vehicle_with_mass(model: Model, factor: float) -> Tensor:
    mass = model.vehicle.mass
    return (factor * mass[:1]).as_strided(mass.shape, (0,))


class LawWithBranch:
    """A control law with a branch on a value."""

    action_names = ("nothing",)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        return action if action[0, 0] > 0.0 else -action


def test_what_it_cannot_run_is_refused_by_name() -> None:
    robot = ROBOTS.get("tinyprop")
    model, law = build(robot, CONTROLLERS.get("no_control"), 2, torch.float32)
    with pytest.raises(CapabilityError, match=r"no integrator 'rk5'. Known: euler, rk4"):
        WarpBackend().allocate(model, law, integrator="rk5")
    with pytest.raises(CapabilityError, match=r"LawWithBranch.rotor_command: .*action\[0, 0\] > 0.0.*torch.where"):
        WarpBackend().allocate(model, LawWithBranch(), integrator="euler")
    doubles, law64 = build(robot, CONTROLLERS.get("no_control"), 2, torch.float64)
    with pytest.raises(CapabilityError, match=r"float32 only, not torch.float64"):
        WarpBackend().allocate(doubles, law64, integrator="euler")

    class TorchEffect(WrenchEffect):
        name = "untwinned"
        parameters = EFFECTS.get("rotor_drag").parameters

        def wrench(self, condition, params):
            raise NotImplementedError

    strange = replace(model, effects=EffectsByKind(((TorchEffect(), torch.zeros(2, 3)),)))
    with pytest.raises(CapabilityError, match="untwinned: NotImplementedError"):
        WarpBackend().allocate(strange, law, integrator="euler")


def test_tensors_that_do_not_fit_are_refused() -> None:
    model, law = build(ROBOTS.get("tinyprop"), CONTROLLERS.get("no_control"), 2, torch.float32)
    backend = WarpBackend()
    backend.allocate(model, law, integrator="euler")
    state = BodyState(**{k: v.float() for k, v in vars(start_state(model, 2)).items()})
    with pytest.raises(ShapeError, match=r"command is \(2, 3\).*expected \(2, 4\)"):
        backend.step(state, torch.zeros(2, 3), DT, 1)
