"""``aerial-gym export``: a trained policy for where there is no simulator."""

import json
import logging
import warnings
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from aerial_gym.cli.progress import progress_bar


@dataclass(frozen=True, kw_only=True)
class ExportCmd:
    """Write a trained policy as ONNX, TorchScript or C99, with its normaliser, limits and layout."""

    policy: Path
    """Run folder of a training, of which the last checkpoint is taken, or one checkpoint in it."""

    to: tuple[str, ...] = ("onnx",)
    """onnx, torchscript, c99: one or more of them."""

    out: Path | None = None
    """Folder; export/ in the run folder if not given."""

    robot: str | None = None
    """Registered robot, or a robot file, in place of the training's: the corrected vehicle, or yours for a policy of many."""

    name: str | None = None
    """Of files and C functions; that of the task if not given."""

    check: bool = True
    """Run what was written on 100,000 observations and compare it with torch."""

    json: bool = False
    """Print one JSON object per format."""

    def run(self) -> int:
        """Write, compare, print; return 0, or 1 where something written is not what torch gives."""
        from aerial_gym.export import export_policy
        from aerial_gym.rl_training.run.run_folder import run_folder_of

        folder = self.policy if self.policy.is_dir() else run_folder_of(self.policy).path
        out = self.out or folder / "export"
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        with progress_bar() as progress, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the exporters, about names of axes
            progress("writing", 0.0)
            found = export_policy(self.policy, out, self.to, robot=self.robot, name=self.name, check=self.check)
            progress("writing", 1.0)
        if self.json:
            for each in found:
                print(
                    json.dumps({"to": each.to, "file": str(each.file), "largest_difference": each.largest_difference})
                )
        else:
            table = Table(box=None, pad_edge=False)
            for column in ("format", "file", "kB", "largest difference from torch"):
                table.add_column(column)
            for each in found:
                told = each.not_checked if each.largest_difference is None else f"{each.largest_difference:.1e}"
                table.add_row(each.to, str(each.file), f"{each.file.stat().st_size / 1e3:.0f}", f"{told}")
            Console(markup=False).print(table)
            print(f"{out / 'policy.json'}: what goes in and what comes out, entry by entry")
        return int(any((each.largest_difference or 0.0) > AGREES for each in found))


AGREES = 1e-5
"""An action, command or latent further from that of torch is not taken for rounding."""
