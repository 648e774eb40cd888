"""A chase camera behind the robot of each environment, with labels and goals.

The pictures come from a scene of their own, with a ground and a visible robot: neither physics nor sensors see them.
Letters: N environments shown, H x W pixels.
"""

from dataclasses import replace
from importlib.util import find_spec
from math import cos, hypot, radians, sin, tan
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.config.shape import GROUND_ID, ROBOT_ID
from aerial_gym.errors import MissingDependencyError

if TYPE_CHECKING:
    from PIL.Image import Image

    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.config.sensor import RangeSensorCfg
    from aerial_gym.config.shape import PartCfg
    from aerial_gym.env_manager import EnvManager
    from aerial_gym.task.task import Task

WIDTH, HEIGHT, VIEW_DEG, FAR = 480, 270, 70.0, 200.0  # Pixels, angle of view across, and how far the camera sees [m]
BEHIND, ABOVE, DOWN = 3.2, 1.1, 0.26  # Camera from the robot, per diameter of the robot, and its downward pitch [rad]
FOLLOWS_S, TURNS_S = 0.3, 1.0  # Times in which the camera follows the robot and turns to its direction of motion [s]
MOST_LAG = 0.6  # Largest distance of the camera from its place, per diameter of the robot
WALL_MARGIN = 0.05  # Distance that the camera keeps from an obstacle behind it, per diameter of the robot
LEAST_SPEED = 0.3  # Speed from which the camera turns to the direction of motion [m/s]
GRID_M, LINE_M = 1.0, 0.02  # Distance and width of the lines on the ground [m]
GROUND_BAND = 0.1  # Surfaces within this height of the ground have lines, such as floors [m]
HAZE_M = 60.0  # Distance in which the ground fades to the horizon [m]
GROUND_COLOR, HORIZON, ZENITH = (0.62, 0.63, 0.6), (0.86, 0.9, 0.94), (0.42, 0.62, 0.88)


def visible_parts(robot: "RobotCfg") -> "tuple[PartCfg, ...]":
    """Return the visible shapes of a robot: its own, or arms and rotors, the front ones in red."""
    from aerial_gym.robots.looks import arm_parts, rotor_parts

    parts = robot.visual or (*arm_parts(robot), *rotor_parts(robot))
    return tuple(replace(part, semantic_id=ROBOT_ID) for part in parts)


def link_states(env: "EnvManager") -> Tensor:
    """Return the states of the robot's links in the world, (E, L, 13): position [m], xyzw, velocities."""
    if "robot_link_state_tensor" in env.gtd:
        return env.gtd["robot_link_state_tensor"]
    return env.gtd["robot_state_tensor"].unsqueeze(1)


def ground_part(env: "EnvManager") -> "PartCfg":
    """Return the ground of an environment; one without ground has it at the lowest bound, for pictures alone."""
    from aerial_gym.config.shape import PartCfg, ShapeCfg

    height = env.cfg.bounds_lower_low[2]
    plain = PartCfg(
        shape=ShapeCfg(kind="plane", color=GROUND_COLOR), position=(0.0, 0.0, height), semantic_id=GROUND_ID
    )
    return env.cfg.ground_part or plain


