"""Selection of effects by evidence: sets of effects compete by how probable they make the flights."""
