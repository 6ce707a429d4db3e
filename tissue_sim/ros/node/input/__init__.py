"""What comes in: poses, forces, breathing, transforms."""
