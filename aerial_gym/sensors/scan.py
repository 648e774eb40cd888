"""Motion distortion of a scanning lidar, which measures its columns one after the other.

Columns measured at the same time form a group, and each group has a sensor pose of its own, called seat. The image is
complete at the instant of capture. Past poses follow from the twists at that instant: origins of body and obstacles on
straight lines, links by screw motions, which do not depend on the choice of their origin.

Frames: body is x forward, y left, z up; world is the environment's own. Letters: E environments, B vehicles of all of them, S
sensors of one kind, M = B * S mounts, G groups, A instances, P parts, L links of all vehicles that are seen.
"""

from math import gcd

import torch
import warp as wp

from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import BODY, WORLD, SceneArrays
from aerial_gym.config.sensor import ScannedCfg
from aerial_gym.interop import ReusableLaunch
from aerial_gym.sensors.flow import SceneTwists, scene_twists
from aerial_gym.sensors.rays import Tiles, make_tiles
from aerial_gym.sensors.sensor_poses import SensorsOnCarrier, first_own_link, is_hidden, sensor_pose
from aerial_gym.sensors.sensor_view import ABSENT, SensorView, write_part_in_sensor_frame


@wp.func
def rotation_over_time(ang_vel: wp.vec3, time: float) -> wp.quat:
    """Return the turn by ``ang_vel * time`` [rad]."""
    return wp.quat_from_axis_angle(wp.normalize(ang_vel), wp.length(ang_vel) * time)


@wp.func
def shift_over_time(lin_vel: wp.vec3, ang_vel: wp.vec3, time: float, link: int) -> wp.vec3:
    """Return the displacement of an origin in a time [m]: screw motion of a link, straight line of the body and of obstacles.

    Source: Murray, Li, Sastry (1994), A Mathematical Introduction to Robotic Manipulation, equation 2.36, as a series in the
    turn where that is small.
    """
    way = time * lin_vel
    if link > 0:
        turn = time * ang_vel
        angle = wp.length(turn)
        first = wp.float32(0.5)
        second = wp.float32(1.0 / 6.0)
        if angle > 1.0e-2:
            half = wp.sin(0.5 * angle) / angle
            first = 2.0 * half * half
            second = (1.0 - wp.sin(angle) / angle) / (angle * angle)
        across = wp.cross(turn, way)
        way += first * across + second * wp.cross(turn, across)
    return way


@wp.kernel(enable_backward=False)
def place_columns(
    sensors: SensorsOnCarrier,
    age: wp.array[float],  # (G,) how long ago a group was measured [s]
    # out
    position_out: wp.array2d[wp.vec3],  # (B, S * G) present body frame [m]
    attitude_out: wp.array2d[wp.quat],  # (B, S * G) sensor to present body
):
    """Write a sensor's past pose in the present body frame, for a constant twist."""
    body, seat = wp.tid()
    sensor = seat // age.shape[0]
    ago = age[seat - sensor * age.shape[0]]
    spin = sensors.ang_vel[body]
    back = rotation_over_time(spin, -ago)
    gone = shift_over_time(wp.quat_rotate_inv(sensors.attitude[body], sensors.lin_vel[body]), spin, -ago, sensors.link)
    position_out[body, seat] = wp.quat_rotate(back, sensors.mount_position[body, sensor]) + gone
    attitude_out[body, seat] = back * sensors.mount_attitude[body, sensor]


