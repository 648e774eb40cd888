"""Rules for names: no participle or adverb at the start, no preposition at the end, no pronoun. The words of a name are
its parts between underscores, or between the capitals of a class. ``IMPOSED`` has the names that a library fixes,
``TERMS`` the terms of the field, each with its reason."""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
FOLDERS = ("aerial_gym", "benchmarks", "examples", "tests")


def word_set(text: str) -> frozenset[str]:
    """Return the words of a text that blanks separate."""
    return frozenset(text.split())


PREPOSITIONS = word_set(
    """
    about above across after against along amid among around as at before behind below beneath beside besides
    between beyond by despite during except for from in inside into near of on onto outside over past per since than
    through throughout till to toward towards under underneath until unto upon via with within without
    """
)

ADVERBS = word_set(
    """
    again ahead almost alone already also altogether always anyhow anywhere apart aside away else elsewhere enough
    even ever everywhere hence here hereby how indeed instead just later maybe meanwhile never nevertheless
    nonetheless nowhere often once otherwise perhaps quite rather seldom so somehow sometimes somewhere soon still
    then there therefore thereof thus together too twice very well when whenever where wherever whether why yet
    """
)
"""Adverbs, and the words that open a question; those in -ly follow the rule of ``NO_ADVERBS``."""

NO_ADVERBS = word_set(
    """
    anomaly apply assembly comply family fly imply multiply ply poly rely reply supply
    """
)
"""Words in -ly that are no adverbs."""

IRREGULAR = word_set(
    """
    beaten become been begun bent blown borne bought broken brought built burnt caught chosen come dealt done drawn
    driven eaten fallen fed felt flown forbidden forgotten fought frozen given gone grown had heard held hidden hung
    kept known laid learnt lent lost made meant met mown paid proven ridden risen said seen sent sewn shaken shone
    shot shown shrunk slid slung sold sought spent spoilt spoken spun stood stolen struck stuck sunk swept swollen
    sworn swung taken taught thought thrown told torn understood undone unseen withdrawn woken won worn wound woven
    written
    """
)
"""Participles that do not end in -ed; forms that are also the imperative (``cut``, ``read``, ``set``, ``spread``) are verbs."""

NO_PARTICIPLES = word_set(
    """
    bearing bending binding bring building ceiling clearing coating coding crossing damping encoding evening finding
    fitting flapping heading housing king landing learning lettering mapping meaning mixing morning naming opening
    ordering packing padding pairing pooling processing programming racing reading recording rendering ring routing
    scaling sensing setting shading sling smoothing spacing spring steering string swing thing timing tracking
    training tubing tuning warning weighting whitening wing wiring wording bed bleed breed embed exceed feed freed
    indeed kneed need ned proceed red seed shed sled speed steed succeed weed
    """
)
"""Nouns of the field, and verbs, that end like participles."""

PRONOUNS = word_set(
    """
    another anybody anyone anything everybody everyone everything found he her hers him his it itself its me mine
    nobody nothing ones others our ours she somebody someone something such that their theirs them themselves these
    they this those us we what whatever which whichever who whoever whom whose you your yours
    """
)
"""Words that stand for a thing and do not name it. ``other`` is Python's own name for a second operand."""

IMPOSED = {
    "unwrapped": "Gymnasium's property of an environment without its wrappers",
    "named_parameters": "PyTorch's method of a module",
    "closed": "Python's property of a file",
    "to": "PyTorch's method that moves an object to a device",
    "ClosedError": "public exception of 0.1.0",
    "Exported": "public result of an export",
    "ExportedPilot": "public pilot made of an exported file",
    "Imported": "public result of an import",
    "NamedEffect": "public part of a verdict",
    "RefusedFlight": "public result for a log that cannot be compared",
    "RunningNormalizer": "running mean and variance, as in the field",
    "StuckRotor": "class of the registered effect `stuck_rotor`",
    "stuck_rotor": "registered effect; its name stands in robot files",
    "condition_in": "public function of `physics`",
    "settings_for": "public function of `rl_training`",
    "mounted_sensors": "function of `sensors` that examples use",
    "held_out_rms": "key of result.json",
    "learned": "module of the `learned` residual",
    "test_learned": "tests of the module `learned`",
    "scoring": "noun: the scoring of models",
    "test_scoring": "tests of the module `scoring`",
    "measured": "folder of tests with measured flights",
    "undeclared": "the protocol of undeclared effects",
    "aligned_distance_bell": "registered reward term",
    "aligned_rest_at_target": "registered reward term",
    "speeding": "registered reward term",
    "unseen_flight": "registered reward term",
    "following_gate_world": "registered observation term",
    "turning_cost": "registered reward term",
    "still": "registered reward term",
    "missed_touchdown": "registered termination term",
    "tilted": "registered termination term",
    "leaning": "registered termination term",
    "spinning": "registered termination term",
}
"""Names that a library, a registered name, a file format or the public interface fixes, each with its reason."""

