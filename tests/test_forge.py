"""The workflow of the forge and the pins: every step is a command that this repository has, every pin is of the constraints."""

from __future__ import annotations

import os
import re
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.test_package import PROJECT, ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
COMMIT = re.compile(r"[\w.-]+/[\w.-]+@[0-9a-f]{40}")
KEYS = {"name", "uses", "with", "run", "env", "if"}
JOB_KEYS = {"if", "needs", "runs-on", "timeout-minutes", "strategy", "permissions", "steps"}
PIN = re.compile(r"^([\w.-]+)==([^ ;]+)[^\n]*\\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE)


def workflow() -> dict[str, Any]:
    (path,) = WORKFLOWS
    made: dict[str, Any] = yaml.load(path.read_text(encoding="utf-8"), yaml.BaseLoader)  # ``on`` is a text, no boolean
    return made


def steps() -> list[dict[str, Any]]:
    return [step for job in workflow()["jobs"].values() for step in job["steps"]]


def test_the_workflow_has_only_known_keys() -> None:
    found = workflow()
    assert found.keys() == {"name", "on", "permissions", "concurrency", "jobs"}
    for name, job in found["jobs"].items():
        assert job.keys() <= JOB_KEYS, name
        needed = job.get("needs", [])
        assert set(needed) <= found["jobs"].keys() - {name}
    for step in steps():
        assert step.keys() <= KEYS
        assert ("uses" in step) != ("run" in step)


def test_every_command_of_the_workflow_is_a_make_target_or_a_script() -> None:
    commands = [step["run"].split() for step in steps() if "run" in step]
    assert {tuple(words[:2]) for words in commands} >= {("make", "lint"), ("make", "test"), ("make", "release")}
    for program, *words in commands:
        if program == "make":
            assert words
            assert set(words) <= TARGETS
        else:
            assert program.startswith(".ci/")
            assert os.access(ROOT / program, os.X_OK), program


def test_actions_are_pinned_by_commit() -> None:
    actions = [step["uses"] for step in steps() if "uses" in step]
    assert actions
    assert [action for action in actions if not COMMIT.fullmatch(action)] == []


def test_every_supported_python_is_tested_and_only_a_tag_may_write() -> None:
    found = workflow()
    assert found["jobs"]["test"]["strategy"]["matrix"]["python"] == PYTHONS
    assert PROJECT["project"]["requires-python"] == f">={PYTHONS[0]}"
    assert found["permissions"] == {"contents": "read"}
    writing = {name: job for name, job in found["jobs"].items() if "permissions" in job}
    assert writing.keys() == {"release"}
    assert writing["release"]["if"] == "startsWith(github.ref, 'refs/tags/v')"
    assert set(writing["release"]["needs"]) == found["jobs"].keys() - {"release"}


# -- pins -------------------------------------------------------------------------------------------------------------


def pinned(name: str) -> dict[str, str]:
    """The version of each package of a file; each one has a hash."""
    text = (ROOT / "deploy" / "pins" / name).read_text(encoding="utf-8")
    found = {str(canonicalize_name(match[1])): str(match[2]) for match in PIN.finditer(text)}
    assert len(found) == len(re.findall(r"^[\w.-]+==", text, re.MULTILINE)), "a pin without a hash"
    return found


@pytest.mark.parametrize("name", ["runtime.txt", "development.txt"])
def test_pins_have_the_versions_of_the_constraints(name: str) -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    constraints = {canonicalize_name(package): version for package, version in (line.split("==") for line in lines)}
    assert pinned(name).items() <= constraints.items()


def test_the_pins_have_every_package_that_is_needed() -> None:
    extras = PROJECT["project"]["optional-dependencies"]
    for name, needed in (("runtime.txt", ("web", "mqtt")), ("development.txt", ("web", "mqtt", "dev"))):
        texts = [*PROJECT["project"]["dependencies"], *(text for extra in needed for text in extras[extra])]
        assert {canonicalize_name(Requirement(text).name) for text in texts} <= pinned(name).keys()
    assert pinned("runtime.txt").keys() <= pinned("development.txt").keys()
