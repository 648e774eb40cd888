"""Which effects the flights ask for, and how surely."""
