"""``aerial-gym export``: conversion of a trained policy for use without the simulator."""

import json
import logging
import sys
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.cli.terminal import print_table, progress_bar

if TYPE_CHECKING:
    from aerial_gym.export import Exported


@dataclass(frozen=True, kw_only=True)
class ExportCmd:
    """Write a trained policy as ONNX, TorchScript, C99 or for an engine on board, with normaliser, limits and layout."""

    policy: Path  # Run folder of a training, of which the last checkpoint is taken, one checkpoint in it, or pretrained/NAME
    to: tuple[str, ...] = ("onnx",)  # One or more of onnx, torchscript, c99, crazyflie, tflm, raptor
    out: Path | None = None  # Folder; export/ in the run folder, or here of pretrained/NAME, if not given

    robot: str | None = None
    """Registered robot, or a robot file, in place of the training's: the corrected vehicle, or yours for a policy of many."""

    name: str | None = None  # Of files and C functions; that of the task if not given
    check: bool = True  # Run each file on 100,000 observations and compare it with torch
    preflight: Path | None = None  # Result of aerial-gym preflight --out; its hash goes into policy.json
    allow_contradicted: bool = False  # Export although that result contradicts the robot file
    json: bool = False  # Print one JSON object per format

    def run(self) -> int:
        """Write, compare, print; return 0, or 1 if a file is not the policy."""
        exports = self.result()
        for each in exports:
            if each.agrees is False:
                print(_disagreement_message(each), file=sys.stderr)
        if self.json:
            for each in exports:
                print(json.dumps(_json_row(each)))
        else:
            print_table(map(_table_row, exports), ("format", "file", "kB", "error", "limit", "output"))
            print(f"{self._folder() / 'policy.json'}: inputs and outputs, entry by entry")
        return int(any(each.agrees is False for each in exports))

    def result(self) -> "list[Exported]":
        """Write and compare."""
        from aerial_gym.export.export import export_policy

        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        with progress_bar() as progress, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the exporters, about names of axes
            progress("writing", 0.0)
            exports = export_policy(
                self.policy, self._folder(), self.to, robot=self.robot, name=self.name, check=self.check,
                preflight=self.preflight, allow_contradicted=self.allow_contradicted,
            )  # fmt: skip
            progress("writing", 1.0)
        return exports

    def _folder(self) -> Path:
        from aerial_gym.rl_training.policies.catalog import policy_path
        from aerial_gym.rl_training.run.run_folder import run_folder_of_checkpoint

        pretrained, given = policy_path(self.policy) != self.policy, self.policy.is_dir()
        folder = Path() if pretrained else self.policy if given else run_folder_of_checkpoint(self.policy).path
        return self.out or folder / "export"


def _json_row(each: "Exported") -> dict[str, object]:
    row: dict[str, object] = {"to": each.to, "file": str(each.file), "largest_difference": each.largest_difference}
    worst = each.agreement
    return row if worst is None else row | {**asdict(worst), "limit": worst.limit, "agrees": worst.holds}


def _table_row(each: "Exported") -> tuple[str, ...]:
    """Return format, file, size, error, limit and output of a file; of one that was not checked, the reason."""
    row, worst = (each.to, str(each.file), f"{each.file.stat().st_size / 1e3:.0f}"), each.agreement
    if worst is None:
        return *row, str(each.not_checked), "", ""
    return *row, f"{worst.error:.1e}", f"{worst.limit:.1e}", worst.output


def _disagreement_message(each: "Exported") -> str:
    worst = each.agreement
    assert worst is not None
    return (
        f"{each.file}: {worst.output} is {worst.error:.3g} from torch in float64. The limit is {worst.limit:.3g}: "
        "ten times the rounding of float32. Do not fly this file; export another format"
    )
