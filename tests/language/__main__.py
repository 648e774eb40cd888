"""Lower the debt of the language checks to the present offences; a rule whose total would rise keeps its debt."""

import sys

from tests.language import debt
from tests.language.rules import RULES

rises = debt.lower({name: rule() for name, rule in RULES.items()})
if rises:
    sys.exit(f"more offences than before: {', '.join(rises)}")
