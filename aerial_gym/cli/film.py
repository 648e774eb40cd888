"""A video of flights: for each environment a chase camera, with what the robot's own sensors see beside it.

The pictures come from a scene of their own, with a ground and a visible robot: neither physics nor sensors see them.
Letters: N environments shown, H x W pixels.
"""

from dataclasses import replace
from math import ceil, cos, hypot, radians, sin, sqrt, tan
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.config.shape import GROUND_ID, ROBOT_ID
from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import ConfigError, MissingDependencyError

if TYPE_CHECKING:
    import numpy as np
    from PIL.Image import Image

    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.config.sensor import RangeSensorCfg
    from aerial_gym.config.shape import PartCfg
    from aerial_gym.env_manager import EnvManager
    from aerial_gym.sensors import SensorImages
    from aerial_gym.task import Task

KINDS = (".gif", ".webp", ".png", ".mp4")  # Endings of files; imageio-ffmpeg writes mp4, Pillow the others
WIDTH, HEIGHT, VIEW_DEG, FAR = 480, 270, 70.0, 200.0  # Pixels, angle of view across, and how far the camera sees [m]
MOST_VIEWS = 4  # Environments in a film, unless more are asked for
PANEL = 240  # Width of the column with the images of sensors [pixels]
MOST_PANELS = 3  # Images of sensors in one column
BEHIND, ABOVE, DOWN = 3.2, 1.1, 0.26  # Camera from the robot, per diameter of the robot, and its downward pitch [rad]
FOLLOWS_S, TURNS_S = 0.3, 1.0  # Times in which the camera follows the robot and turns to its direction of motion [s]
MOST_LAG = 0.6  # Largest distance of the camera from its place, per diameter of the robot
WALL_MARGIN = 0.05  # Distance that the camera keeps from an obstacle behind it, per diameter of the robot
LEAST_SPEED = 0.3  # Speed from which the camera turns to the direction of motion [m/s]
GRID_M, LINE_M = 1.0, 0.02  # Distance and width of the lines on the ground [m]
GROUND_BAND = 0.1  # Surfaces within this height of the ground have lines, such as floors [m]
HAZE_M = 60.0  # Distance in which the ground fades to the horizon [m]
GROUND_COLOR, HORIZON, ZENITH = (0.62, 0.63, 0.6), (0.86, 0.9, 0.94), (0.42, 0.62, 0.88)

FRAMES_PER_S = 25.0


def check_film(file: Path) -> None:
    """Raise an error if no video can be written with this name."""
    if file.suffix not in KINDS:
        raise ConfigError(f"--video {file}: must end in {', '.join(KINDS)}")
    try:
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401
    except ImportError:
        raise MissingDependencyError("--video needs matplotlib: pip install 'aerial-gym[sim2real]'") from None
    if file.suffix == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401  # pyright: ignore[reportMissingImports]
        except ImportError:
            rule = "needs the package 'imageio-ffmpeg': pip install imageio-ffmpeg, or end the name in .gif or .webp"
            raise MissingDependencyError(f"--video {file}: {rule}") from None


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


def sensor_images(env: "EnvManager") -> "dict[str, tuple[RangeSensorCfg, SensorImages]]":
    """Return settings and images, late as they are, of each kind of range sensor by its name."""
    from aerial_gym.config.images import IMAGES
    from aerial_gym.sensors import SensorImages

    seen = {}
    for number, (name, caster) in enumerate(env.sensor_manager.casters.items()):
        prefix = f"{name}_" if number else ""
        images = {image: env.gtd[prefix + IMAGES[image].key] for image in caster.images}
        seen[name] = (caster.cfg, SensorImages(**images))
    return seen


def ground_part(env: "EnvManager") -> "PartCfg":
    """Return the ground of an environment; one without ground has it at the lowest bound, for pictures alone."""
    from aerial_gym.config.shape import PartCfg, ShapeCfg

    height = env.cfg.bounds_lower_low[2]
    plain = PartCfg(
        shape=ShapeCfg(kind="plane", color=GROUND_COLOR), position=(0.0, 0.0, height), semantic_id=GROUND_ID
    )
    return env.cfg.ground_part or plain


