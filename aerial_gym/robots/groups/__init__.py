"""What vehicles of an environment share: the air that their rotors move, and a payload on their cables."""
