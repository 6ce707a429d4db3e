"""The parameters' table, and the file in config/ that shows it."""

import pytest
from ruamel.yaml import YAML

from helpers.paths import CONFIG
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS

FILE = CONFIG / "tissue_node.yaml"


def test_config_file_holds_every_parameter_with_its_default():
    values = YAML(typ="safe").load(FILE.read_text())["/**"]["ros__parameters"]
    tools = values.pop("tools")
    shown = {tool: values.pop(tool) for tool in tools}
    assert values == {spec.name: spec.default for spec in NODE_SPECS}
    defaults = {spec.name: spec.default for spec in TOOL_SPECS}
    for tool in shown.values():
        assert tool.items() <= defaults.items()


@pytest.mark.parametrize("spec", NODE_SPECS + TOOL_SPECS, ids=lambda spec: spec.name)
def test_every_parameter_is_described(spec):
    assert spec.text
    if isinstance(spec.default, float):
        assert spec.low is not None
        assert spec.low <= spec.default <= spec.high
    if spec.choices:
        assert spec.default in spec.choices


def test_settings_are_one_to_one():
    settings = [spec.setting for spec in NODE_SPECS if spec.setting]
    assert len(set(settings)) == len(settings)
