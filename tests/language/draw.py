"""Draw names and docstrings for a reader who sees no code: ``python -m tests.language.draw [COUNT]``. The hash of the
last commit is the seed. The reader explains each in one sentence, and a second person compares with the code."""

import ast
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]

Row = tuple[str, str, str]
"""Module, qualified name, first paragraph of the docstring."""


def rows(node: ast.AST, module: str, owner: str = "") -> Iterator[Row]:
    """Yield the functions and classes in a syntax tree, without special methods."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            name = f"{owner}.{child.name}".strip(".")
            if not child.name.startswith("__"):
                yield module, name, " ".join((ast.get_docstring(child) or "").split("\n\n")[0].split())
            yield from rows(child, module, name)


def main(count: int) -> None:
    """Print the draw."""
    command = ["git", "rev-parse", "HEAD"]
    seed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    draw, files = random.Random(seed), sorted((ROOT / "aerial_gym").rglob("*.py"))
    modules = ((str(file.relative_to(ROOT)), ast.parse(file.read_text("utf-8"))) for file in files)
    candidates = [row for module, tree in modules for row in rows(tree, module)]
    print(f"commit {seed}")
    for module, name, _ in draw.sample(sorted(candidates), count):
        print(f"name: {module} {name}")
    for module, name, text in draw.sample(sorted(row for row in candidates if row[2]), count):
        print(f"docstring: {module} {name}: {text}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
