"""What an organ is, and how one is made from an image, a mask or a mesh."""