TERMS = {
    "added_inertia": "the inertia of the water that turns with a body",
    "added_mass": "the mass of the water that moves with a body",
    "articulated": "bodies with joints, as in 'articulated-body algorithm'",
    "augmented_lagrangian": "a method of optimisation",
    "bounding_box": "the smallest box around a shape",
    "bounding_radius": "the radius of the smallest sphere around a shape",
    "clipped_objective": "the objective of PPO",
    "closed_form": "a formula without iteration",
    "closed_loop": "a plant with its controller",
    "fused": "one kernel for all parts of a step, as in 'kernel fusion'",
    "fixed_point": "a value that an iteration does not change",
    "fixed_wing": "a type of aircraft",
    "generalized_advantage": "an estimator of policy gradients",
    "hidden_layer": "a layer between input and output of a network",
    "hidden_state": "the memory of a recurrent network",
    "induced": "the flow that a rotor adds, as in 'induced velocity'",
    "learned_residual": "a registered effect; its name stands in robot files",
    "missing_dependency": "an optional package that is not installed; the exception is public",
    "mixed_precision": "arithmetic in two formats",
    "relaxed_hover": "hover that rotates about a fixed axis after the loss of a rotor",
    "signed_distance": "a distance that is negative inside",
    "slung_load": "a load on a cable",
    "slung_payload": "a registered effect; its name stands in robot files",
    "squared_error": "the square of an error",
    "swept_volume": "the space that a moving body passes",
    "weighted_least_square": "a method of estimation",
    "weighted_mean": "a mean with weights",
    "weighted_moment": "a moment with weights",
}
"""Terms of the field that begin with a participle. A name may begin with them, in the singular or the plural."""


class Definition(NamedTuple):
    """A name where it is defined; modules, classes and functions have their docstring."""

    path: str
    line: int
    kind: str
    name: str
    doc: str = ""


def words(name: str) -> list[str]:
    """Return the words of a name in small letters: parts between underscores, and between the capitals of a class."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    return [word for word in parted.lower().split("_") if word]


def is_participle(word: str) -> bool:
    """Return whether a word is a participle: an irregular one, or one in -ed or -ing that is no noun of ``NO_PARTICIPLES``."""
    if word in IRREGULAR:
        return True
    return len(word) > 3 and word.endswith(("ed", "ing")) and word not in NO_PARTICIPLES | PRONOUNS


def is_adverb(word: str) -> bool:
    """Return whether a word is an adverb: one of the list, or one in -ly."""
    return word in ADVERBS or (word.endswith("ly") and word not in NO_ADVERBS)


def begins_with_term(parts: list[str]) -> bool:
    """Return whether a name begins with a term of ``TERMS``, in the singular or the plural."""
    return f"{'_'.join(parts)}_".startswith(tuple(f"{term}{end}_" for term in TERMS for end in ("", "s")))


def fault(kind: str, name: str) -> str:
    """Return the broken rule of a name, or an empty string. Names of tests are sentences; only their last word is checked."""
    parts = words(name.removeprefix("test_") if kind == "module" else name)
    if not parts or name in IMPOSED or (name.startswith("__") and name.endswith("__")):
        return ""
    if kind in ("parameter", "variable"):
        return "is a pronoun" if len(parts) == 1 and parts[0] in PRONOUNS else ""
    if parts[-1] in PREPOSITIONS:
        return "ends in a preposition"
    if parts[0] == "test" or begins_with_term(parts):
        return ""
    if is_participle(parts[0]):
        return "begins with a participle"
    if is_adverb(parts[0]):
        return "begins with an adverb"
    return "contains a pronoun" if PRONOUNS.intersection(parts) else ""


def definition(path: str, node: ast.AST) -> Definition | None:
    """Return the name that a node of a syntax tree defines; None for other nodes."""
    match node:
        case ast.ClassDef():
            return Definition(path, node.lineno, "class", node.name, ast.get_docstring(node) or "")
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            return Definition(path, node.lineno, "function", node.name, ast.get_docstring(node) or "")
        case ast.arg():
            return Definition(path, node.lineno, "parameter", node.arg)
        case ast.Name(ctx=ast.Store()):
            return Definition(path, node.lineno, "variable", node.id)
    return None


@cache
def definitions() -> list[Definition]:
    """Return each module, package, class, function, parameter and variable of the tree where it is defined."""
    rows = []
    for file in sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")):
        path, tree = file.relative_to(ROOT).as_posix(), ast.parse(file.read_text("utf-8"))
        module = file.parent.name if file.name == "__init__.py" else file.stem
        rows.append(Definition(path, 1, "module", module, ast.get_docstring(tree) or ""))
        rows += [row for node in ast.walk(tree) if (row := definition(path, node))]
    return rows
