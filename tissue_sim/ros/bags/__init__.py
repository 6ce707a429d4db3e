"""What a bag holds, how it is written, and how it is run again."""
