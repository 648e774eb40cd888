"""The scene on the page: vehicles, obstacles, ground, sensors, trail and goal of one environment.

Frames: world z up; a sensor looks along its own x, a camera of viser along z with y down.
Letters: E environments, P parts of obstacles, S sensors of one kind, H x W pixels.
"""

from collections import deque
from math import atan, radians, tan
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from aerial_gym.config.sensor import CameraCfg, RangeSensorCfg
from aerial_gym.math.quaternion import quat_from_euler, quat_multiply, quat_rotate
from aerial_gym.sensors.rays import ray_table
from aerial_gym.viewer.meshes import rgb, shape_mesh
from aerial_gym.viewer.snapshot import Array, Rgb, SceneContent, SensorSample, Snapshot
from aerial_gym.viewer.vehicle import VehicleView

if TYPE_CHECKING:
    from viser import BatchedMeshHandle, CameraFrustumHandle, LineSegmentsHandle, PointCloudHandle, ViserServer

TRAIL_S = 8.0  # Length of the trail [s]
GOAL_COLOR, TRAIL_COLOR, BOUNDS_COLOR = (30, 160, 60), (40, 90, 200), (120, 120, 120)
OTHERS_OPACITY = 0.15  # Of the vehicles of other environments
TO_CAMERA = torch.tensor([-0.5, 0.5, -0.5, 0.5])  # From viser's camera axes to those of a sensor, xyzw
EDGES = [(0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7)]  # Of a box
GATE_M = 0.4  # Half edge of the frame that marks the next gate [m]