@wp.kernel(enable_backward=False)
def view_columns(
    scene: SceneArrays,
    twists: SceneTwists,
    seats: SensorsOnCarrier,  # of the column groups, (B, S * G)
    sensors: SensorsOnCarrier,
    age: wp.array[float],  # (G,) [s]
    reach: float,  # [m] beyond which nothing is seen
    # out
    rows_out: wp.array2d[wp.vec4],  # (M * G, 3 P)
    kind_out: wp.array2d[wp.int32],  # (M * G, P)
):
    """Write a part's pose in the frame of one column group.

    The seat is moved instead of the instance: to its past pose relative to the instance. Relative to its own link that is
    the present pose.
    """
    row, a = wp.tid()
    body = row // seats.mount_position.shape[1]
    env = body // sensors.vehicles
    seat = row - body * seats.mount_position.shape[1]
    instance = scene.part_instance[env, a]
    if is_hidden(sensors, body, instance):
        kind_out[row, a] = ABSENT
        return
    origin, attitude = sensor_pose(seats, body, seat)
    if instance == BODY - first_own_link(sensors, body) - sensors.link:
        origin, attitude = sensor_pose(sensors, body, seat // age.shape[0])
    elif instance != WORLD and scene.part_shape[env, a] >= 0:
        velocity = wp.vec3()
        spin = wp.vec3()
        place = wp.vec3()
        straight = wp.bool(True)
        if instance >= 0:
            velocity = twists.lin_vel[env, instance]
            spin = twists.ang_vel[env, instance]
            place = scene.position[env, instance]
        else:
            velocity = twists.link_lin_vel[env, BODY - instance]
            spin = twists.link_ang_vel[env, BODY - instance]
            place = scene.link_position[env, BODY - instance]
            straight = scene.link_is_base[BODY - instance]
        if wp.length_sq(velocity) + wp.length_sq(spin) > 0.0:
            ago = age[seat - (seat // age.shape[0]) * age.shape[0]]
            forth = rotation_over_time(spin, ago)
            if straight:
                origin = place + wp.quat_rotate(forth, origin + ago * velocity - place)
            else:
                origin = place + wp.quat_rotate(forth, origin - place) + shift_over_time(velocity, spin, ago, 1)
            attitude = forth * attitude
    write_part_in_sensor_frame(scene, env, a, origin, attitude, reach, row, rows_out, kind_out)


class ColumnScan:
    """Sensor poses of the column groups of a scanning lidar, with the launches that compute them."""

    def __init__(self, cfg: ScannedCfg, scene: Scene, sensors: SensorsOnCarrier) -> None:
        """Take the sensors, whose motion gives the column poses."""
        self._cfg, self._scene, self._sensors = cfg, scene, sensors
        self._device = wp.device_from_torch(scene.device)
        ages = column_group_ages(cfg)
        self.groups = len(ages)
        """Number of groups G."""
        self._age = wp.array(ages, dtype=wp.float32, device=self._device)
        seats = (sensors.mount_position.shape[0], cfg.count * self.groups)
        self.seats = SensorsOnCarrier()
        """The column groups as sensors of their own, (B, S * G)."""
        for name in SensorsOnCarrier.vars:
            setattr(self.seats, name, getattr(sensors, name))
        self.seats.mount_position = wp.zeros(seats, dtype=wp.vec3, device=self._device)
        self.seats.mount_attitude = wp.zeros(seats, dtype=wp.quat, device=self._device)

    def record_placement(self) -> ReusableLaunch:
        """Record the launch that places the seats."""
        places = [self.seats.mount_position, self.seats.mount_attitude]
        return self._record(place_columns, places[0].shape, [self._sensors, self._age], places)

    def record_view(self, view: SensorView, reach: float) -> ReusableLaunch:
        """Record the launch that transforms every part within a reach [m] into the frame of every column group."""
        inputs = [self._scene.arrays, scene_twists(self._scene), self.seats, self._sensors, self._age, reach]
        return self._record(view_columns, view.kind.shape, inputs, [view.rows, view.kind])

    def _record(self, kernel: wp.Kernel, dim: tuple[int, ...], inputs: list, outputs: list) -> ReusableLaunch:
        return ReusableLaunch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)

    def make_tiles(self, direction: torch.Tensor, *, height: int, width: int) -> tuple[Tiles, torch.Tensor]:
        """Return tiles of as many rays as ``height`` x ``width``, each within one group, and the group of each, int32."""
        narrow = gcd(self._cfg.scan_columns, width)
        tiles = make_tiles(direction, height=height * width // narrow, width=narrow)
        across = -(-direction.shape[1] // narrow)
        column = torch.arange(tiles.num_tiles, device=direction.device) % across
        return tiles, (column * narrow // self._cfg.scan_columns).int()


def column_group_ages(cfg: ScannedCfg) -> list[float]:
    """Return the age of each column group at the capture [s], at the middle of its columns, G numbers."""
    assert cfg.column_duration_s is not None
    firsts = range(0, cfg.width, cfg.scan_columns)
    middles = [0.5 * (first + min(first + cfg.scan_columns, cfg.width) - 1) for first in firsts]
    return [cfg.column_duration_s * (cfg.width - 1 - middle if cfg.scan_clockwise else middle) for middle in middles]
