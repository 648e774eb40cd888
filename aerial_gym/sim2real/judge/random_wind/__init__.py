"""Random wind: is what remains a wind that wanders as ``gusts`` do."""
