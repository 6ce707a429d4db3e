"""Type names for what is read from JSON and YAML files, and written to them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# By name: numbers, texts, lists and further objects, as the file's own description says.
JsonObject = dict[str, Any]
JsonMapping = Mapping[str, Any]  # the same, which is only read