class SceneView:
    """Everything on the page but the controls."""

    def __init__(self, server: "ViserServer", content: SceneContent, *, alone: bool = False) -> None:
        """Add the nodes; positions follow with the first ``update``.

        With ``alone`` there are no vehicles of other environments, and the goal has no arrows to drag it.
        """
        self._server, self._scene, self.content = server, server.scene, content
        self.vehicle = VehicleView(server, "/vehicle", content.robot)
        self.others: VehicleView | None = None
        if content.num_envs > 1 and not alone:
            self.others = VehicleView(
                server, "/others", content.robot, count=content.num_envs - 1, opacity=OTHERS_OPACITY
            )
        size = self.vehicle.size
        self.goal = self._scene.add_transform_controls(
            "/goal",
            scale=2.2 * size,
            disable_axes=alone,
            disable_rotations=True,
            disable_sliders=True,
            visible=False,
            opacity=0.7,
        )
        self._scene.add_icosphere("/goal/marker", radius=0.2 * size, color=GOAL_COLOR, opacity=0.7)
        self._gate = self._add_lines("/gate", _square(), GOAL_COLOR, 5.0)
        self._trail = self._add_lines("/trail", np.zeros((1, 2, 3)), TRAIL_COLOR, 2.0)
        self._path: deque[Array] = deque(maxlen=max(2, round(TRAIL_S * 30)))
        self.last: Snapshot | None = None
        """The snapshot that the page shows."""
        self._rows: tuple[int, ...] = ()
        self._obstacles: dict[int, BatchedMeshHandle] = {}
        self._part_place: NDArray[np.float32] = np.zeros((0, 7), dtype=np.float32)
        self._room: NDArray[np.float32] | None = None
        self._sensors = {name: _SensorView(server, name, cfg) for name, cfg in content.sensors.items()}
        self.follows = False
        """Whether the cameras of all pages move with the vehicle, each from behind it."""
        self.shows_walls = False
        """Whether obstacles that are larger than the room, such as its walls, are shown."""
        self._scene.set_up_direction("+z")

    def _add_lines(self, name: str, points: NDArray[np.float64], color: Rgb, pixels: float) -> "LineSegmentsHandle":
        return self._scene.add_line_segments(name, points, colors=color, thickness=pixels, thickness_units="screen")

    def update(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        before, self.last = self.last, snapshot
        begins = before is None or (snapshot.env, snapshot.episode) != (before.env, before.episode)
        elapsed = 0.0 if begins or before is None else max(snapshot.time - before.time, 0.0)
        if begins:
            self._path.clear()
        if self._room is None or not np.array_equal(self._room, snapshot.bounds):
            self._draw_room(snapshot.bounds)
        self._move_vehicles(snapshot, elapsed)
        self._move_obstacles(snapshot)
        self._draw_trail(snapshot.position[snapshot.chosen])
        self._draw_goal(snapshot)
        if self.follows:
            self._follow(snapshot)
        for name, reading in snapshot.readings.items():
            self._sensors[name].update(reading)

    def _draw_room(self, bounds: Array) -> None:
        """Draw ground and bounds."""
        self._room = bounds
        low, high = bounds
        middle, width = 0.5 * (low + high), float((high - low)[:2].max())
        level = self.content.ground_height
        floor = float(low[2]) if level is None else level
        self._scene.add_grid(
            "/ground", width=2.0 * width, height=2.0 * width, cell_size=width / 20.0, section_size=width / 4.0,
            position=(middle[0], middle[1], floor), plane_color=(225, 228, 224), plane_opacity=0.6, shadow_opacity=0.3,
        )  # fmt: skip
        corners = np.array([[(low, high)[(n >> k) & 1][k] for k in range(3)] for n in range(8)])
        self._add_lines("/bounds", corners[EDGES], BOUNDS_COLOR, 1.0)

    def aim(self, snapshot: Snapshot) -> None:
        """Let new pages begin with a view of the environment's vehicle from behind."""
        camera = self._server.initial_camera
        camera.position, camera.look_at = self._rear_view(snapshot)

    def _rear_view(self, snapshot: Snapshot) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the position of a camera behind and above the vehicle, and the vehicle's."""
        place = snapshot.position[snapshot.chosen].astype(np.float64)
        back = 3.0 * self.vehicle.size + 0.5
        return place + back * np.array([-1.0, -0.6, 0.6]), place

    def add_follow_switch(self, *, follows: bool) -> None:
        """Add the control with which the camera follows the vehicle; while it does, the mouse does not turn it."""
        self.follows = follows
        switch = self._server.gui.add_checkbox("follow the vehicle", follows)
        switch.on_update(lambda _: setattr(self, "follows", switch.value))

    def _follow(self, snapshot: Snapshot) -> None:
        position, look_at = self._rear_view(snapshot)
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = position, look_at

    def _move_vehicles(self, snapshot: Snapshot, elapsed: float) -> None:
        chosen = slice(snapshot.chosen, snapshot.chosen + 1)
        parts = {"rotor_state": snapshot.rotor_state, "links": snapshot.links}
        own: dict[str, Any] = {name: None if rows is None else rows[chosen] for name, rows in parts.items()}
        forces = {name: force[None] for name, force in snapshot.forces.items()}
        self.vehicle.update(snapshot.position[chosen], snapshot.attitude[chosen], elapsed=elapsed, **own)
        self.vehicle.update_forces(snapshot.position[chosen], forces)
        if self.others is not None and len(snapshot.position) > 1 and self.others.visible:
            rest: dict[str, Any] = {
                name: None if rows is None else np.delete(rows, snapshot.chosen, 0) for name, rows in parts.items()
            }
            place, turn = (np.delete(rows, snapshot.chosen, 0) for rows in (snapshot.position, snapshot.attitude))
            self.others.update(place, turn, elapsed=elapsed, **rest)

    def _move_obstacles(self, snapshot: Snapshot) -> None:
        rows = tuple(snapshot.part_row.tolist())
        if rows != self._rows:
            self._add_obstacles(rows, snapshot.bounds)
        elif np.array_equal(snapshot.part_place, self._part_place):
            return
        self._part_place = snapshot.part_place
        place, turn = torch.from_numpy(snapshot.part_place).split((3, 4), dim=-1)
        for row, node in self._obstacles.items():
            at = np.flatnonzero(snapshot.part_row == row)
            part = self.content.parts[row]
            origin, carried = torch.tensor(part.position), quat_from_euler(torch.tensor(part.euler))
            own = turn[at]
            node.batched_positions = (place[at] + quat_rotate(own, origin.expand(len(at), 3))).numpy()
            node.batched_wxyzs = quat_multiply(own, carried.expand(len(at), 4))[:, [3, 0, 1, 2]].numpy()

    def _add_obstacles(self, rows: tuple[int, ...], bounds: Array) -> None:
        """Add a mesh with its instances for each row of the shape table in ``rows``."""
        for node in self._obstacles.values():
            node.remove()
        self._rows, room = rows, float((bounds[1] - bounds[0]).max())
        self._obstacles = {}
        for row in sorted(set(rows) - {-1}):
            shape, count = self.content.parts[row].shape, rows.count(row)
            mesh = shape_mesh(shape)
            self._obstacles[row] = self._scene.add_batched_meshes_simple(
                f"/obstacles/{row}", np.asarray(mesh.vertices), np.asarray(mesh.faces),
                np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.full((count, 3), -1000.0), lod="off", flat_shading=True,
                batched_colors=rgb(shape, self.content.colors[row]), side="double",
                visible=self.shows_walls or float(mesh.extents.max()) < room,
            )  # fmt: skip

    def redraw_obstacles(self) -> None:
        """Add the obstacles anew at the next update."""
        self._rows = ()

    def _draw_trail(self, place: Array) -> None:
        if not self._path or float(np.abs(place - self._path[-1]).max()) > 1e-3:
            self._path.append(place)
            if len(self._path) > 1:
                points = np.stack(self._path)
                self._trail.points = np.stack((points[:-1], points[1:]), axis=1)
        if len(self._path) < 2:
            self._trail.points = np.stack((place, place))[None]

    def _draw_goal(self, snapshot: Snapshot) -> None:
        goal, gate = snapshot.goal, snapshot.gate
        if self.goal.visible != (goal is not None):
            self.goal.visible = goal is not None
        if goal is not None and not np.allclose(self.goal.position, goal, atol=1e-5):
            self.goal.position = goal
        if self._gate.visible != (gate is not None):
            self._gate.visible = gate is not None
        if goal is not None and gate is not None:
            self._gate.position, self._gate.wxyz = goal, gate[[3, 0, 1, 2]]


class _SensorView:
    """Frusta with images of the cameras of one kind, or the points that its lidars see."""

    def __init__(self, server: "ViserServer", name: str, cfg: RangeSensorCfg) -> None:
        self._cfg = cfg
        self._rays = ray_table(cfg, device=torch.device("cpu"))
        self._frusta: list[CameraFrustumHandle] = []
        self._points: PointCloudHandle | None = None
        if isinstance(cfg, CameraCfg):
            aspect = cfg.width / cfg.height
            fov = 2.0 * atan(tan(0.5 * radians(cfg.hfov_deg)) / aspect)
            self._frusta = [
                server.scene.add_camera_frustum(f"/sensors/{name}_{i}", fov, aspect, scale=0.25, color=(200, 120, 30))
                for i in range(cfg.count)
            ]
        else:
            self._points = server.scene.add_point_cloud(
                f"/sensors/{name}", np.zeros((1, 3)), np.array([200, 60, 40]), point_size=0.03, point_shape="circle"
            )

    def update(self, reading: SensorSample) -> None:
        """Show a reading."""
        turns = torch.from_numpy(reading.attitude)
        cameras = quat_multiply(turns, TO_CAMERA.expand_as(turns))[:, [3, 0, 1, 2]].numpy()
        for i, node in enumerate(self._frusta):
            node.position, node.wxyz, node.image = reading.position[i], cameras[i], self._picture(reading, i)
        if self._points is not None:
            self._points.points = sensor_points(self._cfg, self._rays, reading)

    def _picture(self, reading: SensorSample, number: int) -> NDArray[np.uint8]:
        if reading.color is not None:
            return (255.0 * reading.color[number].clip(0.0, 1.0)).astype(np.uint8)
        distance = _metres(self._cfg, reading.distance[number])
        near = np.where(distance > 0.0, 1.0 - distance / self._cfg.max_range, 0.0).clip(0.0, 1.0)
        return np.repeat((255.0 * near).astype(np.uint8)[..., None], 3, axis=-1)


def _metres(cfg: RangeSensorCfg, distance: Array) -> Array:
    return distance * (cfg.max_range if cfg.normalize else 1.0)


def sensor_points(cfg: RangeSensorCfg, rays: torch.Tensor, reading: SensorSample) -> Array:
    """Return the points that sensors of one kind see [m], world, (points, 3); pixels without a valid distance have none.

    Args:
        rays: Unit directions, sensor frame, (H, W, 3).
    """
    distance = torch.from_numpy(_metres(cfg, reading.distance))
    along = rays / rays[..., :1] if cfg.kind == "depth" else rays
    turn = torch.from_numpy(reading.attitude)[:, None, None].expand(*distance.shape, 4)
    points = torch.from_numpy(reading.position)[:, None, None] + quat_rotate(turn, distance[..., None] * along)
    valid = (distance >= cfg.min_range) & (distance < 0.999 * cfg.max_range) & (distance > 0.0)
    return points[valid].numpy()


def _square() -> NDArray[np.float64]:
    """Return the sides of a square across x, (4, 2, 3)."""
    corners = GATE_M * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], dtype=np.float64)
    return np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)
