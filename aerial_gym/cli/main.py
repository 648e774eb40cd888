"""Entry point of ``aerial-gym``: subcommands are dataclasses with ``run() -> int``.

Exit status: 0 done, 1 failed, 2 wrong request (one sentence, no traceback).
"""

import os
import select
import sys
from collections.abc import Sequence

from aerial_gym import __version__
from aerial_gym.cli import process
from aerial_gym.config.console import accept_any_console
from aerial_gym.errors import AerialGymError, StorageError, TrainingError
from aerial_gym.extras import optional_import
from aerial_gym.lazy import ImportPath
from aerial_gym.registry.plugins import SWITCH

RENAMED: dict[str, str] = {"import-robot": "robot import", "check": "robot check", "tune": "robot tune"}
"""Names of 0.1.0, each with its replacement; they warn for one release."""

COMMANDS: dict[str, ImportPath] = {
    "list": ImportPath("aerial_gym.cli.list_names:ListCmd"),
    "robot import": ImportPath("aerial_gym.cli.robot:ImportRobotCmd"),
    "robot check": ImportPath("aerial_gym.cli.robot:CheckRobotCmd"),
    "robot tune": ImportPath("aerial_gym.cli.robot:TuneCmd"),
    "robot from-log": ImportPath("aerial_gym.cli.robot:FromLogCmd"),
    "new": ImportPath("aerial_gym.cli.new:NewFileCmd"),
    "new robot": ImportPath("aerial_gym.cli.new:NewRobotCmd"),
    "log inspect": ImportPath("aerial_gym.cli.log:InspectLogCmd"),
    "log convert": ImportPath("aerial_gym.cli.log:ConvertLogCmd"),
    "log plot": ImportPath("aerial_gym.cli.log:PlotLogCmd"),
    "view": ImportPath("aerial_gym.cli.view:ViewCmd"),
    "train": ImportPath("aerial_gym.cli.train:TrainCmd"),
    "train-encoder": ImportPath("aerial_gym.cli.train_encoder:TrainEncoderCmd"),
    "play": ImportPath("aerial_gym.cli.play:PlayCmd"),
    "evaluate": ImportPath("aerial_gym.cli.evaluate:EvaluateCmd"),
    "robustness": ImportPath("aerial_gym.cli.robustness:RobustnessCmd"),
    "export": ImportPath("aerial_gym.cli.export:ExportCmd"),
    "preflight": ImportPath("aerial_gym.cli.preflight:PreflightCmd"),
    "replay": ImportPath("aerial_gym.cli.replay:ReplayCmd"),
    "watch": ImportPath("aerial_gym.cli.watch:WatchCmd"),
    "close-loop": ImportPath("aerial_gym.cli.close_loop:CloseLoopCmd"),
    "identify": ImportPath("aerial_gym.cli.identify:IdentifyCmd"),
    "fleet run": ImportPath("aerial_gym.cli.fleet:FleetRunCmd"),
    "fleet view": ImportPath("aerial_gym.cli.fleet:FleetViewCmd"),
    "fleet query": ImportPath("aerial_gym.cli.fleet:FleetQueryCmd"),
    "fleet watch": ImportPath("aerial_gym.cli.fleet:FleetWatchCmd"),
    "sitl betaflight": ImportPath("aerial_gym.cli.sitl:SitlBetaflightCmd"),
    "sitl crazyflie": ImportPath("aerial_gym.cli.sitl:SitlCrazyflieCmd"),
    "sitl px4": ImportPath("aerial_gym.cli.sitl:SitlPx4Cmd"),
    "bench": ImportPath("aerial_gym.cli.bench:BenchCmd"),
    "render-gallery": ImportPath("aerial_gym.cli.render_gallery:RenderGalleryCmd"),
    "demo": ImportPath("aerial_gym.cli.demo.command:DemoCmd"),
    "doctor": ImportPath("aerial_gym.cli.doctor:DoctorCmd"),
    "cache list": ImportPath("aerial_gym.cli.cache:ListCachesCmd"),
    "cache clear": ImportPath("aerial_gym.cli.cache:ClearCachesCmd"),
}


