"""``aerial-gym replay``: comparison of the declared model with flights, without fits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line


@dataclass(frozen=True, kw_only=True)
class ReplayCmd:
    """Compare a robot as declared with measured flights: residuals and open-loop rollouts.

    Unusable logs are named and left out; the exit status is then 1.
    """

    robot: Annotated[str, tyro.conf.Positional]  # Registered robot, or a robot file (.yaml)
    flights: Annotated[tuple[Path, ...], tyro.conf.Positional]  # Flight logs
    out: Path | None = None  # Folder for replay.json, report.html, residuals.csv, profiles.csv; nothing if not given

    mapping: str | None = None
    """Layout of the logs: a name (idsia_nanodrone) or a mapping file (.yaml); the package's own layout if not given."""

    bandwidth_hz: float = 10.0
    """Measured and predicted are compared below this frequency [Hz]; at most a fifth of the logs' rate is used."""

    setpoints: bool = False
    """Fly the recorded setpoints with the vehicle's own control law, its parameters from the log, in short windows from
    measured states; compare tracking and effort with the flight."""

    corrected: str | None = None  # Corrected robot (robot.yaml of close-loop) that flies the setpoints as well
    controller: str | None = None  # Registered controller for the setpoints; that of the log's firmware if not given
    seed: int = 0  # Seed of the resampling behind the 95 % intervals
    json: bool = False  # Print one JSON object on stdout instead of tables

    def run(self) -> int:
        """Replay the flights and print the figures; return the exit status."""
        from aerial_gym.sim2real import replay
        from aerial_gym.sim2real.flight_replay import replay_rollout_rows, round_trip_rows
        from aerial_gym.sim2real.report.tables import SHOWN_NOTES, channel_rows
        from aerial_gym.sim2real.wording import text

        with progress_bar() as progress:
            result = replay(
                self.robot, self.flights, self.out, mapping=self.mapping, bandwidth=self.bandwidth_hz, seed=self.seed,
                setpoints=self.setpoints, corrected=self.corrected, controller=self.controller, progress=progress,
            )  # fmt: skip
        if self.json:
            print(json_line(result.as_mapping()))
            return int(bool(result.left_out))
        console = Console(markup=False)
        console.print(text(result.answer))
        rows = [[str(row[key]) for key in ("name", "before", "floor")] for row in channel_rows(result.evaluation, None)]
        head = ("channel", "residual", "noise floor")
        print_table(rows, head, title="measured minus predicted (rms, 95 % interval)")
        rows = [[row["variant"].replace("_", " "), *list(row.values())[1:]] for row in replay_rollout_rows(result)]
        head = ("variant", "quantity", "after [s]", "error")
        print_table(rows, head, title="open-loop error (rms over windows, 95 % interval)")
        if rows := [list(row.values()) for row in round_trip_rows(result.round_trip)]:
            head = ("setpoints", "quantity", "after [s]", "declared", "corrected", "change")
            print_table(
                rows, head, title="round trip: simulated minus measured flight (rms over windows, 95 % interval)"
            )
        for note in result.notes[:SHOWN_NOTES]:
            console.print(f"note: {text(note)}")
        if (more := len(result.notes) - SHOWN_NOTES) > 0:
            place = "in the report" if self.out else "with --json, or in the report of --out"
            console.print(f"{more} more notes {place}")
        return int(bool(result.left_out))
