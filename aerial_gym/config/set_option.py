"""The option ``--set KEY=VALUE`` of commands."""

from typing import Annotated

import tyro

SetOption = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="KEY=VALUE")]
