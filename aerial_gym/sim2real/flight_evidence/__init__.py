"""Evidence of single flights about every effect, as sums that add over flights."""
