"""What an avatar is made of."""
