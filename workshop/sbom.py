"""The software bill of materials of a release: CycloneDX 1.6, JSON. Source: https://cyclonedx.org/docs/1.6/json/.

Components: the run-time dependencies with those of some extras, in the installed versions (constraints.txt), and the
third-party files of the web page. The same input gives the same bytes.
"""

from __future__ import annotations

import json
import tomllib
import uuid
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import requires, version
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pdgw.web.support import PACKAGE, VENDORED, licence

ROOT = Path(__file__).resolve().parent.parent
EXTRAS = ("mqtt", "plot", "web")
"""Extras whose packages are installed wherever a release is built."""
Document = dict[str, Any]


def _product(extras: Sequence[str]) -> list[str]:
    """The product's requirements from its sources, because an editable installation may be older."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    return [*project["dependencies"], *(text for extra in extras for text in optional[extra])]


def needed(texts: Iterable[str]) -> list[str]:
    """The normalized names of the packages that these requirements name on this platform."""
    items = map(Requirement, texts)
    return sorted(
        {canonicalize_name(item.name) for item in items if item.marker is None or item.marker.evaluate({"extra": ""})}
    )


def closure(extras: Sequence[str] = ()) -> dict[str, list[str]]:
    """The requirements of each package, for the product with these extras and all dependencies."""
    found = {PACKAGE: needed(_product(extras))}
    waiting = list(found[PACKAGE])
    while waiting:
        item = waiting.pop()
        if item not in found:
            found[item] = needed(requires(item) or ())
            waiting += found[item]
    return found


def document(release: str, epoch: int) -> Document:
    """The bill of materials of version ``release``. ``epoch``: seconds since 1970."""
    below = closure(EXTRAS)
    required = closure()
    components = [
        _component(f"pkg:pypi/{name}@{version(name)}", name, version(name), licence(name).get("licence", ""))
        | {"scope": "required" if name in required else "optional"}
        for name in sorted(below)
        if name != PACKAGE
    ]
    for item in json.loads(VENDORED.read_text(encoding="utf-8")):
        files = [
            {"type": "file", "name": file["file"], "hashes": [{"alg": "SHA-256", "content": file["sha256"]}]}
            for file in item["files"]
        ]
        purl = f"pkg:npm/{item['package']}@{item['version']}"
        made = _component(purl, item["package"], item["version"], item["licence"])
        components.append(made | {"scope": "required", "components": files})
    names = {name: f"pkg:pypi/{name}@{release if name == PACKAGE else version(name)}" for name in below}
    product = _component(names[PACKAGE], PACKAGE, release, licence(PACKAGE).get("licence", ""))
    vendored = [item["bom-ref"] for item in components if item["bom-ref"].startswith("pkg:npm/")]
    dependencies = [
        {
            "ref": names[name],
            "dependsOn": [*(names[item] for item in items), *(vendored if name == PACKAGE else ())],
        }
        for name, items in sorted(below.items())
    ]
    content = {"components": components, "dependencies": dependencies}
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, json.dumps([names[PACKAGE], epoch, content]))}",
        "version": 1,
        "metadata": {"timestamp": datetime.fromtimestamp(epoch, UTC).isoformat(), "component": product},
        **content,
    }


def _component(purl: str, name: str, release: str, given: str) -> Document:
    made: Document = {"type": "library", "bom-ref": purl, "name": name, "version": release, "purl": purl}
    return made | ({"licenses": [{"license": {"name": given}}]} if given else {})
