"""The command ``aerial-gym demo``."""

import platform
import shutil
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.console import Console

from aerial_gym.cli.terminal import open_in_browser
from aerial_gym.errors import ConfigError

IDSIA_FLIGHTS = Path("../shared/data/idsia_nanodrone")
TEMPLATES = Path(__file__).parents[1] / "templates"


@dataclass(frozen=True, kw_only=True)
class DemoCmd:
    """Show everything in one page: a policy learns, cameras look, a measured flight corrects the model."""

    out: Path = Path("out/demo")  # Folder that receives `index.html`; what an earlier demo left there is replaced

    flights: Path | None = None
    """Folder with the idsia_nanodrone flights; if not given, ``../shared/data/idsia_nanodrone`` where it exists, else
    flights of the undeclared plant."""

    train_time_s: float = 75.0  # Length of the training [s]
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given
    seed: int = 1  # Seed of everything
    open: bool = False  # Open the page in the browser

    def run(self) -> int:
        """Run the three parts and write the page; return the exit status."""
        from aerial_gym.cli.demo.parts import close_the_loop, find_or_simulate_flights, record_cameras, train_hover
        from aerial_gym.interop import one_thread
        from aerial_gym.sim2real.report.page import write_page

        console, started = Console(stderr=True), time.perf_counter()

        def announce(stage: str) -> None:
            console.print(stage_line(stage, time.perf_counter() - started))

        _remove_earlier_demo(self.out)
        flights = find_or_simulate_flights(
            self.flights or (IDSIA_FLIGHTS if IDSIA_FLIGHTS.is_dir() else None), self.out, self.seed
        )
        with one_thread():
            announce("[bold]1/3 look[/]: cameras in the obstacle environment")
            seen = record_cameras(self.seed, self.backend)
            announce(f"[bold]2/3 learn[/]: a hover policy from scratch, {self.train_time_s:.0f} s")
            learned = train_hover(self.out, self.seed, self.train_time_s, self.backend)
            announce(f"[bold]3/3 measure[/]: {len(flights.train)} training and {len(flights.test)} test flights")
            measured = close_the_loop(flights, self.out / "loop")
        path = self.out / "index.html"
        machine = f"{platform.platform()}, Python {platform.python_version()}, torch {metadata.version('torch')}"
        context = {"seen": seen, "learned": learned, "measured": measured, "machine": machine}
        write_page(path, "demo.html", context | {"time_s": time.perf_counter() - started}, TEMPLATES)
        announce("done")
        print(path)
        if self.open:
            open_in_browser(path)
        return 0


def stage_line(stage: str, since_start_s: float) -> str:
    """Return the line that announces a stage, with the time of its begin since the start of the demo [s] ahead."""
    return f"at {since_start_s:.0f} s: {stage}"


def _remove_earlier_demo(out: Path) -> None:
    """Remove the files of an earlier demo; refuse a folder that holds anything else."""
    if not out.exists():
        return
    known = {"index.html", "training", "loop", "flights"}
    foreign = sorted(path.name for path in out.iterdir() if path.name not in known) if out.is_dir() else [out.name]
    if foreign:
        raise ConfigError(f"--out {out}: holds {foreign[0]!r}, which is not of a demo. Choose another folder")
    shutil.rmtree(out)