NO_PLUGINS = "--no-plugins"


def _command_overview(noun: str = "") -> str:
    names = [name for name in COMMANDS if name.startswith(noun)]
    width = max(map(len, names))
    rows = [f"  {name:<{width}} {COMMANDS[name].summary()}" for name in names]
    usage = f"usage: aerial-gym {f'{noun}VERB' if noun else 'COMMAND'} [options]"
    end = "aerial-gym COMMAND --help lists the options; --version prints the version."
    return "\n".join([usage, "", *rows, "", end, f"{NO_PLUGINS} leaves out parts of other packages, in any command."])


def _split_command_name(argv: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the name of the command, of one or two words, and the remaining arguments."""
    if argv[0] in RENAMED:
        name = RENAMED[argv[0]]
        print(f"aerial-gym: {argv[0]} is now called {name!r}; the old name works until release 0.3", file=sys.stderr)
        return name, argv[1:]
    pair = " ".join(argv[:2])
    return (pair, argv[2:]) if pair in COMMANDS else (argv[0], argv[1:])


def _run_command(argv: Sequence[str]) -> int:
    """Run the command of a command line, or print help or the refusal of a wrong request; return the exit status."""
    if NO_PLUGINS in argv:
        os.environ[SWITCH] = "1"  # also for processes that the command starts
        argv = [word for word in argv if word != NO_PLUGINS]
    if not argv or argv[0] in ("-h", "--help"):
        print(_command_overview())
        return 0 if argv else 2
    if argv[0] == "--version":
        print(f"aerial-gym {__version__}")
        return 0
    name, options = _split_command_name(argv)
    if name not in COMMANDS and any(known.startswith(f"{name} ") for known in COMMANDS):
        asked = bool(options) and options[0] in ("-h", "--help")
        print(_command_overview(f"{name} "), file=sys.stdout if asked else sys.stderr)
        return 0 if asked else 2
    if name not in COMMANDS:
        return _print_error(f"no command {name!r}. Known: {', '.join(COMMANDS)}", 2)
    with optional_import(name):
        command = COMMANDS[name].load()
        if hasattr(command, "parse"):
            return command.parse(options).run()
        import tyro

        return tyro.cli(command, args=options, prog=f"aerial-gym {name}").run()


def _print_error(message: object, status: int) -> int:
    print(f"aerial-gym: {message}", file=sys.stderr)
    return status


def _stdout_has_reader() -> bool:
    """Return whether stdout has a reader; ``| head`` closes it early, and then nothing is printed."""
    out = select.poll()
    out.register(sys.stdout.fileno(), 0)
    if not any(event & select.POLLERR for _, event in out.poll(0)):
        return True
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # receives the last flush
    return False


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    accept_any_console()
    try:
        status = _run_command(sys.argv[1:] if argv is None else argv)
        sys.stdout.flush()
        return status
    except SystemExit as stop:  # tyro's own: help (0) or a wrong flag (2)
        return int(stop.code or 0)
    except (StorageError, TrainingError) as error:
        return _print_error(error, 1)
    except AerialGymError as error:
        return _print_error(error, 2)
    except FileNotFoundError as error:
        return _print_error(error if error.filename is None else f"{error.filename}: no such file or folder", 2)
    except OSError as error:
        if isinstance(error, BrokenPipeError) and not _stdout_has_reader():
            return 1
        from aerial_gym.config.storage import storage_message

        return _print_error(storage_message(error), 1)
    except KeyboardInterrupt:
        return _print_error("interrupted", 1)


def entry() -> None:
    """Console script."""
    process.start_clock_and_preload()
    sys.exit(main())


if __name__ == "__main__":
    entry()
