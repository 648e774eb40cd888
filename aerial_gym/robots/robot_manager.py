"""The robot of every environment: its parameters, controller, physics and reset.

Letters: E environments, R rotors, P parameters of an effect, U entries of an action.
"""

from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import Controller, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.interop import with_usual_settings
from aerial_gym.interop.rows import RowUpdate
from aerial_gym.math.random import Randomness, copy_mask
from aerial_gym.physics import PhysicsBackend, Vehicle, build_model, vehicle_from_config
from aerial_gym.physics.capabilities import choose_backend, robot_needs
from aerial_gym.physics.effects import EffectsByKind, ImuEffect
from aerial_gym.physics.effects.sensor_errors import WIDTH, imu_errors
from aerial_gym.physics.effects.wakes import WakeSum, hold_wake
from aerial_gym.physics.model import Model, check_effects, load_articulation, robot_effects
from aerial_gym.physics.rotors import hover_speed
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.torch_backend import TorchBackend
from aerial_gym.physics.vehicle import is_shared, own_rows
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.registry.state import add_prefix
from aerial_gym.robots import state_keys
from aerial_gym.robots.contact_sources import ContactSources, Surroundings
from aerial_gym.robots.differentiable import DifferentiableBackend
from aerial_gym.robots.finite_watch import NonFiniteRows
from aerial_gym.robots.initial_state import ActionStore, InitialState
from aerial_gym.robots.parameter_draws import draw_code
from aerial_gym.robots.robot_draws import DrawResult, RobotDraws, add_effects_to_randomise, check_base_draws


