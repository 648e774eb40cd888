"""Swept collision test of links against obstacles, for engines that find contacts themselves: fast touches are crashes.

A ``SubstepHook``: after each substep every link is swept along it (``crossings``), a touch at crash speed is a crash, and
the obstacles move. Then the links are tested like rigid bodies in ``scene_contact``. Overlaps exert forces from the next
substep on. A passage between two poses is a crash without a force.
Frames: world, z up; shapes in the frames of their links. Letters: E environments, L links.
"""

from dataclasses import replace
from functools import cache
from typing import NoReturn

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.cores import contact_points, shape_core
from aerial_gym.assets.mesh_files import is_convex, load_mesh
from aerial_gym.assets.obstacle_motion import make_motion_launch
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.self_collision import select_link_pairs
from aerial_gym.assets.shapes import half_size
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import PartCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.interop import ReusableLaunch, on_torch_stream
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics.fused.hook import Substep
from aerial_gym.physics.ground import LinkContacts, LinkShape, Solid, Solids
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.state import ArticulatedState, BodyState
from aerial_gym.robots.contact_pairs import ContactScene, add_core_pairs, contact_scene, find_pairs, has_fast_approach
from aerial_gym.robots.crossings import make_first_crossing, substep_path
from aerial_gym.robots.joints.link_tensors import LinkTensors
from aerial_gym.robots.joints.links import LinkPlaces


@wp.kernel(enable_backward=False)
def _flag_fast_contacts(
    around: ContactScene,  # with the shapes of one link
    # params
    crash_approach_speed: float,  # [m/s]
    # state
    position: wp.array[wp.vec3],  # (E,) of the link's frame, world [m]
    attitude: wp.array[wp.quat],  # (E,) link to world, xyzw
    lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
    ang_vel: wp.array[wp.vec3],  # (E,) world [rad/s]
    # out
    crashes_out: wp.array[wp.bool],  # (E,) set where the link touches something fast
):
    """Flag environments in which one link touches an obstacle at crash speed."""
    e = wp.tid()
    x = position[e]
    q = attitude[e]
    pairs = find_pairs(around, wp.vec3(), e, x, q)
    pairs = add_core_pairs(pairs, around, wp.vec3(), e, x, q)
    if has_fast_approach(pairs, lin_vel[e], ang_vel[e], crash_approach_speed):
        crashes_out[e] = True


@cache
def _make_sweep(*, moves: bool, meshes: bool) -> wp.Kernel:
    """Return the kernel that sweeps a link; whether obstacles move and any part is a mesh."""
    first_crossing = make_first_crossing(moves=moves, cores=True, meshes=meshes)
    obstacles_type = Obstacles if moves else int

    @wp.kernel(module="unique", enable_backward=False)
    def sweep(
        around: ContactScene,  # with the shapes of one link
        obstacles: obstacles_type,  # before they move
        # params
        pivot: wp.vec3,  # its hinge, in its frame [m]
        crash_approach_speed: float,  # [m/s]
        dt: float,  # [s]
        # state
        first_position: wp.array[wp.vec3],  # (E,) of the link's frame at the start of the substep, world [m]
        first_attitude: wp.array[wp.quat],  # (E,) link to world, xyzw
        first_lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
        first_ang_vel: wp.array[wp.vec3],  # (E,) world [rad/s]
        position: wp.array[wp.vec3],  # (E,) at its end
        attitude: wp.array[wp.quat],
        # out
        crashes_out: wp.array[wp.bool],  # (E,) set where the link touches something fast on its way
    ):
        """Flag environments in which one link touches an obstacle at crash speed during a substep."""
        e = wp.tid()
        q0 = first_attitude[e]
        arm = wp.quat_rotate(q0, pivot)
        done = Substep()
        done.dt = dt
        done.com = pivot
        done.first_position = first_position[e] + arm
        done.first_attitude = q0
        done.first_lin_vel = first_lin_vel[e] + wp.cross(first_ang_vel[e], arm)
        done.first_ang_vel = wp.quat_rotate_inv(q0, first_ang_vel[e])
        done.position = position[e] + wp.quat_rotate(attitude[e], pivot)
        done.attitude = attitude[e]
        if first_crossing(around, obstacles, crash_approach_speed, e, done, substep_path(done)).crashes:
            crashes_out[e] = True

    return sweep


