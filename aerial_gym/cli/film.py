"""A video of a flight, seen by a colour camera that follows the robot; drawn by the rays that robots' own cameras use."""

from dataclasses import replace
from math import cos, radians, sin, tan
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from aerial_gym.errors import ConfigError, MissingDependencyError

if TYPE_CHECKING:
    from PIL.Image import Image

    from aerial_gym.task import Task

KINDS = (".gif", ".webp", ".png")  # Endings of files that hold moving pictures, written by Pillow
WIDTH, HEIGHT, VIEW_DEG, FAR = 480, 270, 70.0, 60.0  # Pixels, angle of view across, and how far the camera sees [m]
BEHIND, ABOVE, DOWN = 1.6, 0.7, 0.4  # Offset of the camera from the robot [m], world, and its downward pitch [rad]
FOLLOWS_S = 0.3  # Time in which the camera follows the robot [s], so that the robot moves in the picture

FRAMES_PER_S = 25.0


def check_film(file: Path) -> None:
    """Raise an error if no video can be written with this name."""
    if file.suffix not in KINDS:
        raise ConfigError(f"--video {file}: must end in {', '.join(KINDS)}; ffmpeg -i FILE.gif FILE.mp4 makes an mp4")
    try:
        import PIL  # noqa: F401
    except ImportError:
        raise MissingDependencyError("--video needs the package 'pillow': pip install pillow") from None


def write_visible_robot(name: str, folder: str) -> str:
    """Write and return a robot file with visible shapes: its own, or arms and rotors, the front ones in red."""
    from aerial_gym.config import dump_yaml
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.robots.looks import arm_parts, rotor_parts

    robot, file = robot_by_name(name), Path(folder) / "robot.yaml"
    shapes = robot.visual or (*arm_parts(robot), *rotor_parts(robot))
    text = dump_yaml(replace(robot, visible=True, visual=shapes))
    file.write_text(text, encoding="utf-8", errors="surrogateescape")
    return str(file)


class Film:
    """Frames of the first environment of a task, whose robot is visible."""

    def __init__(self, task: "Task") -> None:
        from aerial_gym.config.images import LightCfg
        from aerial_gym.config.sensor import CameraCfg
        from aerial_gym.sensors import RayCaster, make_images
        from aerial_gym.sensors.mounts import Carrier
        from aerial_gym.task.commands.command import TARGET

        self._robot, device, rows = task.env.gtd["robot_position"], task.device, task.num_envs
        self._target = task.target_position if TARGET in task.values else None
        cfg = CameraCfg(
            summary="follows a robot", source="chosen for a video", width=WIDTH, height=HEIGHT, hfov_deg=VIEW_DEG,
            min_range=0.05, max_range=FAR, position=(0.0, 0.0, 0.0), light=LightCfg(sun=(-0.4, 0.3, 0.866), ambient=0.45),
        )  # fmt: skip
        self._images = make_images(cfg, rows, device=device)
        self._place = torch.zeros(rows, 3, device=device)
        attitude = torch.tensor([0.0, sin(DOWN / 2), 0.0, cos(DOWN / 2)], device=device)
        still = torch.zeros(rows, 3, device=device)
        carrier = Carrier(position=self._place, attitude=attitude.repeat(rows, 1), lin_vel=still, ang_vel=still)
        scene = task.env.asset_manager.scene
        self._caster = RayCaster(cfg, scene, self._images, carrier, random=task.env.random)
        self._caster.reset(torch.ones(rows, dtype=torch.bool, device=device))
        self._caster.due.zero_()[0] = True
        self._dt, self._every = task.env.dt, max(1, round(1.0 / (FRAMES_PER_S * task.env.dt)))
        self._steps, self._frames = 0, list["Image"]()

    def render_frame(self, *, begins: bool) -> None:
        """Render a frame if one is due; the camera jumps to the robot at the start of an episode."""
        from PIL import Image

        behind = self._robot + self._robot.new_tensor([-BEHIND, 0.0, ABOVE])
        share = 1.0 if begins or self._steps == 0 else min(1.0, self._dt / FOLLOWS_S)
        self._place.lerp_(behind, share)
        if self._steps % self._every == 0:
            self._caster.cast()
            assert self._images.color is not None
            pixels = (255.0 * self._images.color[0, 0].clamp(0.0, 1.0)).byte().cpu().numpy()
            frame = Image.fromarray(pixels)
            if self._target is not None:
                _draw_target(frame, (self._target[0] - self._place[0]).tolist())
            self._frames.append(frame)
        self._steps += 1

    def save(self, file: Path) -> None:
        """Write the frames, each shown as long as it lasted."""
        first, *rest = self._frames
        shown = round(1000.0 * self._every * self._dt)
        first.save(file, save_all=True, append_images=rest, duration=shown, loop=0)


def _draw_target(frame: "Image", to_target: list[float]) -> None:
    """Draw a ring where the target is, (3,) from the camera [m], world."""
    from PIL import ImageDraw

    x, y, z = to_target
    ahead, up = cos(DOWN) * x - sin(DOWN) * z, sin(DOWN) * x + cos(DOWN) * z
    if ahead > 0.1:
        focal = WIDTH / 2 / tan(radians(VIEW_DEG / 2))
        column, row = WIDTH / 2 - focal * y / ahead, HEIGHT / 2 - focal * up / ahead
        ImageDraw.Draw(frame).circle((column, row), 5, outline=(20, 120, 40), width=2)