class ChaseView:
    """Pictures of the first environments of a task."""

    def __init__(self, task: "Task", count: int = 1) -> None:
        """Build the cameras of ``count`` environments; raise ``MissingDependencyError`` without Pillow."""
        task.require_one_vehicle("render")
        if find_spec("PIL") is None:
            raise MissingDependencyError("pictures of flights need Pillow: pip install pillow")
        from aerial_gym.assets.scene import VisibleVehicle
        from aerial_gym.sensors import RayCaster, make_images
        from aerial_gym.sensors.mounts import Carrier
        from aerial_gym.task.commands.command import TARGET

        env, device = task.env, task.device
        robot, ground = env.robot_manager.cfg, ground_part(env)
        keys = ("robot_position", "robot_linvel", "robot_orientation")
        self._robot, self._speed, self._attitude = (env.gtd[key][:count] for key in keys)
        self._target = task.target_position[:count] if TARGET in task.values else None
        self._env, self._count = env, count
        self._size = max(2.8 * max(hypot(*mount.position) for mount in robot.mounts.layout), 0.1)
        self._place, self._eye = torch.zeros(2, count, 3, device=device)
        """Position of the camera in open air, and in front of obstacles behind it [m], world, (N, 3)."""
        self._yaw = torch.zeros(count, 1, device=device)
        self._view, self._back = torch.zeros(2, count, 4, device=device)
        """Attitude of the camera, and of a ray from the robot to it, (N, 4)."""

        def look(cfg: "RangeSensorCfg", position: Tensor, attitude: Tensor, parts: "tuple[PartCfg, ...]") -> RayCaster:
            scene = env.asset_manager.make_scene_for_pictures(
                count, fixed=(ground,), vehicle=VisibleVehicle(parts=parts, links=robot.link_names),
                link_state=link_states(env),
            )  # fmt: skip
            caster = RayCaster(
                cfg, scene, make_images(cfg, count, device=device), Carrier(position=position, attitude=attitude)
            )
            caster.reset(torch.ones(count, dtype=torch.bool, device=device))
            return caster

        self._caster = look(_camera(), self._eye, self._view, visible_parts(robot))
        ray = replace(_camera(), width=1, height=1, hfov_deg=1.0, kind="range", points=None, light=None)
        self._probe = look(ray, self._robot, self._back, ())
        self._steps = 0  # Since the camera was built

    def follow(self, begins: Tensor) -> None:
        """Move the camera on by a step; it jumps to robots whose episode begins, bool (E,)."""
        self._follow_robots(begins[: self._count, None])
        self._steps += 1

    def pictures(self) -> "list[Image]":
        """Return a picture of each environment."""
        from PIL import Image

        self._avoid_obstacles()
        self._caster.cast()
        pixels = (255.0 * self._paint_pixels().clamp(0.0, 1.0)).byte().cpu().numpy()
        views = [Image.fromarray(each) for each in pixels]
        for env, view in enumerate(views):
            self._draw_goal(view, env)
            self._draw_label(view, env)
        return views

    def _floor(self) -> Tensor:
        """Return the height of the ground, or of the lower bound without one [m], world, (N,)."""
        height, lower = self._env.cfg.ground_height, self._env.gtd["env_bounds_min"][: self._count, 2]
        return lower if height is None else torch.full_like(lower, height)

    def _follow_robots(self, begins: Tensor) -> None:
        from aerial_gym.math.quaternion import quat_from_yaw, quat_multiply, wrap_angle, yaw_from_quat

        course = torch.atan2(self._speed[:, 1:2], self._speed[:, 0:1])
        turn = wrap_angle(course - self._yaw) * min(1.0, self._env.dt / TURNS_S)
        moves = self._speed[:, :2].norm(dim=1, keepdim=True) > LEAST_SPEED
        ahead = yaw_from_quat(self._attitude).reshape(-1, 1)
        if self._target is not None:
            to_target = self._target - self._robot
            far = to_target[:, :2].norm(dim=1, keepdim=True) > self._size
            ahead = torch.where(far, torch.atan2(to_target[:, 1:2], to_target[:, 0:1]), ahead)
        self._yaw.copy_(torch.where(begins, ahead, self._yaw + turn * moves))
        back = torch.cat((self._yaw.cos(), self._yaw.sin()), dim=1) * -BEHIND * self._size
        wanted = self._robot + torch.cat((back, torch.full_like(self._yaw, ABOVE * self._size)), dim=1)
        share = torch.where(begins, 1.0, min(1.0, self._env.dt / FOLLOWS_S))
        lag = (self._place - wanted) * (1.0 - share)
        lag *= (MOST_LAG * self._size / lag.norm(dim=1, keepdim=True).clamp(min=1e-9)).clamp(max=1.0)
        self._place.copy_(wanted + lag)
        self._place[:, 2].clamp_(min=self._floor() + 0.2 * self._size)
        pitch = self._view.new_tensor([0.0, sin(DOWN / 2), 0.0, cos(DOWN / 2)])
        self._view.copy_(quat_multiply(quat_from_yaw(self._yaw[:, 0]), pitch.expand_as(self._view)))

    def _avoid_obstacles(self) -> None:
        """Move the camera towards the robot until no obstacle is between them."""
        from aerial_gym.math.quaternion import quat_from_euler

        x, y, z = (self._place - self._robot).unbind(dim=1)
        pitch = -torch.atan2(z, torch.hypot(x, y))
        self._back.copy_(quat_from_euler(torch.stack((torch.zeros_like(x), pitch, torch.atan2(y, x)), dim=1)))
        self._probe.cast()
        hit = self._probe.images.distance.reshape(-1, 1)
        free = torch.where(hit < 0.0, FAR, hit - WALL_MARGIN * self._size)
        offset = self._place - self._robot
        length = offset.norm(dim=1, keepdim=True)
        self._eye.copy_(self._robot + offset * (free / length).clamp(0.1, 1.0))

    def _paint_pixels(self) -> Tensor:
        """Return the colours of all views with sky, haze and lines on the ground, (N, H, W, 3)."""
        from aerial_gym.sensors import MISS_ID

        images = self._caster.images
        color, points, ids = images["color"][:, 0], images["points"][:, 0], images["segmentation"][:, 0, ..., None]
        far = (points - self._eye[:, None, None]).norm(dim=-1, keepdim=True)
        flat = (
            ((points[..., 2:] - self._floor().reshape(-1, 1, 1, 1)).abs() < GROUND_BAND)
            & (ids != ROBOT_ID)
            & (ids != MISS_ID)
        )
        color = torch.where(flat, color * (1.0 - 0.5 * _line_shares(points[..., :2])), color)
        haze = (ids == GROUND_ID) * (1.0 - torch.exp(-((far / HAZE_M) ** 2)))
        color = color.lerp(color.new_tensor(HORIZON).expand_as(color), haze)
        focal = WIDTH / 2 / tan(radians(VIEW_DEG / 2))
        rise = (HEIGHT / 2 - 0.5 - torch.arange(HEIGHT, device=color.device)) / focal
        height = (torch.atan(rise) - DOWN).clamp(min=0.0).reshape(1, -1, 1, 1)
        sky = color.new_tensor(HORIZON) + (1.0 - torch.exp(-3.0 * height)) * color.new_tensor(
            [z - h for z, h in zip(ZENITH, HORIZON, strict=True)]
        )
        return torch.where(ids == MISS_ID, sky, color)

    def _draw_label(self, view: "Image", env: int) -> None:
        height = float(self._robot[env, 2] - self._floor()[env])
        words = [
            f"environment {env}",
            f"{(self._steps - 1) * self._env.dt:.1f} s",
            f"{float(self._speed[env].norm()):.1f} m/s",
        ]
        words.append(f"height {height:.1f} m")
        if self._target is not None:
            words.append(f"goal {float((self._target[env] - self._robot[env]).norm()):.2f} m away")
        write_text(view, (8, 6), "   ".join(words))

    def _draw_goal(self, view: "Image", env: int) -> None:
        """Draw a ring at the goal and a line from it to the ground."""
        from PIL import ImageDraw

        if self._target is None:
            return
        goal, draw = self._target[env].tolist(), ImageDraw.Draw(view)
        spots = [self._project(env, place) for place in (goal, [*goal[:2], float(self._floor()[env])])]
        if spots[0] is not None and spots[1] is not None:
            draw.line((*spots[0], *spots[1]), fill=(20, 120, 40), width=1)
        if spots[0] is not None:
            draw.circle(spots[0], 6, outline=(20, 120, 40), width=3)
            write_text(view, (spots[0][0] + 10, spots[0][1] - 7), "goal")

    def _project(self, env: int, place: list[float]) -> tuple[float, float] | None:
        """Return column and row of a place [m], world; None behind the camera."""
        x, y, z = (a - b for a, b in zip(place, self._eye[env].tolist(), strict=True))
        yaw = float(self._yaw[env])
        x, y = cos(yaw) * x + sin(yaw) * y, cos(yaw) * y - sin(yaw) * x
        ahead, up = cos(DOWN) * x - sin(DOWN) * z, sin(DOWN) * x + cos(DOWN) * z
        focal = WIDTH / 2 / tan(radians(VIEW_DEG / 2))
        return (WIDTH / 2 - focal * y / ahead, HEIGHT / 2 - focal * up / ahead) if ahead > 0.1 * self._size else None


