"""Files made to exhaust a reader are refused with a message, in bounded time and memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.configuration.toml_file import DEPTH_MAX, FILE_MAX
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.scenario_file import load_scenario

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join([f'*{chr(97 + n)}'] * 10)}]\n" for n in range(12)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x" * (FILE_MAX + 1), f"longer than {FILE_MAX} bytes"),
        (f"a = {'[' * 50_000}{']' * 50_000}", "not valid TOML"),
        (f"a = {'[' * (DEPTH_MAX + 1)}{']' * (DEPTH_MAX + 1)}", f"nested deeper than {DEPTH_MAX} levels"),
        (f"{'.'.join(['a'] * 2000)} = 1", f"nested deeper than {DEPTH_MAX} levels"),
        (f"a = {'9' * 5000}", "not valid TOML"),
    ],
)
def test_toml_bombs(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bomb.toml"
    path.write_text(text)
    with pytest.raises(GatewayError, match=message) as refused:
        load_config(path)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUGHS, "anchors and aliases .* are not allowed"),
        ("a: &a\n  b: *a\n", "anchors and aliases .* are not allowed"),
        ("steps: " + "[" * 5000 + "]" * 5000, "nested too deeply|nested deeper"),
        ("steps: " + "[" * 40 + "]" * 40, "nested deeper than"),
        ("x" * (FILE_MAX + 1), f"longer than {FILE_MAX} bytes"),
    ],
)
def test_yaml_bombs(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    with pytest.raises(GatewayError, match=message) as refused:
        load_scenario(path)
    assert len(str(refused.value)) < 500
