"""Vehicles on the page, drawn from their robot file as instances of a few meshes.

Frames: world z up; poses are those of the body frame or of the link frames. Quaternions are xyzw here and wxyz in viser.
Letters: N vehicles, R rotors, L links (the base first).
"""

from collections.abc import Callable, Mapping
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.assets.mesh_files import join_pieces
from aerial_gym.config.joint import BASE
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.quaternion import quat_conjugate, quat_from_euler, quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.robots.looks import FRAME, arm_parts, rotor_parts
from aerial_gym.viewer.meshes import part_mesh, rgb

if TYPE_CHECKING:
    from viser import ArrowsHandle, BatchedMeshHandle, LabelHandle, SceneNodeDragEvent, ViserServer

Rgb = tuple[int, int, int]
SLOWER = 0.02  # Share of its speed at which a rotor turns on the page, so that the eye can follow it
FULL_SPEED = 800.0  # Speed on the page of a force-mode rotor at its highest thrust [rad/s]
ARROW_M = 8.0  # Length of an arrow for a force equal to the weight, per distance of the outermost hub
ARROW_COLORS: tuple[Rgb, ...] = (
    (230, 120, 20), (30, 140, 200), (160, 60, 180), (40, 160, 70), (200, 40, 90), (120, 120, 30),
)  # fmt: skip
WXYZ = [3, 0, 1, 2]  # Columns of xyzw in the order of viser


