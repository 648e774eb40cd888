"""Mutation test of formulas: ``python -m tests.mutation [NAME ...]`` changes one sign, factor or term at a time.

A change is killed if a test with an independent reference fails. The command prints killed and all changes of each formula, and
every change that survives; such a change is equivalent, or a reference is missing. Run it after a change of a formula.
"""

import ast
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from copy import deepcopy
from functools import partial
from importlib import import_module
from inspect import unwrap
from itertools import chain
from pathlib import Path
from types import CodeType, ModuleType

import pytest
import torch

from aerial_gym.interop.rows.operations import CODE

CASES = """
px4: control.px4.cascade: unit/control/px4/test_controller.py cross/test_px4.py
allocation: control.allocation: unit/control/test_allocation.py
crazyflie pid: control.crazyflie.pid: cross/test_crazyflie.py unit/control/crazyflie/test_controller.py
mellinger: control.crazyflie.mellinger: cross/test_crazyflie.py unit/control/crazyflie/test_controller.py
crazyflie distribution: control.crazyflie.distribution: cross/test_crazyflie.py unit/control/crazyflie/test_controller.py
betaflight: control.betaflight.controller: unit/control/betaflight/test_controller.py
link drag: physics.effects.links: cross/mujoco/test_bending.py physics/articulated/test_link_drag.py
link buoyancy: physics.effects.water: physics/articulated/test_link_buoyancy.py physics/test_water.py
added mass: physics.integrators: physics/test_water.py
rotor lag: physics.rotor_lag: physics/test_rotor_modes.py physics/test_late_commands.py
operations: interop.rows.operations: unit/interop/rows/test_operations.py
simplification: interop.rows.simplification: unit/interop/rows unit/physics/test_packing.py
"""
"""Name of a formula, module of ``aerial_gym``, and tests with independent references."""

SWAPS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.GtE, ast.Gt: ast.LtE,
         ast.LtE: ast.Gt, ast.GtE: ast.Lt, ast.BitAnd: ast.BitOr}  # fmt: skip
"""Operators and the ones that replace them."""

NAMES = {"minimum": "maximum", "maximum": "minimum", "clamp_min": "clamp_max", "clamp_max": "clamp_min", "sin": "cos",
         "cos": "sin", "abs": "neg", "amin": "amax", "amax": "amin", "any": "all", "all": "any"}  # fmt: skip
"""Functions and the ones that replace them."""


RULES = {" + ": " - ", " - ": " + ", " * ": " / ", " / ": " * ", " < ": " >= ", " > ": " <= ", "-{0}": "{0}", "1.0": "2.0",
         "0.0": "0.5", "and": "or", "{2}": "{1}", "sin": "cos", "cos": "sin", "tan": "atan", "exp": "log", "abs": "-",
         "floor": "ceil", "ceil": "floor"}  # fmt: skip
"""Parts of Warp code and the ones that replace them."""


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield each change of a node, by its description."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in SWAPS:
            yield "operator", ast.BinOp(left, SWAPS[type(op)](), right)
            yield "without right side", left
            if isinstance(op, ast.Add | ast.Mult):
                yield "without left side", right
        case ast.Compare(left=left, ops=[op], comparators=right) if type(op) in SWAPS:
            yield "comparison", ast.Compare(left, [SWAPS[type(op)]()], right)
        case ast.UnaryOp(op=ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
            yield "sign", operand
        case ast.Constant(value=float(value)):
            yield "number", ast.Constant(1.5 * value + (value == 0.0))
        case ast.Attribute(value=value, attr=name, ctx=context) if name in NAMES:
            yield f"{name}", ast.Attribute(value, NAMES[name], context)


def mutants(module: ModuleType) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield description and action of each change of a function of a module."""
    path = Path(str(module.__file__))
    tree = ast.parse(path.read_text(encoding="utf-8"))
    owners = [(module, tree)] + [(vars(module)[n.name], n) for n in tree.body if isinstance(n, ast.ClassDef)]
    for owner, function in [(owner, n) for owner, body in owners for n in body.body if isinstance(n, ast.FunctionDef)]:
        own = vars(owner)[function.name]
        target = unwrap(getattr(own, "fget", None) or getattr(own, "__func__", own))
        for node in [n for statement in function.body for n in ast.walk(statement)]:
            for change, new in changes(node):
                before, text = (type(node), dict(vars(node))), ast.unparse(node)
                after = deepcopy(new)
                node.__class__, node.__dict__ = type(after), {**vars(node), **vars(after)}
                code = find_code(
                    compile(ast.fix_missing_locations(deepcopy(tree)), str(path), "exec"), target.__qualname__
                )
                text = f"{path.name}:{node.lineno} {change}: {text} -> {ast.unparse(node)}"
                node.__class__, node.__dict__ = before
                yield text, partial(setattr, target, "__code__", code)


def rule_mutants() -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield description and action of each change of the Warp code of an operation."""
    for name, code in CODE.items():
        for old, new in RULES.items():
            if old in code:
                changed = code.replace(old, new, 1)
                yield f"{name}: {code} -> {changed}", lambda name=name, changed=changed: CODE.update({name: changed})


def find_code(code: CodeType, name: str) -> CodeType | None:
    """Return the code of a function within that of its module."""
    inner = (find_code(c, name) for c in code.co_consts if isinstance(c, CodeType))
    return code if code.co_qualname == name else next(filter(None, inner), None)


def run_tests(tests: str, prepare: Callable[[], None]) -> bool:
    """Return whether tests pass in a process of their own, after a preparation."""
    child = os.fork()
    if child == 0:
        signal.alarm(300)
        prepare()
        os._exit(run_pytest(tests, "-x"))
    return os.waitpid(child, 0)[1] == 0


def run_pytest(tests: str, option: str) -> int:
    """Run tests without output, and return the exit status."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        return int(pytest.main([option, "-q", "-n", "0", "-p", "no:cacheprovider", *tests.split()]))


def main(names: list[str]) -> None:
    """Print the result of each formula."""
    torch.set_num_threads(1)
    os.chdir(Path(__file__).parent)
    for case, place, tests in (line.split(": ") for line in CASES.strip().splitlines()):
        if names and case not in names:
            continue
        module, survivors, total = import_module(f"aerial_gym.{place}"), [], 0
        run_pytest(tests, "--collect-only")  # imports what all processes need
        assert run_tests(tests, lambda: None), f"{case}: tests fail without a change"
        for text, prepare in chain(mutants(module), rule_mutants() if case == "operations" else ()):
            total += 1
            if run_tests(tests, prepare):
                survivors.append(text)
        print(f"{case}: {total - len(survivors)} of {total} killed", *survivors, sep="\n  ", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
