"""Entry point of ``aerial-gym``: subcommands are dataclasses with ``run() -> int``.

Exit status: 0 done, 1 failed, 2 wrong request (one sentence, no traceback).
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from aerial_gym.errors import AerialGymError


class Command(Protocol):
    """What every subcommand can do."""

    def run(self) -> int:
        """Do it and return the exit status."""
        ...


@dataclass(frozen=True)
class _Home:
    """Where a subcommand's dataclass stands; loaded only when it is asked for."""

    module: str
    name: str


COMMANDS: dict[str, _Home] = {
    "list": _Home("aerial_gym.cli.list_names", "ListCmd"),
    "train": _Home("aerial_gym.cli.train", "TrainCmd"),
    "play": _Home("aerial_gym.cli.play", "PlayCmd"),
    "evaluate": _Home("aerial_gym.cli.evaluate", "EvaluateCmd"),
    "replay": _Home("aerial_gym.cli.replay", "ReplayCmd"),
    "close-loop": _Home("aerial_gym.cli.close_loop", "CloseLoopCmd"),
    "identify": _Home("aerial_gym.cli.identify", "IdentifyCmd"),
    "bench": _Home("aerial_gym.cli.bench.command", "BenchCmd"),
    "render-gallery": _Home("aerial_gym.cli.render_gallery", "RenderGalleryCmd"),
    "demo": _Home("aerial_gym.cli.demo.command", "DemoCmd"),
}


def _load(name: str) -> type[Any]:
    home = COMMANDS[name]
    return getattr(import_module(home.module), home.name)


def _overview() -> str:
    rows = [f"  {name:<12} {(_load(name).__doc__ or '').splitlines()[0]}" for name in COMMANDS]
    return "\n".join(
        ["usage: aerial-gym COMMAND [options]", "", *rows, "", "aerial-gym COMMAND --help lists its options."]
    )


def _parse(argv: Sequence[str]) -> Command | int:
    """Return the command, or an exit status after help or a wrong request."""
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview())
        return 0 if argv else 2
    if argv[0] not in COMMANDS:
        print(f"aerial-gym: no command {argv[0]!r}. Known: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    import tyro

    return tyro.cli(_load(argv[0]), args=argv[1:], prog=f"aerial-gym {argv[0]}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        command = _parse(sys.argv[1:] if argv is None else argv)
        return command if isinstance(command, int) else command.run()
    except SystemExit as stop:  # tyro's own: help (0) or a wrong flag (2)
        return int(stop.code or 0)
    except (AerialGymError, FileNotFoundError) as error:
        print(f"aerial-gym: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("aerial-gym: interrupted", file=sys.stderr)
        return 1


def entry() -> None:
    """Console script."""
    sys.exit(main())


if __name__ == "__main__":
    entry()
