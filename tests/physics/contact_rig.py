"""Vehicles on the ground and among obstacles, for tests of contact: rotors at rest, no effects."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.cores import contact_points
from aerial_gym.assets.obstacles import Obstacles, asset_table, view_obstacles
from aerial_gym.config.environment import AssetCfg, ContactCfg, MotionCfg
from aerial_gym.config.robot import BodyCfg, CollisionShape
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.random import Randomness
from aerial_gym.physics import (
    BodyState,
    Ground,
    TorchBackend,
    WarpBackend,
    build_model,
    state_at_rest,
    vehicle_from_config,
)
from aerial_gym.robots.scene_contact import ContactBody, SceneContact
from tests.physics.vehicles import asymmetric_robot

MASS, INERTIA, GRAVITY = 0.5, (2.0e-3, 3.0e-3, 4.0e-3), 9.81
BALL = ((0.0, 0.0, 0.0, 0.1),)
FEET = tuple((x, y, 0.0, 0.02) for x in (0.1, -0.1) for y in (0.1, -0.1))
"""Four feet whose lowest points are 2 cm below the body origin."""

CPU = torch.device("cpu")


def make_robot(*, com: tuple[float, float, float] = (0.0, 0.0, 0.0), inertia: Sequence[float] = INERTIA):
    ix, iy, iz = inertia
    body = BodyCfg(mass=MASS, inertia=((ix, 0.0, 0.0), (0.0, iy, 0.0), (0.0, 0.0, iz)), com=com, source="test")
    return replace(asymmetric_robot(), body=body)


class GroundRig:
    def __init__(
        self, backend: TorchBackend | WarpBackend, cfg: ContactCfg | None, state: BodyState, *, spheres=BALL,
        robot=None, integrator: str = "euler", gravity: float = GRAVITY,
    ) -> None:  # fmt: skip
        num_envs, dtype = state.num_envs, state.position.dtype
        vehicle = vehicle_from_config(robot or make_robot(), num_envs=num_envs, dtype=dtype)
        self.backend, self.state = backend, state
        self.crashes = torch.zeros(num_envs, dtype=torch.bool)
        self.impulse = torch.zeros(num_envs, 3, dtype=dtype)
        ground = Ground(
            height=0.0, spheres=torch.tensor(spheres), contact=self.crashes, cfg=cfg, impulse=self.impulse
        )  # fmt: skip
        law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, GRAVITY)
        backend.allocate(build_model(vehicle, gravity=gravity), law, integrator=integrator, ground=ground)
        self._still = torch.zeros(num_envs, 4, dtype=dtype)

    def run(self, span: float, dt: float) -> None:
        self.backend.step(self.state, self._still, dt, round(span / dt))


class ObstacleRig:
    def __init__(
        self, shapes: Sequence[ShapeCfg], asset_state: Tensor, cfg: ContactCfg, state: BodyState, *, spheres=BALL,
        body: Sequence[CollisionShape] = (), robot=None, integrator: str = "euler", dt: float = 0.01,
        gravity: float = GRAVITY, backend: TorchBackend | WarpBackend | None = None, moves: bool = True,
    ) -> None:  # fmt: skip
        """Take poses and velocities of the obstacles, (E, A, 13), and the state that is advanced in place. The robot has
        spheres, or the shapes of ``body``. Obstacles keep their twists, unless nothing ``moves``."""
        num_envs, rows = state.num_envs, torch.arange(len(shapes))
        vehicle = vehicle_from_config(robot or make_robot(), num_envs=num_envs)
        self.state, self.dt, self.asset_state = state, dt, asset_state
        self.crashes, self.impulse = torch.zeros(num_envs, dtype=torch.bool), torch.zeros(num_envs, 3)
        self.backend = backend or WarpBackend()
        law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, GRAVITY)
        pushed = ContactBody(
            mass=vehicle.mass.clone(), inertia=vehicle.inertia.clone(), com=vehicle.com.clone(),
            spheres=contact_points(body, device=CPU) if body else torch.tensor(spheres), shapes=tuple(body),
        )  # fmt: skip
        contact = SceneContact(
            Scene(list(shapes), shape_index=rows, semantic_id=rows, asset_state=asset_state), cfg, pushed, state,
            integrator=integrator, dt=dt, crashes_out=self.crashes, impulse_out=self.impulse,
            moving=_keep_twists(shapes, asset_state) if moves else None,
        )  # fmt: skip
        self.backend.allocate(build_model(vehicle, gravity=gravity), law, integrator=integrator, hook=contact)
        self._still = torch.zeros(num_envs, 4)

    def run(self, span: float) -> None:
        self.backend.step(self.state, self._still, self.dt, round(span / self.dt))


def _keep_twists(shapes: Sequence[ShapeCfg], asset_state: Tensor) -> Obstacles:
    """Return obstacles that keep their twists."""
    place, twist = (0.5, 0.5, 0.5), MotionCfg(kind="twist")
    asset = AssetCfg(
        name="moving", shapes=tuple(shapes), count=len(shapes), motion=twist, position_ratio_low=place,
        position_ratio_high=place,
    )  # fmt: skip
    num_envs = len(asset_state)
    return view_obstacles(
        asset_state, torch.zeros(0, 0, 2, 3), table=asset_table([asset], device=CPU),
        asset=torch.zeros(asset_state.shape[:2], dtype=torch.int32),
        bounds=(torch.zeros(num_envs, 3), torch.zeros(num_envs, 3)), random=Randomness(num_envs),
    )  # fmt: skip


def start(num_envs: int = 1, *, height: float = 0.0, dtype: torch.dtype = torch.float64, **values) -> BodyState:
    """Return level vehicles at a height [m]; ``values`` are written over the other fields."""
    state = state_at_rest(num_envs, 4, device=CPU, dtype=dtype)
    state.position[:, 2] = height
    for name, value in values.items():
        getattr(state, name)[:] = torch.as_tensor(value, dtype=dtype)
    return state


def obstacle(
    num_envs: int, *, position=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0, 1.0), lin_vel=(0.0,) * 3, ang_vel=(0.0,) * 3
) -> Tensor:
    parts = [
        torch.as_tensor(p, dtype=torch.float32).expand(num_envs, -1) for p in (position, attitude, lin_vel, ang_vel)
    ]
    return torch.cat(parts, dim=-1).unsqueeze(1).contiguous()
