"""The table of images, and the nearest distance in each cell of an image against a loop over cells."""

from math import inf

import numpy as np
import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.config.images import IMAGES, Image, LightCfg
from aerial_gym.config.sensor import CameraCfg, StereoCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.errors import ShapeError
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import RayCaster, SensorImages, SensorManager, make_images, pixels, ray_kernels
from aerial_gym.sensors.images import POISON, NearestInCells, arrays_type, sensor_images
from aerial_gym.sensors.mounts import Carrier

pytestmark = pytest.mark.usefixtures("few_rays")

SIZE = {"width": 8, "height": 6, "hfov_deg": 60.0, "min_range": 0.0, "max_range": 5.0, "source": "chosen for the test"}
STEREO = StereoCfg(
    summary="every image that there is", baseline=-0.1, points="sensor", normals="world", face_ids=True, optical_flow=True,
    light=LightCfg(sky=(0.25, 0.5, 0.75)), **SIZE,
)  # fmt: skip
CAMERA = CameraCfg(summary="two images", latency_s=0.02, **SIZE)
POSE = {"position": torch.zeros(2, 3), "attitude": torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(2, 1)}


def wall(depth: float) -> Scene:
    state = torch.zeros(2, 1, 13)
    state[..., 0], state[..., 6] = depth + 0.1, 1.0
    rows = torch.zeros(1, dtype=torch.long)
    box = ShapeCfg(kind="box", size=(0.2, 60.0, 60.0))
    return Scene([box], shape_index=rows, semantic_id=rows, asset_state=state)


def test_a_pixel_that_sees_nothing_holds_what_the_table_says() -> None:
    images = make_images(STEREO, 2, device=torch.device("cpu"), poisoned=True)
    assert set(images) == set(IMAGES)
    RayCaster(STEREO, wall(30.0), images, Carrier(**POSE, lin_vel=torch.zeros(2, 3), ang_vel=torch.zeros(2, 3))).cast()
    for name, row in sensor_images(STEREO).items():
        empty = row.empty_pixel(STEREO) if callable(row.empty_pixel) else row.empty_pixel
        expected = torch.zeros(()) if empty is None else torch.tensor(empty)  # at rest at the origin
        assert torch.equal(images[name], expected.to(images[name].dtype).expand_as(images[name])), name


def test_images_must_be_exactly_those_of_the_sensor() -> None:
    device = torch.device("cpu")
    images = make_images(CAMERA, 2, device=device)
    images.check(CAMERA, 2, device)
    told = "must be given exactly if the sensor has such an image: it is"
    with pytest.raises(ShapeError, match=f"segmentation {told} True"):
        SensorImages(distance=images.distance).check(CAMERA, 2, device)
    with pytest.raises(ShapeError, match=f"normals {told} False"):
        SensorImages(**images, normals=torch.zeros(2, 1, 6, 8, 3)).check(CAMERA, 2, device)
    with pytest.raises(ShapeError, match=r"segmentation is \(2, 1, 6, 8\) torch.float32"):
        SensorImages(distance=images.distance, segmentation=images.distance).check(CAMERA, 2, device)
    with pytest.raises(AttributeError, match="no image 'depth'. Known: distance, segmentation"):
        _ = images.depth


def test_a_kernel_has_arrays_for_the_images_of_its_sensor_alone() -> None:
    struct = arrays_type(tuple(sensor_images(CAMERA)))()
    assert not hasattr(struct, "normals")
    assert hasattr(struct, "segmentation")


