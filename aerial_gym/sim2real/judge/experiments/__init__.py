"""What to fly next: manoeuvres and what they would show."""
