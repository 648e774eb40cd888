"""The training of an encoder and the folder that it leaves.

::

    config.yaml     the settings, from which it can be repeated
    versions.json   versions and machine of every session
    curve.csv       loss and error on other scenes after each epoch
    checkpoint.pth  the state after an epoch, for --resume
    encoder.pt      the encoder for tasks (``--encoder``)
    result.json     figures on test images, with those of the baselines
    images.png      some test images and their reconstructions

Order and noise of an epoch depend on seed and epoch alone, so that a resumed training is identical.
Letters: N images, H x W pixels.
"""

import csv
import io
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import torch

from aerial_gym.config import dump_yaml, load
from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.config.storage import read_archive, storage_errors, write_archive, write_atomic
from aerial_gym.errors import ConfigError, TrainingError
from aerial_gym.extras import require
from aerial_gym.interop import resolve_device, usual_settings
from aerial_gym.rl_training.encoder.figures import (
    AT_ONCE,
    ImageErrors,
    count_active_latents,
    draw_reconstructions,
    image_errors,
    reconstruct_by_components,
    reconstruct_by_encoder,
    reconstruct_by_mean,
)
from aerial_gym.rl_training.encoder.scenes import ImageSet, ProgressReport, image_sensor, render_images
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg
from aerial_gym.rl_training.run.checkpoint_keeper import interruptible
from aerial_gym.rl_training.run.run_folder import append_session
from aerial_gym.sensors.encoder.file import Autoencoder, Encoder, encoder_image_format, negative_evidence

END_SHARE = 0.01  # Share of the learning rate that is left at the end


class EncoderFit:
    """Network, optimiser, and the number of epochs that are done."""

    def __init__(self, cfg: EncoderTrainingCfg, images: ImageSet) -> None:
        self._cfg, self._images = cfg, images
        _, rows, columns = images.seen.shape
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(cfg.seed)
            network = Autoencoder(cfg.autoencoder_cfg(rows=rows, columns=columns))
        self.network = network.to(images.seen.device)  # The autoencoder
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=cfg.learning_rate)  # Adam
        self.epochs = 0  # Epochs that are done

    def state(self) -> dict[str, Any]:
        """Return the content of a checkpoint."""
        return {"epochs": self.epochs, "network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load(self, state: Mapping[str, Any]) -> None:
        """Resume from the content of a checkpoint."""
        self.epochs = int(state["epochs"])
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])

    def run_epoch(self) -> float:
        """Pass over all images once; return the mean of the bound of their negative log evidence [nat], up to a constant."""
        cfg, device = self._cfg, self._images.seen.device
        noise = torch.Generator(device).manual_seed(cfg.seed + self.epochs)
        order = torch.randperm(len(self._images), generator=torch.Generator().manual_seed(cfg.seed + self.epochs))
        parts = order.to(device).split(cfg.batch)
        total = torch.zeros((), device=device)
        for number, rows in enumerate(parts):
            share = (self.epochs + number / len(parts)) / cfg.epochs
            self.optimizer.param_groups[0]["lr"] = cfg.learning_rate * (1.0 - (1.0 - END_SHARE) * share)
            seen, target = self._images.seen[rows], self._images.target[rows]
            mean, log_variance = self.network.encode(seen)
            drawn = torch.randn(mean.shape, generator=noise, device=device)
            loss = negative_evidence(
                target, self.network.decode(mean + (0.5 * log_variance).exp() * drawn), mean, log_variance
            )
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()
            self.optimizer.step()
            total += loss.detach() * len(rows)
        self.epochs += 1
        return float(total) / len(self._images)


SAVE_EVERY_S = 5.0  # Time between checkpoints [s]
SHOWN = 6  # Images in the picture
ENCODER, MEAN = "encoder", "mean_image"  # Names of reconstructions, besides `pca_<latents>`


