"""Type names for what is read from JSON and YAML files, and written to them."""

from __future__ import annotations

from typing import Any

JsonObject = dict[str, Any]  # by name: numbers, texts, lists and further objects, as the file's own description says
