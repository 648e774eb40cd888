"""A video of flights: for each environment a chase camera, with what the robot's own sensors see beside it.

Letters: E environments.
"""

from math import ceil, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import ConfigError, MissingDependencyError
from aerial_gym.extras import require
from aerial_gym.task.chase_view import HEIGHT, WIDTH, ChaseView, write_text

if TYPE_CHECKING:
    from PIL.Image import Image

    from aerial_gym.config.sensor import RangeSensorCfg
    from aerial_gym.env_manager import EnvManager
    from aerial_gym.sensors import SensorImages
    from aerial_gym.task import Task

KINDS = (".gif", ".webp", ".png", ".mp4")  # Endings of files; imageio-ffmpeg writes mp4, Pillow the others
MOST_VIEWS = 4  # Environments in a film, unless more are asked for
PANEL = 240  # Width of the column with the images of sensors [pixels]
MOST_PANELS = 3  # Images of sensors in one column
FRAMES_PER_S = 25.0  # Frames of a film per second of flight


def check_film(file: Path) -> None:
    """Raise an error if no video can be written with this name."""
    if file.suffix not in KINDS:
        raise ConfigError(f"--video {file}: must end in {', '.join(KINDS)}")
    require("--video", "matplotlib", "PIL")
    if file.suffix == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401  # pyright: ignore[reportMissingImports]
        except ImportError:
            rule = "needs the package 'imageio-ffmpeg': pip install imageio-ffmpeg, or end the name in .gif or .webp"
            raise MissingDependencyError(f"--video {file}: {rule}") from None


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


class Film(ChaseView):
    """Frames of the first environments of a task, side by side."""

    def __init__(self, task: "Task", count: int = 1) -> None:
        """Build the cameras of ``count`` environments."""
        super().__init__(task, count)
        self._every = max(1, round(1.0 / (FRAMES_PER_S * task.env.dt)))
        self._frames = list["Image"]()

    def render_frame(self, begins: Tensor) -> None:
        """Render a frame if one is due; the camera jumps to robots whose episode begins, bool (E,)."""
        due = self._steps % self._every == 0
        self.follow(begins)
        if due:
            self._frames.append(self._tile_views(self.pictures()))

    def _tile_views(self, views: "list[Image]") -> "Image":
        """Return one picture of all environments with images of sensors."""
        from PIL import Image

        sensors = sensor_images(self._env)
        wide, columns = WIDTH + (PANEL if sensors else 0), ceil(sqrt(self._count))
        frame = Image.new("RGB", (columns * wide, ceil(self._count / columns) * HEIGHT), (40, 40, 40))
        for env, view in enumerate(views):
            place = (env % columns * wide, env // columns * HEIGHT)
            frame.paste(view, place)
            if sensors:
                frame.paste(_sensor_column(sensors, env), (place[0] + WIDTH, place[1]))
        return frame

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
        write_text(picture, (4, 2), title)
        column.paste(picture, ((PANEL - picture.width) // 2, number * HEIGHT // len(shown) + 2))
    return column
