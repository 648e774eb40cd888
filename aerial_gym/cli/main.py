"""Entry point of ``aerial-gym``: subcommands are dataclasses with ``run() -> int``.

Exit status: 0 done, 1 failed, 2 wrong request (one sentence, no traceback).
"""

import os
import select
import sys
from collections.abc import Sequence
from typing import Protocol

from aerial_gym import __version__
from aerial_gym.cli import process
from aerial_gym.config.console import accept_any_console
from aerial_gym.errors import AerialGymError, StorageError, TrainingError
from aerial_gym.lazy import Home


class Command(Protocol):
    """What every subcommand can do."""

    def run(self) -> int:
        """Do it and return the exit status."""
        ...


COMMANDS: dict[str, Home] = {
    "list": Home("aerial_gym.cli.list_names:ListCmd"),
    "check": Home("aerial_gym.cli.check:CheckCmd"),
    "import-robot": Home("aerial_gym.cli.import_robot:ImportRobotCmd"),
    "tune": Home("aerial_gym.cli.tune:TuneCmd"),
    "train": Home("aerial_gym.cli.train:TrainCmd"),
    "train-encoder": Home("aerial_gym.cli.train_encoder:TrainEncoderCmd"),
    "play": Home("aerial_gym.cli.play:PlayCmd"),
    "evaluate": Home("aerial_gym.cli.evaluate:EvaluateCmd"),
    "export": Home("aerial_gym.cli.export:ExportCmd"),
    "replay": Home("aerial_gym.cli.replay:ReplayCmd"),
    "watch": Home("aerial_gym.cli.watch:WatchCmd"),
    "close-loop": Home("aerial_gym.cli.close_loop:CloseLoopCmd"),
    "identify": Home("aerial_gym.cli.identify:IdentifyCmd"),
    "bench": Home("aerial_gym.cli.bench:BenchCmd"),
    "render-gallery": Home("aerial_gym.cli.render_gallery:RenderGalleryCmd"),
    "demo": Home("aerial_gym.cli.demo.command:DemoCmd"),
}


def _overview() -> str:
    rows = [f"  {name:<12} {home.summary()}" for name, home in COMMANDS.items()]
    return "\n".join(
        [
            "usage: aerial-gym COMMAND [options]",
            "",
            *rows,
            "",
            "aerial-gym COMMAND --help lists its options; --version says which this is.",
        ]
    )


def _parse(argv: Sequence[str]) -> Command | int:
    """Return the command, or an exit status after help or a wrong request."""
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview())
        return 0 if argv else 2
    if argv[0] == "--version":
        print(f"aerial-gym {__version__}")
        return 0
    if argv[0] not in COMMANDS:
        print(f"aerial-gym: no command {argv[0]!r}. Known: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    command = COMMANDS[argv[0]].load()
    if hasattr(command, "parse"):
        return command.parse(argv[1:])
    import tyro

    return tyro.cli(command, args=argv[1:], prog=f"aerial-gym {argv[0]}")


def _is_read() -> bool:
    """Return whether anybody reads what is printed; ``| head`` that has enough does not, and nothing is said then."""
    out = select.poll()
    out.register(sys.stdout.fileno(), 0)
    if not any(event & select.POLLERR for _, event in out.poll(0)):
        return True
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is flushed at the end
    return False


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    accept_any_console()
    try:
        command = _parse(sys.argv[1:] if argv is None else argv)
        status = command if isinstance(command, int) else command.run()
        sys.stdout.flush()
        return status
    except SystemExit as stop:  # tyro's own: help (0) or a wrong flag (2)
        return int(stop.code or 0)
    except (StorageError, TrainingError) as error:
        print(f"aerial-gym: {error}", file=sys.stderr)
        return 1
    except (AerialGymError, FileNotFoundError) as error:
        print(f"aerial-gym: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if isinstance(error, BrokenPipeError) and not _is_read():
            return 1
        from aerial_gym.config.storage import storage_sentence

        print(f"aerial-gym: {storage_sentence(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("aerial-gym: interrupted", file=sys.stderr)
        return 1


def entry() -> None:
    """Console script."""
    process.begin()
    sys.exit(main())


if __name__ == "__main__":
    entry()
