"""What an avatar is trained on, and how."""
