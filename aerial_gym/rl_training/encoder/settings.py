"""Settings of the training of an encoder."""

from dataclasses import dataclass

from aerial_gym.config.checks import require, require_choice, require_count, require_positive
from aerial_gym.sensors.encoder.file import AutoencoderCfg

TARGETS = ("distance", "collision")  # Targets of an encoder: the sensor's image, or its collision distances


@dataclass(frozen=True, kw_only=True)
class EncoderTrainingCfg:
    """One training: written as ``config.yaml`` into its folder, from which it can be repeated."""

    envs: tuple[str, ...] = ("env_with_obstacles",)
    """Registered environments, or environment files, for the scenes; each has an equal share of the images."""

    robot: str = "base_quadrotor_with_coarse_camera"  # Robot, or robot file; its first camera or lidar takes images

    target: str = "distance"
    """``distance``: the image itself; ``collision``: how far a ball as large as the robot could fly along each ray."""

    radius_m: float | None = None  # Radius of that ball [m], > 0; default: reach of the robot from its origin
    train_images: int = 20_000  # Images to learn from, >= 1
    test_images: int = 2_000  # Images of other scenes, to measure with, >= 1
    epochs: int = 40  # Passes over the images, >= 1
    batch: int = 256  # Images of a step, >= 1
    learning_rate: float = 1.0e-3  # Step of Adam at first, > 0; it falls linearly to a hundredth of it
    latents: int = 64  # Number of latents of an image, >= 1; navigation takes 64
    channels: tuple[int, ...] = (32, 64, 128)  # Channels of the layers, each of which halves the image, each >= 1
    activation: str = "elu"  # `elu`, `relu` or `tanh`
    seed: int = 0  # Of scenes, weights, order and noise, >= 0; the images to measure with have the next one
    device: str = "auto"  # Torch device; auto takes the GPU if there is one

    def __post_init__(self) -> None:
        require_count(self, "train_images", "test_images", "epochs", "batch")
        require_positive(self, "learning_rate", "radius_m")
        require_choice(self, "target", TARGETS)
        enough = bool(self.envs) and min(self.train_images, self.test_images) >= len(self.envs)
        require(self, "envs", enough, "needs at least one environment, and an image of each in both sets")
        require(self, "seed", 0 <= self.seed < 2**32 - 1, "must be >= 0 and less than 2**32 - 1")
        self.autoencoder_cfg(rows=1, columns=1)

    def autoencoder_cfg(self, *, rows: int, columns: int) -> AutoencoderCfg:
        """Return the configuration of the autoencoder for images of ``rows`` x ``columns`` pixels."""
        return AutoencoderCfg(
            rows=rows, columns=columns, latents=self.latents, channels=self.channels, activation=self.activation
        )