def _camera() -> "RangeSensorCfg":
    from aerial_gym.config.images import LightCfg
    from aerial_gym.config.sensor import CameraCfg

    return CameraCfg(
        summary="follows a robot", source="chosen for a video", width=WIDTH, height=HEIGHT, hfov_deg=VIEW_DEG,
        min_range=0.05, max_range=FAR, position=(0.0, 0.0, 0.0), light=LightCfg(sun=(-0.4, 0.3, 0.866), ambient=0.45),
        points="world",
    )  # fmt: skip


def _line_shares(places: Tensor) -> Tensor:
    """Return the share of each pixel that grid lines cover, (N, H, W, 1), from its place in x and y [m], (N, H, W, 2).

    A pixel covers as much ground as it differs from its neighbours. Lines fade where it covers a whole field.
    """
    wide = torch.zeros_like(places)
    wide[:, :, 1:] += places.diff(dim=2).abs()
    wide[:, 1:] += places.diff(dim=1).abs()
    wide.clamp_(min=1e-4)
    off = (places / GRID_M - (places / GRID_M).round()).abs() * GRID_M
    share = ((0.5 * (LINE_M + wide) - off) / torch.minimum(wide, torch.full_like(wide, LINE_M))).clamp(0.0, 1.0)
    share = share * (LINE_M / wide).clamp(max=1.0).sqrt() * (1.0 - wide / GRID_M).clamp(min=0.0)
    return share.amax(dim=-1, keepdim=True)


def write_text(view: "Image", place: tuple[float, float], words: str) -> None:
    """Write words on a picture, from column and row of their upper left corner."""
    from PIL import ImageDraw, ImageFont

    font = ImageFont.load_default(12)
    ImageDraw.Draw(view).text(place, words, font=font, fill=(20, 20, 20), stroke_width=2, stroke_fill=(245, 245, 245))