class Film:
    """Frames of the first environments of a task, side by side."""

    def __init__(self, task: "Task", count: int = 1) -> None:
        """Build the cameras of ``count`` environments."""
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
                count, fixed=(ground,), robot=parts, robot_state=link_states(env), robot_links=robot.link_names
            )
            caster = RayCaster(
                cfg, scene, make_images(cfg, count, device=device), Carrier(position=position, attitude=attitude)
            )
            caster.reset(torch.ones(count, dtype=torch.bool, device=device))
            return caster

        self._caster = look(_camera(), self._eye, self._view, visible_parts(robot))
        ray = replace(_camera(), width=1, height=1, hfov_deg=1.0, kind="range", points=None, light=None)
        self._probe = look(ray, self._robot, self._back, ())
        self._every = max(1, round(1.0 / (FRAMES_PER_S * env.dt)))
        self._steps, self._frames = 0, list["Image"]()

    def render_frame(self, begins: Tensor) -> None:
        """Render a frame if one is due; the camera jumps to robots whose episode begins, bool (E,)."""
        self._follow_robots(begins[: self._count, None])
        if self._steps % self._every == 0:
            self._avoid_obstacles()
            self._caster.cast()
            pixels = (255.0 * self._paint_pixels().clamp(0.0, 1.0)).byte().cpu().numpy()
            self._frames.append(self._tile_views(pixels))
        self._steps += 1

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

    def _tile_views(self, pixels: "np.ndarray") -> "Image":
        """Return one picture of all environments with labels, goals and images of sensors."""
        from PIL import Image

        sensors = sensor_images(self._env)
        wide, columns = WIDTH + (PANEL if sensors else 0), ceil(sqrt(self._count))
        frame = Image.new("RGB", (columns * wide, ceil(self._count / columns) * HEIGHT), (40, 40, 40))
        for env in range(self._count):
            view = Image.fromarray(pixels[env])
            self._draw_goal(view, env)
            self._draw_label(view, env)
            place = (env % columns * wide, env // columns * HEIGHT)
            frame.paste(view, place)
            if sensors:
                frame.paste(_sensor_column(sensors, env), (place[0] + WIDTH, place[1]))
        return frame

    def _draw_label(self, view: "Image", env: int) -> None:
        height = float(self._robot[env, 2] - self._floor()[env])
        words = [
            f"environment {env}",
            f"{self._steps * self._env.dt:.1f} s",
            f"{float(self._speed[env].norm()):.1f} m/s",
        ]
        words.append(f"height {height:.1f} m")
        if self._target is not None:
            words.append(f"goal {float((self._target[env] - self._robot[env]).norm()):.2f} m away")
        _write_text(view, (8, 6), "   ".join(words))

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
            _write_text(view, (spots[0][0] + 10, spots[0][1] - 7), "goal")

    def _project(self, env: int, place: list[float]) -> tuple[float, float] | None:
        """Return column and row of a place [m], world; None behind the camera."""
        x, y, z = (a - b for a, b in zip(place, self._eye[env].tolist(), strict=True))
        yaw = float(self._yaw[env])
        x, y = cos(yaw) * x + sin(yaw) * y, cos(yaw) * y - sin(yaw) * x
        ahead, up = cos(DOWN) * x - sin(DOWN) * z, sin(DOWN) * x + cos(DOWN) * z
        focal = WIDTH / 2 / tan(radians(VIEW_DEG / 2))
        return (WIDTH / 2 - focal * y / ahead, HEIGHT / 2 - focal * up / ahead) if ahead > 0.1 * self._size else None

    def save(self, file: Path) -> None:
        """Write the frames, each shown as long as it lasted."""
        if not self._frames:
            return
        shown = self._every * self._env.dt
        first, *rest = self._frames
        with storage_errors(file, only_full=True):
            if file.suffix != ".mp4":
                first.save(file, save_all=True, append_images=rest, duration=round(1000.0 * shown), loop=0)
                return
            from imageio_ffmpeg import write_frames  # pyright: ignore[reportMissingImports]

            writer = write_frames(str(file), first.size, fps=1.0 / shown, macro_block_size=2, quality=8)
            writer.send(None)
            for frame in self._frames:
                writer.send(frame.tobytes())
            writer.close()


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


def _sensor_column(sensors: "dict[str, tuple[RangeSensorCfg, SensorImages]]", env: int) -> "Image":
    """Return the first images of the sensors of an environment, one above the other."""
    import numpy as np
    from PIL import Image, ImageOps

    from aerial_gym.cli.render_gallery import image_colors

    shown = [
        (f"{name}: {title}" if len(sensors) > 1 else title, colors)
        for name, (cfg, images) in sensors.items()
        for title, colors in image_colors(cfg, images, env).items()
    ][:MOST_PANELS]
    column = Image.new("RGB", (PANEL, HEIGHT), (40, 40, 40))
    for number, (title, colors) in enumerate(shown):
        picture = Image.fromarray((255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8))
        picture = ImageOps.contain(picture, (PANEL - 4, HEIGHT // len(shown) - 4), Image.Resampling.NEAREST)
        _write_text(picture, (4, 2), title)
        column.paste(picture, ((PANEL - picture.width) // 2, number * HEIGHT // len(shown) + 2))
    return column


def _write_text(view: "Image", place: tuple[float, float], words: str) -> None:
    from PIL import ImageDraw, ImageFont

    font = ImageFont.load_default(12)
    ImageDraw.Draw(view).text(place, words, font=font, fill=(20, 20, 20), stroke_width=2, stroke_fill=(245, 245, 245))