@with_usual_settings
class RobotManager:
    """Owns the robot's tensors in the GTD."""

    def __init__(
        self, robot: RobotCfg, controller: ControllerCfg, sim: SimCfg, gtd: GlobalTensorDictionary,
        around: Surroundings, *, root_state: Tensor, random: Randomness, gradients: torch.dtype | None = None,
        randomize: Randomize | None = None,
    ) -> None:  # fmt: skip
        """Build vehicle and controller, declare the tensors and hand everything to the backend.

        Args:
            root_state: This robot's row of ``vec_root_tensor``, (E, 13).
            gradients: Float type of the motion through which gradients flow; None where they do not.
        """
        robot = add_effects_to_randomise(robot, randomize or {})
        self.cfg, self._sim, self._gtd, self._random, self._around = robot, sim, gtd, random, around
        check_effects(robot)
        self._num_envs = root_state.shape[0]
        self.declared: Vehicle = vehicle_from_config(robot, num_envs=self._num_envs, device=gtd.device)
        self._effects = robot_effects(robot, num_envs=self._num_envs, device=gtd.device, dtype=root_state.dtype)
        if around.several_vehicles:
            self._effects = [hold_wake(*each) for each in self._effects]
        self.com = torch.zeros(self._num_envs, 3, device=gtd.device)
        """Centre of mass from the body origin [m], body, (E, 3)."""
        self.articulation = load_articulation(robot, like=root_state)
        """Joints of the robot; None for a rigid one."""
        pushed = around.contact is not None
        asked = {
            "integrator": sim.integrator,
            "contact": pushed,
            "contact_of_links": pushed and robot.joints is not None,
        }
        if gradients is not None:
            asked |= {"gradients": True, "dtype": gradients}
        self.backend: PhysicsBackend = choose_backend(sim.backend, needs=robot_needs(robot, gtd.device, **asked))
        self.controller: Controller = make_controller(
            controller, self.declared if gradients is None else self.declared.to_dtype(gradients), sim.gravity, dt=sim.dt,
            control=robot.control,
        )  # fmt: skip
        gtd.define_size("U", len(self.action_names))
        self.tensors: state_keys.RobotTensors = state_keys.declare_robot_tensors(gtd, root_state, robot.joints)
        self.differentiable: DifferentiableBackend | None = None
        if gradients is not None:
            if not isinstance(self.backend, TorchBackend):
                raise CapabilityError(f"{type(self.backend).__name__}: gradients need backend 'torch'. Choose it")
            state, actions = self.tensors.state, (self.tensors.actions, self.tensors.prev_actions)
            self.backend = self.differentiable = DifferentiableBackend(state, actions, dtype=gradients)
        self._declare_model()
        self.wakes = [(effect, params) for effect, params in self._effects if isinstance(effect, WakeSum)]
        """Wakes of other vehicles that act on this robot, with their parameters; none for one vehicle."""
        self._randomized = self._declare_draws(randomize or {})
        self._stale = False
        drawn = [] if self._randomized is None else self._randomized.random_effects
        state_keys.watch_parameter_writes(gtd, self._effects, drawn, notice=self._note_write)
        self._pushing = ContactSources(robot, gtd, around)
        self._load = state_keys.make_slung_load(gtd, self._effects, self.tensors.state)
        limited = self.articulation is not None and self.articulation.solves_limits
        efforts = state_keys.declare_efforts(gtd, robot.joints) if limited and robot.joints is not None else None
        self.backend.allocate(
            self._build_model(),
            self.controller,
            integrator=sim.integrator,
            ground=self._pushing.make_ground(),
            hook=self._pushing.make_hook(self.tensors.state, sim, mass=self._mass, inertia=self._inertia, com=self.com),
            random=random,
            efforts=efforts,
        )
        self.backend.prepare(sim.dt)
        rest_speed = hover_speed(self.declared.to_device("cpu"), sim.gravity).to(gtd.device)
        self.tensors.state.rotor_speed.copy_(rest_speed)
        self.noticed = NonFiniteRows.from_gtd(gtd)
        """Rows that were not finite."""
        self._initial = InitialState(
            robot.initial_state, self.tensors.state, self.tensors.derived, bounds=around.bounds,
            rest_speed=rest_speed, actions=self.tensors.actions, prev_actions=self.tensors.prev_actions,
            random=random, noticed=self.noticed,
        )  # fmt: skip
        self._joints: state_keys.JointStates | None = None
        if robot.joints is not None:
            assert isinstance(self.tensors.state, ArticulatedState)
            self._joints = state_keys.JointStates(robot.joints, gtd, self.tensors.state, random, efforts)
        self._update = self._make_update()
        self._step_begin = ActionStore(self.tensors.actions, self.tensors.prev_actions, self.noticed)

    def _declare_model(self) -> None:
        """Declare the parameters of vehicle and effects that differ between environments."""
        gtd = self._gtd
        self._mass = gtd.declare(TensorSpec(
            key="robot_mass", shape=("E",), unit="kg", frame="-", owner="robot", meaning="true mass"
        ))  # fmt: skip
        self._inertia = gtd.declare(TensorSpec(
            key="robot_inertia", shape=("E", 3, 3), unit="kg m²", frame="body", owner="robot",
            meaning="true inertia about the centre of mass",
        ))  # fmt: skip
        for i, (effect, params) in enumerate(self._effects):
            names = ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in effect.parameters)
            spec = TensorSpec(
                key=f"effect_{effect.name}", shape=("E", params.shape[1]), unit="see meaning", frame="-", owner="robot",
                meaning=f"parameters {names}",
            )  # fmt: skip
            stored = gtd.declare(spec)
            stored.copy_(params)
            self._effects[i] = (effect, stored)
        self.imu_errors: Tensor | None = None
        """Errors of inertial sensors by effects, (E, 24), see ``physics.effects.sensor_errors``; None without such effects."""
        if any(isinstance(effect, ImuEffect) for effect, _ in self._effects):
            self.imu_errors = gtd.declare(TensorSpec(
                key="robot_imu_errors", shape=("E", WIDTH), unit="m/s², rad/s, -", frame="body", owner="robot",
                meaning="measured = A true + b of specific force and angular velocity: b and columns of A of each",
            ))  # fmt: skip
        scene, gradients = self._around.scene, self.differentiable is not None
        obstacles = scene is not None and scene.num_instances > 0
        self.felt = state_keys.declare_effect_scene(gtd, self._effects, obstacles=obstacles, gradients=gradients)

    def _note_write(self) -> None:
        self._stale = True

    def take_writes(self) -> bool:
        """Apply parameters written since the last step; return whether tensors moved, as ``refresh_model``."""
        return self._stale and self.refresh_model()

    @property
    def action_names(self) -> tuple[str, ...]:
        """Meaning and unit of each action entry: the controller's, then commands of joint drives."""
        joints = () if self.articulation is None else self.articulation.action_names
        return (*self.controller.action_names, *joints)

    @property
    def num_actions(self) -> int:
        """Width U of an action."""
        return len(self.action_names)

    def _declare_draws(self, cfg: Randomize) -> RobotDraws | None:
        """Return the layout of the random quantities and declare their numbers; None without any."""
        if not cfg:
            return None
        gains = self.controller.gains_by_name
        randomized = RobotDraws(cfg, self.cfg, self.declared, self._effects, gains)
        if self.articulation is not None:
            check_base_draws(randomized, self.articulation, [params for _, params in self._effects])
        if randomized.random_gains:
            self.controller.own_gains()  # pyright: ignore[reportAttributeAccessIssue] - every controller with gains has it
        names = ", ".join(f"{each.name} ({each.cfg.how})" for each in randomized.drawn)
        self._values = self._gtd.declare(TensorSpec(
            key="drawn_parameters", shape=("E", randomized.width), unit="see draws()", frame="-", owner="robot",
            meaning=f"draws of the episode: {names}",
        ))  # fmt: skip
        randomized.fill_neutral(self._values)
        return randomized

    def draws(self) -> dict[str, Tensor]:
        """Return the draws of the present episodes by quantity, (E, ...)."""
        return {} if self._randomized is None else self._randomized.draws_by_name(self._gtd["drawn_parameters"])

    def _parameter_sources(self) -> tuple[Tensor, ...]:
        """Return the inputs of each environment's parameters: draws, effect parameters and the scene that effects read."""
        drawn = () if self._randomized is None else (self._values,)
        return (*drawn, *(params for _, params in self._effects), *self.felt.sources)

    def _make_model(self, *sources: Tensor, declared: Vehicle | None = None) -> tuple[Model, DrawResult]:
        """Return the model and the drawn values, by torch functions on the rows of ``_parameter_sources`` and ``declared``."""
        rest = list(sources)
        values = rest.pop(0) if self._randomized is not None else None
        felt = self.felt.pop_rows(rest)
        followed = DrawResult(vehicle=self.declared, params=tuple(rest), gains={})
        if self._randomized is not None and values is not None:
            followed = self._randomized.apply_draws(values, *rest, vehicle=declared)
        model = build_model(
            followed.vehicle,
            [(effect, params) for (effect, _), params in zip(self._effects, followed.params, strict=True)],
            gravity=self._sim.gravity,
            ground_height=(self._around.ground_height or 0.0) if felt.surface_height is None else felt.surface_height,
            ceiling_height=self._around.ceiling_height,
            other_position=felt.other_position,
            articulation=self.articulation,
        )
        return model, followed

    def _build_model(self) -> Model:
        """Return the model of all environments with tensors of its own, and write the parameters that other parts hold."""
        model, followed = self._make_model(*self._parameter_sources(), declared=self.declared)
        if self._allocation is not None:
            self._allocation.follow(model.vehicle)
        for target, rows in zip(self._tensors_written_by_draws(), self._rows_of_draws(model, followed), strict=True):
            target.copy_(rows)
        if self.imu_errors is not None:
            exact = [(effect, params.double()) for effect, params in model.effects[ImuEffect]]
            self.imu_errors.copy_(imu_errors(exact))
        effects = EffectsByKind(self._effects)  # which the model keeps reading
        declared = self.declared.tensors_by_name()
        changed = {name: rows for name, rows in model.vehicle.tensors_by_name().items() if rows is not declared[name]}
        own = {id(rows): own_rows(rows) for rows in changed.values()}  # a tensor with two names stays one tensor
        vehicle = replace(model.vehicle, **{name: own[id(rows)] for name, rows in changed.items()})
        inverse = own_rows(model.inertia_inverse) if "inertia" in changed else model.inertia_inverse
        self.model = replace(model, vehicle=vehicle, inertia_inverse=inverse, effects=effects)
        self._mass.copy_(model.vehicle.mass)
        self._inertia.copy_(model.vehicle.inertia)
        self.com.copy_(model.vehicle.com)
        return self.model

    @property
    def _allocation(self) -> Allocation | None:
        """The allocation of the controller, if it has one."""
        return getattr(self.controller, "allocation", None)

    @property
    def _draws_imu_errors(self) -> bool:
        drawn = [] if self._randomized is None else self._randomized.random_effects
        return any(isinstance(self._effects[i][0], ImuEffect) for i in drawn)

    def _rows_of_draws(self, model: Model, followed: DrawResult) -> list[Tensor]:
        """Return allocation, parameters of effects, gains and errors of inertial sensors that follow from draws."""
        tensors = [] if self._allocation is None else [*self._allocation.compute_rows(model.vehicle).values()]
        if self._randomized is not None:
            tensors += [followed.params[i] for i in self._randomized.random_effects]
            tensors += [followed.gains[name] for name in self._randomized.random_gains]
        if self._draws_imu_errors:
            tensors.append(imu_errors(model.effects[ImuEffect]))
        return tensors

    def _tensors_written_by_draws(self) -> list[Tensor]:
        """Return the tensors that receive the results of ``_rows_of_draws``, in that order."""
        tensors = [] if self._allocation is None else [*self._allocation.rows.values()]
        if self._randomized is not None:
            tensors += [self._effects[i][1] for i in self._randomized.random_effects]
            tensors += [self.controller.gains_by_name[name] for name in self._randomized.random_gains]
        if self.imu_errors is not None and self._draws_imu_errors:
            tensors.append(self.imu_errors)
        return tensors

    def _make_update(self) -> RowUpdate | None:
        """Return the launch that draws parameters and initial state for a mask; None without random parameters."""
        if self._randomized is None:
            return None

        def rows(*sources: Tensor, declared: Vehicle | None = None) -> tuple[Tensor, ...]:
            model, followed = self._make_model(*sources, declared=declared)
            shown = (getattr(model.vehicle, name) for name in own)
            follows = (rows.to(dtype) for rows, dtype in zip(self._rows_of_draws(model, followed), types, strict=True))
            return (*shown, *follows, *self.backend.parameter_rows(model))

        shown = {"mass": self._mass, "inertia": self._inertia, "com": self.com}
        own = [name for name in shown if not is_shared(getattr(self.model.vehicle, name))]
        drawn = self._tensors_written_by_draws()
        types = [target.dtype for target in drawn]
        targets = (*(shown[name] for name in own), *drawn, *self.backend.parameter_targets())
        return RowUpdate(
            rows, self._parameter_sources(), targets, mask=self._random.mask,
            made=draw_code(self._randomized.drawn, self._random, device=self._gtd.device), beside=self._initial.work,
            plain=partial(rows, declared=self.declared),
        )  # fmt: skip

    def refresh_model(self) -> bool:
        """Apply parameters written by DLPack or a kernel to the physics; ``step`` does so after other writes.

        Return whether tensors of the physics moved, so that a CUDA graph of a step must be recorded again.
        """
        self._stale = False
        before = [rows.data_ptr() for rows in self.backend.parameter_targets()]
        self.backend.set_model(self._build_model())
        self.backend.prepare(self._sim.dt)
        moved = before != [rows.data_ptr() for rows in self.backend.parameter_targets()]
        if moved and self._update is not None:
            self._update = self._make_update()
        return moved

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state beside the GTD, by name."""
        drawn = [] if self._randomized is None else self._randomized.random_gains
        kept = {name: self.controller.gains_by_name[name] for name in drawn}
        rows = {} if self._allocation is None else self._allocation.rows
        tensors = {"com": self.com} | add_prefix("gains", kept) | add_prefix("allocation", rows)
        return tensors | add_prefix("backend", self.backend.state_tensors())

    def act(self, actions: Tensor) -> None:
        """Begin a step: store action (E, U) and previous action, count the step, clear the flags of episode ends."""
        if actions.shape != self.tensors.actions.shape:
            raise ShapeError(
                f"actions has shape {tuple(actions.shape)}, expected (E, U) = {tuple(self.tensors.actions.shape)}: "
                f"{', '.join(self.action_names)}"
            )
        self.take_writes()
        self._step_begin.begin(actions)
        if self.differentiable is not None:
            self.differentiable.act(actions)
        if self._pushing.force is not None:
            self._pushing.force.zero_()

    def advance(self, substeps: int) -> None:
        """Advance the physics by ``substeps`` with the stored action held; obstacles that push back move and push between."""
        if self.felt.surface_height is not None:
            self.backend.take_ground_heights()
        self.backend.step(self.tensors.state, self.tensors.actions, self._sim.dt, substeps)

    def refresh(self, span: float) -> None:
        """Update all quantities derived from the physics; ``span`` [s] is the length of the step."""
        self.tensors.derived.refresh()
        self.refresh_load()
        if self._joints is not None:
            self._joints.refresh()
        if self._pushing.force is not None:
            self._pushing.force.div_(span)  # impulses until now

    def reset(self, mask: Tensor) -> None:
        """Draw a new initial state, and new parameters where randomised, for the environments in ``mask``, bool (E,)."""
        copy_mask(self._random.mask, mask)
        (self._update or self._initial)()
        if self._update is not None and self.differentiable is not None:
            self._update.mark_written()
        if self._joints is not None:
            self._joints.reset()
        self.backend.reset_memory(mask)  # uses the draws
        self.refresh_load()

    def refresh_load(self) -> None:
        """Update the position of a slung load, if there is one."""
        load = None if self._load is None else self.backend.link_state_of_load()
        if self._load is not None and load is not None:
            self._load.refresh(load)
