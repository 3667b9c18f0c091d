"""The figures of the packages, on a product of two packages."""

from __future__ import annotations

from pathlib import Path

from pdgw.workshop.package_figures import Module, modules

_PROJECT = '[tool.setuptools.package-dir]\n"pdgw.bus" = "bus"\n"pdgw.gateway" = "gateway"\n'


def test_a_module_counts_lines_public_names_and_pairs_of_modules(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(_PROJECT)
    for folder in ("bus", "gateway", "gateway/axis"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").write_text("")
    (tmp_path / "bus" / "frame.py").write_text("class Frame: ...\n_HIDDEN = 1\nSIZE: int = 8\n")
    (tmp_path / "gateway" / "axis" / "machine.py").write_text(
        "import sys\nfrom pdgw.bus import frame\nfrom pdgw.bus.frame import SIZE, Frame\n\n\ndef step() -> None: ...\n"
    )
    found = {module.package: module for module in modules(tmp_path) if module.lines}
    assert found["pdgw.bus"] == Module("pdgw.bus", 3, 2, frozenset())
    assert found["pdgw.gateway.axis"] == Module("pdgw.gateway.axis", 6, 1, frozenset({"pdgw.bus:pdgw.bus.frame"}))
