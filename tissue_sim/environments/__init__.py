"""Gymnasium's environments of this package; importing it registers them."""

from __future__ import annotations

from tissue_sim.environments.registration import register_all as register_all

register_all()
