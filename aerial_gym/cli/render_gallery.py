"""``aerial-gym render-gallery``: one page with a picture of every sensor in every environment."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.cli.terminal import open_in_browser, progress_bar

if TYPE_CHECKING:
    import numpy as np

    from aerial_gym.config.sensor import RangeSensorCfg
    from aerial_gym.env_manager import EnvManager
    from aerial_gym.sensors import SensorImages

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True, kw_only=True)
class RenderGalleryCmd:
    """Show what every registered sensor sees in every registered environment, on one page."""

    out: Path  # Folder that receives `index.html`
    environments: tuple[str, ...] = ()  # Registered environments; all that have obstacles if not given
    sensors: tuple[str, ...] = ()  # Registered sensors; all of them if not given
    device: str = "cpu"  # Torch device; auto takes the GPU if there is one
    seed: int = 0  # Seed of the obstacles and of the start
    open: bool = False  # Open the page in the browser

    def run(self) -> int:
        """Render everything and write the page; return the exit status."""
        from aerial_gym.assets import ENVIRONMENTS
        from aerial_gym.sensors import SENSORS
        from aerial_gym.sim2real.report.page import write_page

        furnished = (name for name in sorted(ENVIRONMENTS) if ENVIRONMENTS.get(name).num_assets)
        environments = self.environments or tuple(furnished)
        sensors = {name: SENSORS.get(name) for name in self.sensors or sorted(SENSORS)}
        sections, total = [], len(environments) * len(sensors)
        with progress_bar() as progress:
            for name in environments:
                entries = []
                env = self._build_environment(name)
                for sensor, cfg in sensors.items():
                    progress(f"{name}: {sensor}", (len(sections) * len(sensors) + len(entries)) / total)
                    entries.append({"name": sensor, "summary": cfg.summary, "pictures": _sensor_pictures(env, cfg)})
                sections.append({"name": name, "summary": env.cfg.summary, "sensors": entries})
        self.out.mkdir(parents=True, exist_ok=True)
        path = self.out / "index.html"
        write_page(path, "gallery.html", {"sections": sections}, TEMPLATES)
        print(path)
        if self.open:
            open_in_browser(path)
        return 0

    def _build_environment(self, name: str) -> "EnvManager":
        from aerial_gym.env_manager import SimBuilder

        env = SimBuilder().build_env(
            sim_name="base_sim", env_name=name, robot_name="base_quadrotor", controller_name="lee_attitude_control",
            num_envs=1, device=self.device, seed=self.seed,
        )  # fmt: skip
        env.reset()
        return env


def _sensor_pictures(env: "EnvManager", cfg: "RangeSensorCfg") -> list[dict[str, str]]:
    """Return every image that a sensor writes at the robot's start, moving ahead at 1 m/s, as title and ``data:`` address."""
    import torch

    from aerial_gym.math.quaternion import quat_rotate
    from aerial_gym.sensors import RayCaster, make_images
    from aerial_gym.sensors.mounts import Carrier

    images, attitude = make_images(cfg, 1, device=env.device), env.gtd["robot_orientation"]
    ahead = quat_rotate(attitude, torch.tensor([[1.0, 0.0, 0.0]], device=env.device))
    carrier = Carrier(position=env.gtd["robot_position"], attitude=attitude, lin_vel=ahead, ang_vel=0.0 * ahead)
    caster = RayCaster(cfg, env.asset_manager.scene, images, carrier, random=env.random)
    caster.reset(torch.ones(1, dtype=torch.bool, device=env.device))
    caster.cast()

    return [{"title": title, "url": png_url(colors)} for title, colors in image_colors(cfg, images).items()]


def image_colors(cfg: "RangeSensorCfg", images: "SensorImages", env: int = 0) -> "dict[str, np.ndarray]":
    """Return the images of the first sensor of a kind in colours from 0 to 1, (H, W, 3), by title."""
    import numpy as np

    def distance_colors(distance: "np.ndarray") -> "np.ndarray":
        return share_colors(np.where(distance < 0.0, np.nan, distance / (1.0 if cfg.normalize else cfg.max_range)))

    def height_colors(points: "np.ndarray") -> "np.ndarray":
        height = points[..., 2]
        return share_colors((height - height.min()) / max(float(np.ptp(height)), 1e-6))

    kinds: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
        "distance": (str(cfg.kind), distance_colors), "segmentation": ("segmentation", id_colors),
        "face_ids": ("faces", id_colors), "normals": (f"normals, {cfg.normals}", lambda normals: 0.5 + 0.5 * normals),
        "disparity": ("disparity", lambda shift: share_colors(1.0 - shift / max(float(shift.max()), 1e-6))),
        "optical_flow": ("optical flow", _flow_colors), "color": ("colour", lambda color: color),
        "points": (f"height of the points, {cfg.points}", height_colors),
    }  # fmt: skip
    return {
        title: colors(images[name][env, 0].cpu().numpy()) for name, (title, colors) in kinds.items() if name in images
    }


def share_colors(share: "np.ndarray") -> "np.ndarray":
    """Return shares of 1 in colour, NaN in grey."""
    import numpy as np
    from matplotlib import colormaps

    colors = colormaps["viridis_r"](np.nan_to_num(np.clip(share, 0.0, 1.0)))[..., :3]
    colors[np.isnan(share)] = 0.85
    return colors


def _flow_colors(flow: "np.ndarray") -> "np.ndarray":
    """Return vectors in the hue of their direction (right is red, down is yellow-green), the fuller the longer; 0 is white.
    The 99th percentile has the full colour."""
    import numpy as np
    from matplotlib.colors import hsv_to_rgb

    length = np.hypot(flow[..., 0], flow[..., 1])
    hue = np.mod(np.arctan2(flow[..., 1], flow[..., 0]) / (2.0 * np.pi), 1.0)
    full = np.clip(length / max(float(np.quantile(length, 0.99)), 1e-6), 0.0, 1.0)
    return hsv_to_rgb(np.stack((hue, full, np.ones_like(hue)), axis=-1))


def id_colors(ids: "np.ndarray") -> "np.ndarray":
    """Return ids in colours of their own, negative ones in grey."""
    import numpy as np

    palette = np.random.default_rng(3).uniform(0.15, 0.95, (997, 3))
    colors = palette[np.mod(ids, 997)]
    colors[ids < 0] = 0.85
    return colors


def png_bytes(colors: "np.ndarray") -> bytes:
    """Return an image in the format PNG; colours from 0 to 1, (H, W, 3)."""
    import io

    import numpy as np
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray((255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8)).save(buffer, format="png")
    return buffer.getvalue()


def png_url(colors: "np.ndarray") -> str:
    """Return an image as a ``data:`` address."""
    import base64

    return "data:image/png;base64," + base64.b64encode(png_bytes(colors)).decode()
