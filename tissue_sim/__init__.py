"""Real-time deformable organs for haptics and CI: the hybrid elastic model of Zhang, Gu et al. (2006)."""

__version__ = "0.1.0"