class LinkObstacleSweep:
    """Moves obstacles and notices crashes; a ``SubstepHook``."""

    max_substeps: int | None = None  # Any number

    def __init__(
        self, scene: Scene, cfg: ContactCfg, robot: RobotCfg, state: BodyState, links: LinkTensors, *, dt: float,
        crashes_out: Tensor, moving: "Obstacles | None" = None,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are.

        Args:
            links: Receives the link poses after each substep.
            crashes_out: Set, bool, (E,), where a link touches at the speed of a crash; never cleared here.
            moving: The instances of the scene as they move; None if nothing moves.
        """
        assert robot.joints is not None
        assert isinstance(state, ArticulatedState)
        self._places, self._stream = LinkPlaces(robot.joints, state, links, None), crashes_out
        self._move = None if moving is None else make_motion_launch(moving, dt)
        self._kept_alive = (scene, links, moving)
        self._links, self._first = links.state, torch.zeros_like(links.state)
        obstacles = 0 if moving is None else moving
        self._overlap_tests: list[ReusableLaunch] = []
        self._sweeps: list[ReusableLaunch] = []
        for number, name in enumerate(links.names):
            shapes = robot.collision.link_shapes(name)
            if not shapes:
                continue
            points = contact_points(shapes, device=scene.device)
            around = contact_scene(scene, points, shapes)
            first, last = (state[:, number].split((3, 4, 3, 3), dim=-1) for state in (self._first, self._links))
            place = {"dim": scene.num_envs, "outputs": [crashes_out], "device": scene.device}
            tested = [around, cfg.crash_approach_speed, *last]
            self._overlap_tests.append(ReusableLaunch(_flag_fast_contacts, inputs=tested, **place))
            inputs = [around, obstacles, wp.vec3(*links.pivots[number]), cfg.crash_approach_speed, dt, *first]
            kernel = _make_sweep(moves=moving is not None, meshes=scene.has_meshes)
            self._sweeps.append(ReusableLaunch(kernel, inputs=[*inputs, *last[:2]], **place))

    @torch.no_grad()
    def begin(self, state: BodyState) -> None:
        """Store the link poses before the substep."""
        self._places.refresh()
        self._first.copy_(self._links)

    @torch.no_grad()
    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Sweep all links and move the obstacles; launched on torch's current stream, not waited for."""
        self._places.refresh()
        with on_torch_stream(self._stream):
            for sweep in self._sweeps:
                sweep.launch()
            if self._move is not None:
                self._move.launch()
            for test in self._overlap_tests:
                test.launch()
        self._first.copy_(self._links)

    def fused(self) -> NoReturn:
        """Raise ``CapabilityError``: fused kernels find no contacts of links."""
        raise CapabilityError("obstacles do not push links in a fused kernel. Use backend 'mujoco'")


def shapes_on_links(
    robot: RobotCfg, *, device: torch.device, scene: Scene | None = None, moves: bool = False
) -> tuple[Tensor, LinkContacts]:
    """Return the ground contact spheres in link axes, (C, 4) [m], and the contact shapes of a robot with joints.

    With ``between_links`` or obstacles these are also the shapes that push each other, or that obstacles push.
    """
    joints, cfg = robot.joints, robot.collision
    assert joints is not None
    origins = [(0.0, 0.0, 0.0), *(joint.position for joint in joints.layout)]
    shapes, points = [], [torch.zeros(0, 4, device=device)]
    for shape in cfg.shapes:
        link = robot.link_names.index(shape.link)
        own = replace(shape, center=tuple(c - o for c, o in zip(shape.center, origins[link], strict=True)))
        center, attitude, half, radius = shape_core(own)
        core = {"center": center, "attitude": attitude, "half": half}
        shapes.append(LinkShape(link=link, radius=radius, **{name: tuple(x.tolist()) for name, x in core.items()}))
        points.append(contact_points([own], device=device))
    spheres = torch.cat(points)
    links = tuple(shape.link for shape, rows in zip(shapes, points[1:], strict=True) for _ in rows)
    solids = None if scene is None or not scene.num_instances else _scene_solids(scene, moves=moves)
    pairs: list[tuple[int, int]] = []
    if cfg.between_links:
        parents = [joints.link_number(joint.parent) for joint in joints.layout]
        pairs = select_link_pairs(cfg, names=robot.link_names, parents=parents, device=torch.device("cpu"))
    elif solids is None:
        shapes = []
    return spheres, LinkContacts(links=links, shapes=tuple(shapes), pairs=tuple(pairs), solids=solids)


def _scene_solids(scene: Scene, *, moves: bool) -> Solids:
    """Return the instances of a scene, which is read again at every step."""
    parts, part, carrier = scene.instance_parts()
    table = tuple(map(_part_solid, parts))
    return Solids(table=table, part=part, carrier=carrier, state=scene.asset_state, moves=moves)


def _part_solid(part: PartCfg) -> Solid:
    shape, turn = part.shape, quat_from_euler(torch.tensor(part.euler, dtype=torch.float64))
    place = {"position": part.position, "attitude": tuple(turn.tolist())}
    if shape.kind != "mesh" or shape.path is None:
        return Solid(kind=shape.kind, size=half_size(shape), **place)
    mesh = load_mesh(shape.path, scale=shape.scale, up=shape.up)
    vertices = tuple(map(tuple, mesh.vertices.tolist()))
    return Solid(kind=shape.kind, path=shape.path, vertices=vertices, convex=is_convex(mesh), **place)
