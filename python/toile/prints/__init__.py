"""What is printed on a garment: how pictures show it, and the slides along its surface that lay it upon a reference."""
