"""Language rules of the issue: each returns its offences by file."""

import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from itertools import groupby
from math import ceil

from tests.language import names
from tests.language import pages as text
from tests.language.debt import Offences

LONGEST_MEAN, LONGEST = 18, 45
"""Words of a sentence, on the average of a page and at most: Plain-language guides ask for 15 to 20 on average."""

TABLE_SHARE = 0.3
"""Share of a page's words in tables; pages of results and reference consist of tables."""

IMPOSED_CLASSES = {
    "AssetManager": "`compat` has the class names of Aerial Gym Simulator",
    "EnvManager": "`compat` has the class names of Aerial Gym Simulator",
    "RobotManager": "`compat` has the class names of Aerial Gym Simulator",
    "SimBuilder": "`compat` has the class names of Aerial Gym Simulator",
    "TaskRegistry": "`compat` has the class names of Aerial Gym Simulator",
    "sensor_config": "examples define it as scripts of Aerial Gym Simulator do",
}
"""Public class names that may stand twice, each with its reason."""

OPENING = re.compile(r"Return (?:what|how|where|which|by|of|whether what)\b")

SPELLED = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs", "aerial_gym", "benchmarks", "examples", "tests")
"""Files and folders that codespell reads; words it must accept are in ``pyproject.toml``."""


def mean_lengths() -> Offences:
    """Return the pages whose sentences are too long on average: one offence for each word above the limit."""
    excess = {path: ceil(text.mean_length(page) - LONGEST_MEAN) for path, page in text.pages().items()}
    return {path: ["a word above the mean"] * number for path, number in excess.items() if number > 0}


def long_sentences() -> Offences:
    """Return the sentences of pages with too many words."""
    offences = {}
    for path, page in text.pages().items():
        if parts := [part for part in text.sentences(page) if text.count(part) > LONGEST]:
            offences[path] = [f"{text.count(part)} words: {part[:60]!r}" for part in parts]
    return offences


def table_shares() -> Offences:
    """Return the pages whose words stand mostly in tables: one offence for each percent above the limit."""
    excess = {
        path: ceil(100 * (text.table_share(page) - TABLE_SHARE))
        for path, page in text.pages().items()
        if not path.startswith(("docs/results/", "docs/reference/"))
    }
    return {path: ["a percent above the share"] * number for path, number in excess.items() if number > 0}


def clause_docstrings() -> Offences:
    """Return the docstrings that open with a clause in place of a noun."""
    offences = defaultdict(list)
    for row in names.definitions():
        if OPENING.match(row.doc):
            offences[row.path].append(f"line {row.line}: {row.name}")
    return offences


def _faulty_names(*faults: str) -> Offences:
    """Return the names with one of the faults."""
    offences = defaultdict(list)
    for definition in names.definitions():
        if names.fault(definition.kind, definition.name) in faults:
            offences[definition.path].append(f"line {definition.line}: {definition.kind} {definition.name}")
    return offences


def participles() -> Offences:
    """Return the names that begin with a participle or an adverb."""
    return _faulty_names("begins with a participle", "begins with an adverb")


def prepositions() -> Offences:
    """Return the names that end in a preposition."""
    return _faulty_names("ends in a preposition")


def pronouns() -> Offences:
    """Return the names that are or contain a pronoun."""
    return _faulty_names("is a pronoun", "contains a pronoun")


def duplicate_classes() -> Offences:
    """Return the public classes of the package, the benchmarks and the examples that share a name."""
    rows = [row for row in names.definitions() if row.kind == "class" and not row.path.startswith("tests/")]
    public = sorted((row.name, row.path) for row in rows if row.name[0] != "_" and row.name not in IMPOSED_CLASSES)
    places = {name: [path for _, path in group] for name, group in groupby(public, lambda row: row[0])}
    return {name: paths[1:] for name, paths in places.items() if len(paths) > 1}


def unreachable_pages() -> Offences:
    """Return the pages that no chain of links reaches from README or the site's menu."""
    return {path: ["no link"] for path in text.pages().keys() - text.reachable()}


def dead_links() -> Offences:
    """Return the links of pages whose file or anchor does not exist."""
    wrong = {path: text.dead_links(path, page) for path, page in text.pages().items()}
    return {path: links for path, links in wrong.items() if links}


def misspellings() -> Offences:
    """Return the words that codespell takes for errors."""
    command = [sys.executable, "-m", "codespell_lib", *SPELLED]
    output = subprocess.run(command, cwd=names.ROOT, capture_output=True, text=True, check=False)
    assert output.returncode in (0, 65), output.stderr
    offences = defaultdict(list)
    for line in output.stdout.splitlines():
        offences[line.partition(":")[0].removeprefix("./")].append(line)
    return offences


RULES: dict[str, Callable[[], Offences]] = {
    "words of a sentence on average": mean_lengths, "words of a sentence": long_sentences,
    "words in tables": table_shares, "openings of docstrings": clause_docstrings,
    "names that begin with a participle": participles, "names that end in a preposition": prepositions,
    "names that are pronouns": pronouns, "class names used twice": duplicate_classes,
    "pages without a link": unreachable_pages, "links without a target": dead_links, "spelling": misspellings,
}  # fmt: skip
