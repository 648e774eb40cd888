"""Epochs of autoencoder training; order and noise depend on seed and epoch alone, so that a resumed training is identical.

Letters: N images, H x W pixels.
"""

from collections.abc import Mapping
from typing import Any

import torch

from aerial_gym.rl_training.encoder.scenes import ImageSet
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg
from aerial_gym.sensors.encoder.file import Autoencoder, negative_evidence

END_SHARE = 0.01  # Share of the learning rate that is left at the end


class EncoderFit:
    """Network, optimiser, and the number of epochs that are done."""

    def __init__(self, cfg: EncoderTrainingCfg, images: ImageSet) -> None:
        """Make a network for the images; its weights follow from the seed."""
        self._cfg, self._images = cfg, images
        _, rows, columns = images.seen.shape
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(cfg.seed)
            network = Autoencoder(cfg.network(rows=rows, columns=columns))
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
            self._set_learning_rate((self.epochs + number / len(parts)) / cfg.epochs)
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

    def _set_learning_rate(self, share: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self._cfg.learning_rate * (1.0 - (1.0 - END_SHARE) * share)
