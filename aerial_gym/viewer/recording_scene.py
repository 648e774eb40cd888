"""The scene of a recorded flight: measured, declared and corrected vehicle in three colours, and their paths."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.viewer.flight_record import FlightRecord
from aerial_gym.viewer.vehicle import VehicleView

if TYPE_CHECKING:
    from viser import ViserServer

COLORS = {"measured": (86, 98, 112), "declared": (200, 50, 45), "corrected": (30, 110, 190)}
"""Colours of the vehicles: dark, red and blue as in the figures of the reports."""

PATH_POINTS = 2000  # Most points of the measured path
AXES_M = 0.3  # Length of the body axes that stand for a vehicle without a robot file [m]
CAMERA = np.array((-7.0, -7.0, 5.0))  # First place of the camera, in distances of the outermost hub
GHOST = 0.75  # Opacity of predicted vehicles


class RecordingScene:
    """Vehicles and paths of one flight, below a node that moves against the vehicle while the camera follows it."""

    def __init__(self, server: "ViserServer", robots: Mapping[str, RobotCfg]) -> None:
        """Add the vehicles; without robots body axes."""
        self._scene = server.scene
        self._root = self._scene.add_frame("/flight", show_axes=False)
        self._axes = self._scene.add_frame(
            "/flight/axes", axes_length=AXES_M, axes_radius=0.03 * AXES_M, visible=not robots
        )
        shapes = {"measured": robots["declared"], **robots} if robots else {}
        self._vehicles = {
            name: VehicleView(
                server, f"/flight/{name}", robot, tint=COLORS[name], opacity=None if name == "measured" else GHOST
            )
            for name, robot in shapes.items()
        }
        self._size = self._vehicles["measured"].size if robots else AXES_M
        camera = server.initial_camera
        camera.position, camera.look_at = tuple((self._size * CAMERA).tolist()), (0.0, 0.0, 0.0)

    def show(self, record: FlightRecord) -> None:
        """Draw the ground of a flight."""
        self._recorded, self._window, self._path = record, -1, slice(0)
        height = record.log.ground_height if record.has_position else -4.0 * self._size
        cell = 10.0 ** np.ceil(np.log10(self._size))
        self._scene.add_grid(
            "/flight/ground", infinite_grid=True, fade_distance=60.0 * cell, cell_size=cell, section_size=10.0 * cell,
            position=(0.0, 0.0, height),
        )  # fmt: skip
        for name in ("measured", *record.robots):
            self._draw_path(name, np.zeros((0, 3)))

    def draw_measured_path(self, start: float, end: float) -> None:
        """Draw the measured path between two times [s]."""
        rows = slice(*(self._recorded.row_of_time(time) for time in (start, end)))
        if rows != self._path and self._recorded.has_position:
            points = self._recorded.position[rows]
            self._draw_path("measured", points[:: -(-len(points) // PATH_POINTS) or 1])
        self._path = rows

    def draw(self, row: int, elapsed: float, *, follow: bool) -> None:
        """Draw a row of the page.

        ``elapsed``: flight time since the last drawing [s], by which rotors turn on. ``follow``: whether the measured
        vehicle stays in the middle of the page.
        """
        record = self._recorded
        place, attitude = record.position[row], record.attitude[row]
        if np.isfinite(place).all():
            if follow:
                self._root.position = -place
            self._axes.position, self._axes.wxyz = place, attitude[[3, 0, 1, 2]]
            self._move("measured", place, attitude, record.rotor_state, row, elapsed)
        for name, track in record.tracks.items():
            self._vehicles[name].visible = flies = bool(np.isfinite(track.position[row]).all())
            if flies:
                there = track.position[row] if record.has_position else place
                self._move(name, there, track.attitude[row], track.rotor_speed, row, elapsed)
        for name in self._vehicles.keys() - {"measured", *record.tracks}:
            self._vehicles[name].visible = False
        self._draw_window(row)

    def _move(self, name: str, place: Array, attitude: Array, rotors: Array | None, row: int, elapsed: float) -> None:
        if name in self._vehicles:
            state = None if rotors is None else rotors[row, None]
            self._vehicles[name].update(place[None], attitude[None], rotor_state=state, elapsed=elapsed)

    def _draw_window(self, row: int) -> None:
        """Draw the predicted paths of the window around a row, if it is a new one."""
        record = self._recorded
        for name, track in record.tracks.items() if record.has_position else ():
            start = int(track.start[row])
            if start != self._window:
                self._draw_path(name, track.position[track.start == start] if start >= 0 else np.zeros((0, 3)))
        self._window = next((int(track.start[row]) for track in record.tracks.values()), -1)

    def _draw_path(self, name: str, points: Array) -> None:
        """Draw lines between points (K, 3), without those that are not finite."""
        pairs = np.stack((points[:-1], points[1:]), axis=1)
        pairs = pairs[np.isfinite(pairs).all(axis=(1, 2))]
        pairs = pairs if len(pairs) else np.zeros((1, 2, 3))
        self._scene.add_line_segments(
            f"/flight/path_{name}", pairs, COLORS[name], thickness=2.0, thickness_units="screen"
        )
