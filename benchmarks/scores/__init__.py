"""What the loop with measured data finds, of hidden truths and of real flights."""
