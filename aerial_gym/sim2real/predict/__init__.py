"""What a model predicts of flights, beside what was measured: step by step and in open-loop rollouts."""