class VehicleView:
    """N vehicles of one robot file: arms, turning rotors, links that bend, and arrows for forces."""

    def __init__(
        self, server: "ViserServer", name: str, robot: RobotCfg, *, count: int = 1, tint: Rgb | None = None,
        opacity: float | None = None,
    ) -> None:  # fmt: skip
        """Add the meshes under the scene node ``name``; ``tint`` replaces all colours."""
        self._server, self.name, self.count, self._robot = server, name, count, robot
        self._root = server.scene.add_frame(name, show_axes=False)
        self._forces = server.scene.add_frame(f"{name}_forces", show_axes=False)
        discs = rotor_parts(robot)
        self._links = robot.link_names.index if robot.joints else lambda _: 0
        self._rotor_links = [self._links(part.link) for part in discs]
        self._hubs = torch.tensor([part.position for part in discs])
        self._axes = quat_from_euler(torch.tensor([part.euler for part in discs]))
        self._spins = torch.tensor([float(mount.spin) for mount in robot.mounts.layout])
        self._angles = torch.zeros(count, robot.num_rotors)
        self._per_state = torch.tensor(
            [FULL_SPEED / rotor.thrust_range[1] if rotor.mode == "force" else 1.0 for rotor in robot.rotor_types]
        )
        self.size = max(hypot(*mount.position) for mount in robot.mounts.layout) or 0.1
        """Distance of the outermost hub from the body origin [m]."""
        self._bodies = self._add_bodies(tint, opacity)
        self._discs, self._blades = self._add_rotors(discs, tint, opacity)
        self._arrows: dict[str, tuple[ArrowsHandle, LabelHandle]] = {}
        self._numbers: dict[str, int] = {}  # Of the effects, by which each keeps its colour

    def _add_bodies(self, tint: Rgb | None, opacity: float | None) -> list[tuple[int, "BatchedMeshHandle"]]:
        """Add one mesh for each link and colour, and return the link numbers with their meshes."""
        groups: dict[tuple[int, Rgb], list[trimesh.Trimesh]] = {}
        for part in body_parts(self._robot):
            key = (self._links(part.link), tint or rgb(part.shape))
            groups.setdefault(key, []).append(part_mesh(part))
        return [
            (link, self._add(f"body_{number}", join_pieces(pieces, scale=1.0), self.count, color, opacity))
            for number, ((link, color), pieces) in enumerate(groups.items())
        ]

    def _add_rotors(
        self, discs: tuple[PartCfg, ...], tint: Rgb | None, opacity: float | None
    ) -> tuple["BatchedMeshHandle", "BatchedMeshHandle"]:
        radii = np.tile([part.shape.radius or 0.0 for part in discs], self.count).astype(np.float32)
        colors = np.tile([tint or rgb(part.shape) for part in discs], (self.count, 1)).astype(np.uint8)
        unit = ShapeCfg(kind="cylinder", radius=1.0, height=0.02)
        blade = ShapeCfg(kind="box", size=(1.9, 0.16, 0.06))
        both = []
        for name, shape, share in (("discs", unit, 0.35), ("blades", blade, 1.0)):
            mesh = part_mesh(PartCfg(shape=shape))
            both.append(self._add(name, mesh, len(radii), colors, share * (opacity or 1.0), scales=radii))
        return both[0], both[1]

    def _add(
        self, name: str, mesh: trimesh.Trimesh, count: int, colors: Rgb | NDArray[np.uint8], opacity: float | None,
        scales: NDArray[np.float32] | None = None,
    ) -> "BatchedMeshHandle":  # fmt: skip
        turns = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (count, 1))
        return self._server.scene.add_batched_meshes_simple(
            f"{self.name}/{name}", np.asarray(mesh.vertices), np.asarray(mesh.faces), turns, np.zeros((count, 3)),
            batched_scales=scales, batched_colors=colors, lod="off", flat_shading=True,
            opacity=None if opacity in (None, 1.0) else opacity, side="double",
        )  # fmt: skip

    def on_drag(self, pull: Callable[[NDArray[np.float64] | None], object]) -> None:
        """Call ``pull`` with the pointer [m], world, (3,), while the user drags a vehicle, and with None at the end."""

        def move(event: "SceneNodeDragEvent[BatchedMeshHandle]") -> None:
            pull(None if event.phase == "end" else np.array(event.end_position))

        for mesh in (*(mesh for _, mesh in self._bodies), self._discs):
            mesh.on_drag(move)

    @property
    def visible(self) -> bool:
        """Whether the vehicles are shown."""
        return self._root.visible

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._root.visible = self._forces.visible = shown

    def update(
        self, position: NDArray[np.floating], attitude: NDArray[np.floating], *,
        rotor_state: NDArray[np.floating] | None = None, links: NDArray[np.floating] | None = None,
        elapsed: float = 0.0, forces: Mapping[str, NDArray[np.floating]] | None = None,
    ) -> None:  # fmt: skip
        """Move all vehicles.

        Args:
            position: Body origins [m], world, (N, 3).
            attitude: Body to world, xyzw, (N, 4).
            rotor_state: Rotor speeds [rad/s], in force mode thrusts [N], (N, R); rotors stand still without it.
            links: Position and xyzw of the link frames, world, (N, L, >= 7); links keep the reference pose without it.
            elapsed: Flight time since the last update [s], by which rotors turn on.
            forces: As of ``update_forces``; the arrows stay as they are without it.
        """
        place, turn = _tensor(position), _tensor(attitude)
        poses = torch.cat((place, turn), dim=-1).unsqueeze(1) if links is None else _tensor(links)[..., :7]
        if self.count == 1:  # the pose of a node reaches the page sooner than that of an instance
            self._root.position, self._root.wxyz = place[0].numpy(), turn[0, WXYZ].numpy()
            poses = _relative_poses(poses, place.unsqueeze(1), turn.unsqueeze(1).expand(-1, poses.shape[1], -1))
        for link, mesh in self._bodies if self.count > 1 or links is not None else ():
            _move(mesh, *poses[:, min(link, poses.shape[1] - 1)].split((3, 4), dim=-1))
        if rotor_state is not None:
            speed = self._spins * self._per_state * _tensor(rotor_state)
            self._angles = torch.remainder(self._angles + SLOWER * elapsed * speed, 2.0 * torch.pi)
        self._move_rotors(poses)
        if forces is not None:
            self.update_forces(position, forces)

    def update_forces(self, position: NDArray[np.floating], forces: Mapping[str, NDArray[np.floating]]) -> None:
        """Draw an arrow for the force of each effect [N], world, (N, 3), at positions (N, 3); remove those of other effects."""
        for effect in self._arrows.keys() - forces.keys():
            self._arrows.pop(effect)[0].remove()  # and its label, a child
        for effect, force in forces.items():
            self._draw_arrows(effect, _tensor(position), _tensor(force))

    def _move_rotors(self, poses: Tensor) -> None:
        carriers = [link if poses.shape[1] > 1 else 0 for link in self._rotor_links]
        place, turn = poses[:, carriers].split((3, 4), dim=-1)
        hub = place + quat_rotate(turn, self._hubs.expand_as(place))
        axis = quat_multiply(turn, self._axes.expand_as(turn))
        half, zero = 0.5 * self._angles, torch.zeros_like(self._angles)
        spin = torch.stack((zero, zero, half.sin(), half.cos()), dim=-1)
        _move(self._discs, hub.flatten(0, 1), axis.flatten(0, 1))
        _move(self._blades, hub.flatten(0, 1), quat_multiply(axis, spin).flatten(0, 1))

    def _draw_arrows(self, effect: str, place: Tensor, force: Tensor) -> None:
        """Draw the arrows of one effect, with its name at the tip of the first."""
        length = ARROW_M * self.size / (self._robot.body.mass * STANDARD_GRAVITY)
        tip = place + length * force
        points = torch.stack((place, tip), dim=1).numpy()
        if effect not in self._arrows:
            color = ARROW_COLORS[self._numbers.setdefault(effect, len(self._numbers)) % len(ARROW_COLORS)]
            thick, scene, name = 0.04 * self.size, self._server.scene, f"{self.name}_forces/{effect}"
            arrows = scene.add_arrows(
                name, points, color, shaft_radius=thick, head_radius=2.5 * thick, head_length=5.0 * thick
            )
            self._arrows[effect] = arrows, scene.add_label(f"{name}/name", effect)
        arrows, label = self._arrows[effect]
        way = force[0] / force[0].norm().clamp(min=1e-9)
        arrows.points, label.position = points, (tip[0] + 0.4 * self.size * way).numpy()

    def remove(self) -> None:
        """Remove the vehicles from the page."""
        self._root.remove()
        self._forces.remove()


def body_parts(robot: RobotCfg) -> tuple[PartCfg, ...]:
    """Return the shapes of a vehicle without its rotors: its visible shapes, or arms and a body at its centre."""
    if robot.visual:
        return robot.visual
    arms = arm_parts(robot)
    edge = 0.45 * max((part.shape.size[0] for part in arms if part.shape.size and part.link == BASE), default=0.1)
    body = ShapeCfg(kind="box", size=(edge, 0.7 * edge, 0.35 * edge), color=FRAME)
    return (PartCfg(shape=body), *arms)


def _tensor(values: NDArray[np.floating]) -> Tensor:
    return torch.as_tensor(np.asarray(values, dtype=np.float32))


def _relative_poses(poses: Tensor, place: Tensor, turn: Tensor) -> Tensor:
    """Return world poses (N, L, 7) in the frames at ``place``, (N, 1, 3), with attitudes ``turn``, (N, L, 4)."""
    position = quat_rotate_inverse(turn, poses[..., :3] - place)
    return torch.cat((position, quat_multiply(quat_conjugate(turn), poses[..., 3:])), dim=-1)


def _move(mesh: "BatchedMeshHandle", position: Tensor, attitude: Tensor) -> None:
    mesh.batched_positions = position.numpy()
    mesh.batched_wxyzs = attitude[:, WXYZ].numpy()