@dataclass(frozen=True, kw_only=True)
class EncoderResult:
    """Result of a training session, with reconstruction errors on test images."""

    encoder: str | None  # The file; None if it was interrupted before the end
    robot: str  # Robot whose sensor it was trained for
    epochs: int  # Epochs in all sessions
    interrupted: bool  # Whether the user ended it
    time_s: float  # Length of this session, rendering and figures included [s]
    active_latents: int | None = None  # Number of latents with variance over images
    errors: Mapping[str, ImageErrors] = field(default_factory=dict)  # On test images: `encoder`, `pca_64`, `mean_image`
    errors_by_env: Mapping[str, ImageErrors] = field(default_factory=dict)  # Errors of the encoder by environment


class EncoderFolder:
    """Paths and files of one training."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        names = ("config.yaml", "checkpoint.pth", "encoder.pt", "curve.csv", "result.json", "images.png")
        self.config, self.checkpoint, self.encoder, self.curve, self.result, self.picture = (
            self.path / name for name in names
        )

    def create(self, cfg: EncoderTrainingCfg) -> None:
        """Make the folder and write the settings; raise ``ConfigError`` if it holds a training."""
        if self.config.exists():
            raise ConfigError(f"{self.path}: holds a training already. Choose another --out, or go on with --resume")
        with storage_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
        write_atomic(self.config, dump_yaml(cfg))

    def settings(self) -> EncoderTrainingCfg:
        """Return the settings; raise ``ConfigError`` if there are none."""
        if not self.config.exists():
            raise ConfigError(f"{self.path}: holds no training of an encoder (no config.yaml). Leave out --resume")
        return load(EncoderTrainingCfg, self.config)


@usual_settings
def train_encoder(
    cfg: EncoderTrainingCfg, out: str | Path, *, resume: bool = False, tell: ProgressReport = lambda _, __: None
) -> EncoderResult:
    """Render the images, learn, measure, and leave a folder.

    Args:
        cfg: Settings; a resumed training keeps its own, but for ``device``.
        out: Folder, new unless ``resume``.
        resume: Whether to continue from the folder's checkpoint, on one device as without the interruption.
        tell: Receives the progress: a description of the work, and the share that is done.
    """
    require("the picture of a trained encoder", "matplotlib")
    started, folder, device = time.perf_counter(), EncoderFolder(out), resolve_device(cfg.device)
    if resume:
        cfg = _resume_settings(cfg, folder.settings())
    sensor = image_sensor(cfg)
    if not resume:
        folder.create(cfg)
    append_session(folder.path, seed=cfg.seed, device=str(device))
    train = render_images(cfg, cfg.train_images, seed=cfg.seed, device=device, tell=tell)
    test = render_images(cfg, cfg.test_images, seed=cfg.seed + 1, device=device, tell=tell)
    session = _Session(cfg, folder, EncoderFit(cfg, train), train, test, sensor)
    if resume:
        session.load()
    interrupted = session.fit_epochs(tell)
    figures: dict[str, Any] = {}
    if not interrupted:
        tell("measuring", 0.0)
        figures = session.write_encoder_and_figures()
    result = EncoderResult(
        encoder=None if interrupted else str(folder.encoder), robot=cfg.robot, epochs=session.fit.epochs,
        interrupted=interrupted, time_s=time.perf_counter() - started, **figures,
    )  # fmt: skip
    write_atomic(folder.result, json.dumps(asdict(result), indent=1) + "\n")
    return result


def _resume_settings(given: EncoderTrainingCfg, own: EncoderTrainingCfg) -> EncoderTrainingCfg:
    """Return the settings of a resumed training; raise ``ConfigError`` on a change of settings."""
    plain = EncoderTrainingCfg()
    for each in fields(EncoderTrainingCfg):
        wanted = getattr(given, each.name)
        if each.name != "device" and wanted not in (getattr(own, each.name), getattr(plain, each.name)):
            flag = each.name.replace("_", "-")
            raise ConfigError(f"--{flag}: a resumed training keeps its own. Leave it out, or start anew in a new --out")
    return replace(own, device=given.device)


@dataclass
class _Session:
    """One session of a training."""

    cfg: EncoderTrainingCfg
    folder: EncoderFolder
    fit: EncoderFit
    train: ImageSet
    test: ImageSet
    sensor: RangeSensorCfg
    curve: list[list[float]] = field(default_factory=list)  # Rows of curve.csv

    def load(self) -> None:
        """Load the checkpoint, if the training was ended after its first."""
        file = self.folder.checkpoint
        if not file.exists():
            return
        payload = read_archive(file, "checkpoint")
        try:
            self.fit.load(payload["fit"])
            self.curve = [list(row) for row in payload["curve"]]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise ConfigError(f"{file}: is of other settings ({error}). Start anew in another --out") from None

    def fit_epochs(self, tell: ProgressReport) -> bool:
        """Pass over the images until all epochs are done or somebody ends it; return whether somebody did."""
        fit, epochs, saved = self.fit, self.cfg.epochs, time.perf_counter()
        with interruptible() as interruption, suppress(KeyboardInterrupt):
            while fit.epochs < epochs:
                tell("learning", fit.epochs / epochs)
                loss = fit.run_epoch()
                if not abs(loss) < float("inf"):
                    fault = f"loss = {loss} after {fit.epochs} epochs: the training diverged"
                    raise TrainingError(f"{fault}. Lower learning_rate")
                self.curve.append([fit.epochs, loss, self._test_error()])
                if time.perf_counter() - saved >= SAVE_EVERY_S or fit.epochs >= epochs:
                    with interruption.defer():
                        self._save()
                    saved = time.perf_counter()
        return fit.epochs < epochs or interruption.asked

    @torch.no_grad()
    def _test_error(self) -> float:
        """Return the error of test images, reconstructed from the means of their latents [m]."""
        network = self.fit.network
        told = torch.cat([network.decode(network.encode(part)[0]) for part in self.test.seen.split(AT_ONCE)])
        return image_errors(told, self.test.target, largest=self.sensor.max_range).rms_m

    def _save(self) -> None:
        write_archive(self.folder.checkpoint, {"fit": self.fit.state(), "curve": self.curve})
        text = io.StringIO()
        csv.writer(text).writerows([["epoch", "loss_nat", "test_rms_m"], *self.curve])
        write_atomic(self.folder.curve, text.getvalue())

    def write_encoder_and_figures(self) -> dict[str, Any]:
        """Write the encoder, draw the picture, and return the results of a comparison with the baselines."""
        cfg, test, largest = self.cfg, self.test, self.sensor.max_range
        trained = {
            "robot": cfg.robot, "envs": list(cfg.envs), "target": cfg.target, "seed": cfg.seed,
            "epochs": self.fit.epochs, "train_images": cfg.train_images,
        }  # fmt: skip
        encoder = Encoder(self.fit.network, encoder_image_format(self.sensor), trained=trained)
        encoder.save(self.folder.encoder)
        components = f"pca_{cfg.latents}"
        told = {
            ENCODER: reconstruct_by_encoder(encoder, self.fit.network)(test.seen),
            components: reconstruct_by_components(self.train, cfg.latents)(test.seen),
            MEAN: reconstruct_by_mean(self.train)(test.seen),
        }
        rows = torch.linspace(0, len(test) - 1, min(SHOWN, len(test))).long().to(test.seen.device)
        shown = {"seen": test.seen} | ({"target": test.target} if cfg.target != "distance" else {})
        shown |= {name: told[name] for name in (ENCODER, components)}
        picture = {name: images[rows] for name, images in shown.items()}
        draw_reconstructions(picture, self.folder.picture, largest=largest)
        of_env = {env: test.env == i for i, env in enumerate(cfg.envs)}
        return {
            "active_latents": count_active_latents(encoder, test.seen),
            "errors": {name: image_errors(each, test.target, largest=largest) for name, each in told.items()},
            "errors_by_env": {
                env: image_errors(told[ENCODER][rows], test.target[rows], largest=largest)
                for env, rows in of_env.items()
            },
        }
