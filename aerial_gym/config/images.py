"""Images of range sensors: their switches in a sensor file, and the table of their properties.

Buffers, GTD keys, delay lines, the arrays of the kernels and the checks follow from the table; a new image is a switch and
a row here, and the lines in ``sensors/pixels.py`` that write a pixel of it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aerial_gym.config.checks import Vec3, require, require_finite
from aerial_gym.config.shape import require_color

if TYPE_CHECKING:
    from aerial_gym.config.range_sensor import RangeSensorCfg

FRAMES = ("world", "sensor")  # Frames of points and normals


@dataclass(frozen=True, kw_only=True)
class LightCfg:
    """A sun and a uniform sky, in addition to the environment's lamps; surfaces are matt (Lambert), shadows
    sharp.

    A surface has its colour times ``ambient + (1 - ambient) max(n . s, 0)``, and its colour times that of every lamp, no
    channel above 1; there is no light from one surface to another. Obstacles beyond the range of a sensor throw no shadow in
    its image.
    """

    sun: Vec3 | None = (0.4, 0.3, 0.866)  # Direction to the sun, world, any length > 0; None: sky and lamps alone
    ambient: float = 0.35  # Share of the light that comes from the sky, 0 to 1; the rest comes from the sun
    shadows: bool = True  # Whether sun and lamps throw shadows: one more ray for every lit pixel and light
    sky: Vec3 = (0.6, 0.75, 0.9)  # Red, green, blue of a pixel that sees nothing, each 0 to 1

    def __post_init__(self) -> None:
        require_finite(self, "sun")
        require(self, "sun", self.sun is None or any(self.sun), "must point somewhere")
        require(self, "ambient", 0.0 <= self.ambient <= 1.0, "must lie in 0 to 1")
        require_color(self, "sky")


@dataclass(frozen=True, kw_only=True)
class ImagesCfg:
    """Images of a sensor besides the distance."""

    segmentation: bool = True  # Whether it also writes the segmentation id of each pixel
    points: str | None = None  # Frame of the image of points seen [m]: `world` or `sensor`; None for no such image
    normals: str | None = None  # Frame of the image of unit surface normals: `world` or `sensor`; None for no image
    face_ids: bool = False  # Whether it also writes which face of its shape each pixel sees

    optical_flow: bool = False
    """Whether a camera also writes how fast the image of what each pixel sees moves [pixel/s]: right, down. Sensors without an
    image plane refuse it."""

    light: LightCfg | None = None  # Light by which it also writes a colour image; None writes none

    @property
    def has_image_plane(self) -> bool:
        """Whether the model projects points onto an image, which optical flow needs."""
        return False

    @property
    def has_second_camera(self) -> bool:
        """Whether the model has a second camera, by which images are shifted."""
        return False


PixelValue = float | Vec3
SensorText = Callable[["RangeSensorCfg"], str]  # Unit, frame or meaning of an image as a function of its sensor


@dataclass(frozen=True, kw_only=True)
class Image:
    """Declaration of an image; its pixels are numbers or vectors."""

    key: str  # In the Global Tensor Dictionary, for the first sensor
    wanted: Callable[["RangeSensorCfg"], bool] | None = None  # Whether a sensor has it; None: every one
    unit: str | SensorText = "-"  # Unit
    frame: str | SensorText = "sensor"  # Frame
    meaning: str | SensorText  # One line
    ids: bool = False  # Whether pixels are whole numbers, int32; else they are float32
    components: int = 1  # Numbers of a pixel: 1, 2 or 3

    empty_pixel: PixelValue | Callable[["RangeSensorCfg"], PixelValue] | None = None
    """Pixel value without a hit; None if it depends on the sensor's pose and motion."""

    def is_enabled(self, cfg: "RangeSensorCfg") -> bool:
        """Return whether a sensor has this image."""
        return self.wanted is None or self.wanted(cfg)

    def resolve_unit(self, cfg: "RangeSensorCfg") -> str:
        """Return the image's unit for a sensor."""
        return self.unit if isinstance(self.unit, str) else self.unit(cfg)

    def resolve_frame(self, cfg: "RangeSensorCfg") -> str:
        """Return the image's frame for a sensor."""
        return self.frame if isinstance(self.frame, str) else self.frame(cfg)

    def resolve_meaning(self, cfg: "RangeSensorCfg") -> str:
        """Return the image's meaning for a sensor, one line."""
        return self.meaning if isinstance(self.meaning, str) else self.meaning(cfg)


MISS_ID = -2  # Segmentation of a pixel that sees nothing within its range. Source: parity with Aerial Gym (3.4)
MISS_FACE = -1  # Face of a pixel that sees nothing within its range


def _distance_meaning(cfg: "RangeSensorCfg") -> str:
    along = "along the optical axis" if cfg.kind == "depth" else "along the ray"
    return f"distance {along}; too far {cfg.far_pixel:g}, too near {cfg.near_pixel:g}"


IMAGES: dict[str, Image] = {
    "distance": Image(
        key="depth_range_pixels",
        unit=lambda cfg: f"{cfg.max_range:g} m" if cfg.normalize else "m",
        meaning=_distance_meaning,
        empty_pixel=lambda cfg: cfg.far_pixel,
    ),
    "segmentation": Image(
        key="segmentation_pixels",
        wanted=lambda cfg: cfg.segmentation,
        meaning=f"segmentation id; {MISS_ID} without a hit",
        ids=True,
        empty_pixel=MISS_ID,
    ),
    "points": Image(
        key="point_cloud_pixels",
        wanted=lambda cfg: cfg.points is not None,
        unit="m",
        frame=lambda cfg: cfg.points or "-",
        meaning="point of the hit; the sensor's own origin without a valid distance",
        components=3,
    ),
    "normals": Image(
        key="normal_pixels",
        wanted=lambda cfg: cfg.normals is not None,
        frame=lambda cfg: cfg.normals or "-",
        meaning="unit normal of the surface, towards the sensor; 0 without a hit",
        components=3,
        empty_pixel=(0.0, 0.0, 0.0),
    ),
    "face_ids": Image(
        key="face_id_pixels",
        wanted=lambda cfg: cfg.face_ids,
        meaning="triangle of a mesh; box: 2 axis + (1 for the upper side); cylinder: 0 side, 1 bottom, 2 top; "
        f"{MISS_FACE} without a hit",
        ids=True,
        empty_pixel=MISS_FACE,
    ),
    "disparity": Image(
        key="disparity_pixels",
        wanted=lambda cfg: cfg.has_second_camera,
        unit="pixel",
        meaning="shift of the second image, f |b| / z; 0 for an invalid pixel",
        empty_pixel=0.0,
    ),
    "color": Image(
        key="rgb_pixels",
        wanted=lambda cfg: cfg.light is not None,
        meaning="red, green, blue, each 0 to 1",
        components=3,
        empty_pixel=lambda cfg: (cfg.light or LightCfg()).sky,
    ),
    "optical_flow": Image(
        key="optical_flow_pixels",
        wanted=lambda cfg: cfg.optical_flow,
        unit="pixel/s",
        frame="image",
        meaning="image velocity of the true hit: right, down; a miss counts as a point at infinity",
        components=2,
    ),
}
"""Every image, by the name that it has in the code."""
