"""The page of commands: every flag with type, default and meaning."""

import inspect
import typing
from collections.abc import Iterator
from dataclasses import is_dataclass

import tyro

from aerial_gym.cli.main import COMMANDS
from docs.generate.markdown import (
    DocumentedField,
    code_marks,
    documented_fields,
    page,
    table,
    type_text,
    value_text,
)

INTRODUCTION = (
    "For users of the command line. `aerial-gym COMMAND --help` prints the same. Every command returns 0 for success, "
    "1 for a failure and 2 for a wrong request."
)


def command_page() -> str:
    """Return the page of all commands."""
    return page("Commands", INTRODUCTION, (_section(name, home.load()) for name, home in COMMANDS.items()))


def _section(name: str, command: type) -> str:
    return "\n\n".join([f"## `aerial-gym {name}`", code_marks(inspect.getdoc(command) or ""), *_tables(name, command)])


def _tables(name: str, command: type) -> Iterator[str]:
    """Yield the table of options of a command, or those of its subcommands."""
    subcommands = dict(_subcommands(command))
    if not subcommands:
        own_parser = hasattr(command, "parse")
        rows = (_row(field, positional=own_parser) for field in documented_fields(command))
        yield table(("option", "type", "default", "meaning"), rows)
    for verb, subcommand in subcommands.items():
        yield f"### `aerial-gym {name} {verb}`"
        yield code_marks(inspect.getdoc(subcommand) or "")
        yield from _tables(f"{name} {verb}", subcommand)


def _subcommands(command: type) -> Iterator[tuple[str, type]]:
    """Yield the name and class of each subcommand: members of a union field of dataclasses."""
    for hint in typing.get_type_hints(command, include_extras=True).values():
        for member in typing.get_args(_without_annotation(hint)):
            subcommand = _without_annotation(member)
            if is_dataclass(subcommand):
                yield member.__metadata__[0].name, typing.cast("type", subcommand)


def _without_annotation(hint: object) -> object:
    return typing.get_args(hint)[0] if typing.get_origin(hint) is typing.Annotated else hint


def _row(field: DocumentedField, *, positional: bool) -> tuple[str, str, str, str]:
    if field.hint is bool:
        name = field.name.replace("_", "-")
        return f"`--no-{name}`" if field.default else f"`--{name}`", "flag", "-", field.text
    positional |= tyro.conf.Positional in getattr(field.hint, "__metadata__", ())
    name = field.name.upper() if positional else "--" + field.name.replace("_", "-")
    return f"`{name}`", type_text(field.hint), value_text(field.default), field.text
