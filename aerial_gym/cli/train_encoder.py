"""``aerial-gym train-encoder``: range images as a few numbers, for tasks that see latents."""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg

if TYPE_CHECKING:
    from aerial_gym.rl_training.encoder.training import EncoderResult


@dataclass(frozen=True, kw_only=True)
class TrainEncoderCmd(EncoderTrainingCfg):
    """Train an encoder of range images, a variational autoencoder, on scenes of registered environments."""

    out: Path = Path("runs/encoder")  # Folder: settings, checkpoint, encoder.pt, figures, picture. New, unless --resume
    resume: bool = False  # Go on with the training in --out from its last checkpoint, with its own settings
    json: bool = False  # Print the result as one JSON object

    def run(self) -> int:
        """Train, measure on images of other scenes, print; return the exit status, 1 if it was interrupted."""
        from aerial_gym.rl_training.encoder.training import train_encoder

        names = [each.name for each in fields(EncoderTrainingCfg)]
        cfg = EncoderTrainingCfg(**{name: getattr(self, name) for name in names})
        with progress_bar() as progress:
            result = train_encoder(cfg, self.out, resume=self.resume, tell=progress)
        if self.json:
            print(json.dumps(asdict(result)))
        else:
            self._print_result(result)
        return int(result.interrupted)

    def _print_result(self, result: "EncoderResult") -> None:
        console = Console(markup=False, highlight=False)
        console.print(
            f"{'interrupted' if result.interrupted else 'trained'}: {result.epochs} epochs, {result.time_s:.0f} s"
        )
        if result.interrupted:
            console.print(f"next: aerial-gym train-encoder --out {self.out} --resume")
            return
        rows = []
        for name, errors in [*result.errors.items(), *result.errors_by_env.items()]:
            near = "-" if errors.near_rms_m is None else f"{errors.near_rms_m:.3f}"
            rows.append((name, f"{errors.rms_m:.3f}", f"{errors.mean_m:.3f}", near))
        print_table(rows, ("told by, on other scenes", "rms [m]", "mean [m]", "rms of near pixels [m]"))
        console.print(f"latents that tell images apart: {result.active_latents}")
        console.print(
            f"next: aerial-gym train --task navigation_task --robot {result.robot} --encoder {result.encoder}",
            soft_wrap=True,
        )
