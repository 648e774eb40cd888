"""Markdown tables, and the documented fields of a dataclass."""

import ast
import dataclasses
import inspect
import textwrap
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class DocumentedField:
    """One field of a dataclass as a reader sees it."""

    name: str
    hint: Any
    default: Any
    text: str

    @property
    def required(self) -> bool:
        """Whether the field has no default."""
        return self.default is dataclasses.MISSING


def documented_fields(cls: type) -> list[DocumentedField]:
    """Return the fields of a dataclass, each with the docstring below it or the comment behind it."""
    hints = typing.get_type_hints(cls, include_extras=True)
    texts = field_texts(cls)
    return [
        DocumentedField(each.name, hints[each.name], _default(each), texts.get(each.name, ""))
        for each in dataclasses.fields(cls)
        if not each.name.startswith("_")
    ]


def field_texts(cls: type) -> dict[str, str]:
    """Return the docstring below, or the comment behind, each field of a class and of its bases, by name."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if dataclasses.is_dataclass(base):
            source = textwrap.dedent(inspect.getsource(base))
            (body,) = ast.parse(source).body
            texts |= _texts_by_field(typing.cast("ast.ClassDef", body).body, source.splitlines())
    return texts


def _texts_by_field(body: Sequence[ast.stmt], lines: Sequence[str]) -> dict[str, str]:
    texts = {}
    for field, below in pairwise([*body, None]):
        if isinstance(field, ast.AnnAssign):
            comment = lines[(field.end_lineno or 0) - 1].partition("  # ")[2]
            text = f"{comment}." if comment else ""
            if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                text = " ".join(str(below.value.value).split())
            texts[ast.unparse(field.target)] = text
    return texts


def trailing_comment(line: str) -> str:
    """Return the comment behind a field, as a sentence; empty for none, and for instructions to tools."""
    *code, comment = line.rpartition("  # ")
    is_meaning = code[0] and not comment.startswith(("pyright", "noqa", "type:", "fmt:"))
    return f"{comment.strip().rstrip('.')}." if is_meaning else ""


def _default(field: dataclasses.Field) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def type_text(hint: Any) -> str:
    """Return a type as users of files and commands know it."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return type_text(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(type_text(each) for each in arguments if each is not type(None))
    if origin is typing.Literal:
        return ", ".join(f"`{each}`" for each in arguments)
    if origin is tuple:
        return _tuple_text(arguments)
    if origin is not None and issubclass(origin, Mapping):
        return f"mapping of {type_text(arguments[1])}"
    return {str: "text", bool: "yes or no", Path: "path", float: "number", int: "integer"}.get(
        hint, getattr(hint, "__name__", str(hint)).removeprefix("Annotated")
    )


def _tuple_text(arguments: tuple[Any, ...]) -> str:
    if arguments[-1] is Ellipsis:
        return f"list of {type_text(arguments[0])}"
    return f"{len(arguments)} x {type_text(arguments[0])}"


def value_text(value: Any) -> str:
    """Return a default value as a file or a command line gives it."""
    if value is dataclasses.MISSING:
        return "required"
    if value is None or value in ((), {}, ""):
        return "-"
    if dataclasses.is_dataclass(value):
        return f"that of {type(value).__name__}"
    if isinstance(value, Mapping):
        return ", ".join(f"`{key}`" for key in value)
    if isinstance(value, tuple):
        return ", ".join(value_text(each) for each in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"`{value}`" if isinstance(value, (str, Path)) else f"{value:g}" if isinstance(value, float) else str(value)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: object) -> str:
    return code_marks(" ".join(str(text).split())).replace("|", "\\|").replace("<", "&lt;")


def code_marks(text: str) -> str:
    """Return a docstring with the code marks of Markdown."""
    return text.replace("``", "`").replace("::\n", ":\n")


def page(title: str, introduction: str, parts: Iterable[str]) -> str:
    """Return a page of the reference."""
    return "\n\n".join([f"# {title}", introduction, *parts]) + "\n"
