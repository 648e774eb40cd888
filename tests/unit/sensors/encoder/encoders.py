"""An encoder that needs no training."""

import torch

from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import sensor_by_name
from aerial_gym.sensors.encoder.file import Autoencoder, AutoencoderCfg, Encoder, encoder_image_format

ROBOT = "base_quadrotor_with_coarse_camera"


def coarse_camera() -> RangeSensorCfg:
    return sensor_by_name(str(ROBOTS.get(ROBOT).sensors[0]))


def random_encoder(*, latents: int = 64, seed: int = 0) -> Encoder:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = Autoencoder(AutoencoderCfg(rows=24, columns=40, latents=latents, channels=(4, 8)))
    return Encoder(network, encoder_image_format(coarse_camera()), trained={"robot": ROBOT})