def test_a_new_image_needs_a_row_and_the_code_that_writes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    row = Image(key="heading_pixels", unit="m", frame="sensor", meaning="x of the ray, distance", components=2)
    monkeypatch.setitem(IMAGES, "heading", row)

    def make_write_pixel(outputs: pixels.PixelOutputs) -> wp.Function:
        write_others, images_type = pixels.make_write_pixel(outputs), arrays_type(outputs.images)

        @wp.func
        def write_pixel(
            images: images_type, limits: pixels.DistanceLimits, noise: pixels.DistanceNoise, light: pixels.Light,
            view: pixels.SensorView, env: int, mount: int, seat: int, pixel: int, ray: wp.vec3, nearest: float,
            hit: int,
        ):  # fmt: skip
            write_others(images, limits, noise, light, view, env, mount, seat, pixel, ray, nearest, hit)
            images.heading[mount, pixel] = wp.vec2(ray[0], nearest)

        return write_pixel

    monkeypatch.setattr(ray_kernels, "make_write_pixel", make_write_pixel)
    gtd = GlobalTensorDictionary(device=torch.device("cpu"), sizes={"E": 2})
    manager = SensorManager(
        {"camera": CAMERA}, gtd, wall(3.0), Carrier(**POSE), num_envs=2, device=torch.device("cpu"), dt=0.01
    )
    spec = gtd.spec("heading_pixels")
    assert (spec.shape, spec.unit, spec.frame) == (("E", "S", "H", "W", 2), "m", "sensor")
    caster = manager.casters["camera"]
    caster.images["heading"].fill_(POISON[torch.float32])
    manager.capture()
    result = gtd["heading_pixels"]
    torch.testing.assert_close(result[0, 0, ..., 0], caster.direction[..., 0])
    torch.testing.assert_close(result[..., 0] * result[..., 1], torch.full((2, 1, 6, 8), 3.0))
    POSE["position"][:, 0] = 1.0
    manager.capture()
    POSE["position"][:, 0] = 0.0
    torch.testing.assert_close(result[..., 0] * result[..., 1], torch.full((2, 1, 6, 8), 3.0))  # it is delayed too
    missing_heading = SensorImages(distance=caster.images.distance, segmentation=caster.images.segmentation)
    with pytest.raises(ShapeError, match="heading must be given exactly if the sensor has such an image: it is True"):
        missing_heading.check(CAMERA, 2, torch.device("cpu"))


DEVICES = ["cpu", *(["cuda:0"] if torch.cuda.is_available() else [])]


def reference(image: Tensor, cells: tuple[int, int], *, largest: float, empty: float) -> np.ndarray:
    """Return the nearest distance in each cell as a share of ``largest``, (E, R, C), by a loop over cells."""
    pixels = image[:, 0].cpu().numpy()
    size = [-(-n // parts) for n, parts in zip(pixels.shape[1:], cells, strict=True)]
    result = np.full((len(pixels), *cells), empty, dtype=np.float32)
    for env, row, column in np.ndindex(*result.shape):
        cell = pixels[env, row * size[0] : (row + 1) * size[0], column * size[1] : (column + 1) * size[1]]
        held = cell[cell >= 0.0]
        if held.size and held.min() < inf:
            result[env, row, column] = held.min() / np.float32(largest)
    return result


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("height", "width"), [(135, 240), (8, 8), (5, 70), (64, 7), (20, 520), (24, 40)])
def test_cells_hold_the_smallest_distance_of_their_pixels(device: str, height: int, width: int) -> None:
    image = 0.2 + 9.8 * torch.rand(3, 2, height, width, generator=torch.Generator().manual_seed(0))
    image[:, :, ::5, ::3] = -1.0
    image[1, 0, height // 2 :, width // 2 :] = -1.0  # whole cells
    image[2, 0, : height // 2] = inf
    image = image.to(device)
    kept = NearestInCells(image, cells=(8, 8), largest=10.0, empty=0.25)
    kept.nearest.fill_(float("nan"))
    kept.measure()
    expected = reference(image, (8, 8), largest=10.0, empty=0.25)
    assert np.array_equal(kept.nearest.cpu().numpy().reshape(3, 8, 8), expected)
    assert (expected == 0.25).any()
    image.fill_(5.0)  # the next image is seen at once
    kept.measure()
    assert kept.nearest[0, 0].item() == 0.5


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"image is \(2, 0, 0, 0\) torch.float32, expected \(E, S, H, W\)"):
        NearestInCells(torch.zeros(2, 0, 0, 0), cells=(8, 8), largest=1.0, empty=1.0)
